//! So many looks of the engine at three axes, and nothing else, for callgrind: `engine_steps still|moving|correcting N`.

use rtec_tests::workload::{Motion, Workload};

fn main() -> anyhow::Result<()> {
    let (name, looks) = (std::env::args().nth(1), std::env::args().nth(2));
    let motion = Motion::ALL.iter().find(|(known, _)| Some(*known) == name.as_deref());
    let (Some((_, motion)), Some(looks)) = (motion, looks) else {
        anyhow::bail!("usage: engine_steps still|moving|correcting N");
    };
    let mut work = Workload::new(*motion)?;
    work.looks(looks.parse()?)?;
    // Used, so that it was worth computing.
    println!("{}", work.status().polls);
    Ok(())
}
