//! Runs the blind suite.
fn main() -> anyhow::Result<()> {
    use rtec_blind::{case, score, world::Manner};
    let args: Vec<String> = std::env::args().collect();
    let from: u64 = args.get(2).map_or(0, |a| a.parse().unwrap_or(0));
    let to: u64 = args.get(3).map_or(100, |a| a.parse().unwrap_or(100));
    let manner = if args.get(4).is_some_and(|a| a == "second") { Manner::Second } else { Manner::First };
    let hides = match args.get(1).map(String::as_str) {
        Some("null") => case::Hides::Nothing,
        Some("two") => case::Hides::Two,
        Some("strange") => case::Hides::Stranger,
        _ => case::Hides::One,
    };
    let mut tally: std::collections::BTreeMap<score::Mark, usize> = Default::default();
    let mut high = [0, 0];
    for seed in from..to {
        let dir = tempfile::tempdir()?;
        let c = case::make(seed, hides, None, manner, dir.path())?;
        let records: Vec<_> =
            c.train.iter().map(|p| rtec_model::record::Record::read(p)).collect::<Result<_, _>>()?;
        let machine = rtec_model::machine::Machine::read(&c.model)?;
        let start = std::time::Instant::now();
        let a = rtec_reconcile::analyse(&records, &machine, 0.01);
        let took = start.elapsed().as_secs_f64();
        let reply = score::Reply {
            verdict: if !a.unexplained.is_empty() {
                "unknown_effect"
            } else if a.findings.is_empty() {
                "nothing_missing"
            } else if a.findings.iter().any(|f| !f.rivals.is_empty()) {
                "not_separable"
            } else {
                "named"
            }
            .into(),
            effects: a
                .findings
                .iter()
                .map(|f| (f.effect.name(), f.rivals.iter().map(|r| r.name.clone()).collect()))
                .collect(),
        };
        let m = score::mark(&c, &reply);
        *tally.entry(m).or_default() += 1;
        let ok = matches!(m, score::Mark::Exact | score::Mark::Group);
        if c.snr.iter().all(|s| *s >= 2.0) {
            high[1] += 1;
            high[0] += usize::from(ok);
        }
        if !ok || took > 1.0 {
            println!(
                "seed {seed} {m:?} {took:.2}s {} truth {:?} snr {:.1?}\n    {}\n    -> {} {:?} {}",
                c.design,
                c.truth,
                c.snr,
                c.story,
                reply.verdict,
                reply.effects,
                a.unexplained
                    .iter()
                    .map(|s| format!("{:?} {}", s.against, s.manner))
                    .collect::<Vec<_>>()
                    .join("; ")
            );
        }
    }
    println!("{tally:?} high {high:?}");
    Ok(())
}
