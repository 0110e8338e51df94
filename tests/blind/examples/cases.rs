//! Single blind cases, to try by hand or to compare two builds.
//!
//! `files` writes each case with its truth, for `rtecctl reconcile`. `verdicts` writes the verdict document of each and
//! prints the time.
//!
//! `cargo run --release -p rtec-blind --example cases -- files|verdicts FOLDER FROM COUNT CLASS...`

use rtec_blind::class::{CLASSES, Made};
use rtec_blind::judge::answer;
use rtec_blind::plan::Manner;
use std::path::Path;

const USAGE: &str = "files|verdicts FOLDER FROM COUNT CLASS...";

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [what, folder, from, count, classes @ ..] = &args[..] else { anyhow::bail!(USAGE) };
    let (folder, from, count): (_, u64, u64) = (Path::new(folder), from.parse()?, count.parse()?);
    std::fs::create_dir_all(folder)?;
    for word in classes {
        let (class, ..) =
            CLASSES.iter().find(|(_, w, _)| w == word).ok_or_else(|| anyhow::anyhow!("{word}?"))?;
        let mut seconds = Vec::new();
        for seed in from..from + count {
            let manner = if (seed - from) % 2 == 0 { Manner::First } else { Manner::Second };
            let name = format!("{word}-{seed}");
            match what.as_str() {
                "files" => {
                    let dir = folder.join(name);
                    std::fs::create_dir_all(&dir)?;
                    let Made { case, .. } = class.make(seed, manner, &dir)?;
                    println!("{}: {:?}; {}", dir.display(), case.truth, case.story);
                }
                "verdicts" => {
                    let dir = tempfile::tempdir()?;
                    let (v, refused) = answer(&class.make(seed, manner, dir.path())?.case);
                    let text = refused.unwrap_or_else(|| format!("{:#}\n", v.document));
                    let text = text.replace(&dir.path().display().to_string(), "");
                    std::fs::write(folder.join(name + ".json"), text)?;
                    seconds.push(v.cpu_s);
                }
                _ => anyhow::bail!(USAGE),
            }
        }
        if !seconds.is_empty() {
            let mean = seconds.iter().sum::<f64>() / seconds.len() as f64;
            let most = seconds.iter().copied().fold(0.0, f64::max);
            println!("{word:12} {:3} cases, {mean:.3} s mean, {most:.3} s most", seconds.len());
        }
    }
    Ok(())
}
