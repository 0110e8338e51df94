//! Blind cases as files, with what is true of them, to be tried by hand with `rtecctl reconcile`.
//!
//! `cargo run -p rtec-blind --example cases -- FOLDER FROM COUNT CLASS...`

use rtec_blind::class::CLASSES;
use rtec_blind::plan::Manner;
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [folder, from, count, classes @ ..] = &args[..] else {
        anyhow::bail!("FOLDER FROM COUNT CLASS...");
    };
    let (from, count): (u64, u64) = (from.parse()?, count.parse()?);
    for word in classes {
        let (class, ..) =
            CLASSES.iter().find(|(_, w, _)| w == word).ok_or_else(|| anyhow::anyhow!("{word}?"))?;
        for i in 0..count {
            let manner = if i % 2 == 0 { Manner::First } else { Manner::Second };
            let dir = Path::new(folder).join(format!("{word}-{}", from + i));
            std::fs::create_dir_all(&dir)?;
            let made = class.make(from + i, manner, &dir)?;
            println!("{}: {:?}; {}", dir.display(), made.case.truth, made.case.story);
        }
    }
    Ok(())
}
