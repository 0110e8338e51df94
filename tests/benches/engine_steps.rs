//! So many looks of the engine at three axes, and nothing else, for callgrind:
//! `cargo bench -p rtec-tests --bench engine_steps -- still|moving|correcting N`.

use rtec_tests::workload::{Motion, Workload};

fn main() -> anyhow::Result<()> {
    // Cargo adds `--bench` of its own.
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    let (name, looks) = (arguments.next(), arguments.next());
    if name.is_none() {
        println!("engine_steps: nothing to count without still|moving|correcting N");
        return Ok(());
    }
    let motion = Motion::ALL.iter().find(|(known, _)| Some(*known) == name.as_deref());
    let (Some((_, motion)), Some(looks)) = (motion, looks) else {
        anyhow::bail!("usage: cargo bench -p rtec-tests --bench engine_steps -- still|moving|correcting N");
    };
    let mut work = Workload::new(*motion)?;
    work.looks(looks.parse()?)?;
    // Used, so that it was worth computing.
    println!("{}", work.status().polls);
    Ok(())
}
