//! Drills from every thermal state with a model fitted on the wet runs alone: `--example starts -- FIRST LAST`, seeds.
use rtec_papers::wo97::starts;
use rtec_sim::described_machines::MachineDescriptions;
use std::collections::BTreeMap;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Its test has other arguments.
    let given: Vec<u64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let [first, last] = given[..] else {
        return if cfg!(test) && !test_needs::long() { Ok(()) } else { compare(1, 1) };
    };
    compare(first, last)
}

/// Cases of a start, by what is left and what was said before.
#[derive(Default)]
struct Tally {
    cases: usize,
    more: usize,
    said: usize,
    said_in_vain: usize,
}

fn compare(first: u64, last: u64) -> Result<(), Box<dyn std::error::Error>> {
    println!(
        "seed start                 axis   tool off, um         from hole 1, um      promised and outside, um"
    );
    let mut unwarned = Vec::new();
    let mut tallies: BTreeMap<&str, Tally> = BTreeMap::new();
    for seed in first..=last {
        for s in starts(&MachineDescriptions::default(), seed)? {
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
            let (more, said) = (s.left() > 0.25, s.warned());
            let tally = tallies.entry(s.start).or_default();
            tally.cases += 1;
            tally.more += usize::from(more);
            tally.said += usize::from(more && said);
            tally.said_in_vain += usize::from(!more && said);
            if more && !said {
                unwarned.push(format!("seed {seed}: {s:?}"));
            }
        }
    }
    println!("start                 more than a quarter left   of these said before   said, and less left");
    for (start, Tally { cases, more, said, said_in_vain }) in tallies {
        println!("{start:<21} {more:12} of {cases:<11} {said:21} {said_in_vain:14} of {}", cases - more);
    }
    if unwarned.is_empty() {
        return Ok(());
    }
    Err(format!("left more than a quarter, and did not say so before:\n{}", unwarned.join("\n")).into())
}
