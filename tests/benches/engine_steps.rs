//! Looks of the engine at three axes, and nothing else, for callgrind.
//! `cargo bench -p rtec-tests --bench engine_steps -- still|moving|correcting N [AXES]` makes N looks.

use rtec_tests::workload::{AXES, Motion, Workload};

fn main() -> anyhow::Result<()> {
    // Cargo adds the argument `--bench`.
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    let (name, looks, axes) = (arguments.next(), arguments.next(), arguments.next());
    if name.is_none() {
        println!("engine_steps: nothing to count without still|moving|correcting N [AXES]");
        return Ok(());
    }
    let motion = Motion::ALL.iter().find(|(known, _)| Some(*known) == name.as_deref());
    let (Some((_, motion)), Some(looks)) = (motion, looks) else {
        anyhow::bail!(
            "usage: cargo bench -p rtec-tests --bench engine_steps -- still|moving|correcting N [AXES]"
        );
    };
    let axes = axes.map_or(Ok(AXES), |n| n.parse())?;
    anyhow::ensure!((1..=6).contains(&axes), "{axes} axes; from 1 to 6");
    let mut work = Workload::of(*motion, axes)?;
    work.looks(looks.parse()?)?;
    // Printed, so that the compiler does not remove the work.
    println!("{}", work.status().polls);
    Ok(())
}
