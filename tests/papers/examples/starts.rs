//! Drills from every thermal state with a model fitted on the wet runs alone: `--example starts -- FIRST LAST`, seeds.
use rtec_papers::wo97::starts;
use rtec_sim::described::Described;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Its test has other arguments.
    let given: Vec<u64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let [first, last] = given[..] else { return compare(1, 1) };
    compare(first, last)
}

fn compare(first: u64, last: u64) -> Result<(), Box<dyn std::error::Error>> {
    println!(
        "seed start                 axis   tool off, um         from hole 1, um      promised and outside, um"
    );
    let mut unwarned = Vec::new();
    for seed in first..=last {
        for s in starts(&Described::default(), seed)? {
            let [off, off_with] = s.off_um;
            let [from, from_with] = s.from_hole_1_um;
            println!(
                "{seed:4} {:<21} {:<3} {off:7.1} {off_with:5.1} {:4.0} % {from:8.1} {from_with:5.1} {:4.0} % {:8.1} {:5.1}",
                s.start,
                s.axis,
                100.0 * s.left(),
                100.0 * s.left_from_hole_1(),
                s.promised_um[0],
                s.promised_um[1]
            );
            if s.left() > 0.25 && !s.warned() {
                unwarned.push(format!("seed {seed}: {s:?}"));
            }
        }
    }
    if unwarned.is_empty() {
        return Ok(());
    }
    Err(format!("left more than a quarter, and did not say so before:\n{}", unwarned.join("\n")).into())
}
