//! Verdict documents of blind cases, one file each, and what each took: two builds are compared by both.
//!
//! `cargo run --release -p rtec-blind --example verdicts -- FOLDER FROM COUNT CLASS...`

use rtec_blind::class::CLASSES;
use rtec_blind::judge::answer;
use rtec_blind::plan::Manner;
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [folder, from, count, classes @ ..] = &args[..] else {
        anyhow::bail!("FOLDER FROM COUNT CLASS...");
    };
    let (from, count): (u64, u64) = (from.parse()?, count.parse()?);
    std::fs::create_dir_all(folder)?;
    for word in classes {
        let (class, ..) =
            CLASSES.iter().find(|(_, w, _)| w == word).ok_or_else(|| anyhow::anyhow!("{word}?"))?;
        let mut seconds = Vec::new();
        for i in 0..count {
            let manner = if i % 2 == 0 { Manner::First } else { Manner::Second };
            let dir = tempfile::tempdir()?;
            let made = class.make(from + i, manner, dir.path())?;
            let (v, refused) = answer(&made.case);
            let text = refused.unwrap_or_else(|| format!("{:#}\n", v.document));
            let text = text.replace(&dir.path().display().to_string(), "");
            std::fs::write(Path::new(folder).join(format!("{word}-{}.json", from + i)), text)?;
            seconds.push(v.cpu_s);
        }
        let mean = seconds.iter().sum::<f64>() / seconds.len().max(1) as f64;
        let most = seconds.iter().copied().fold(0.0, f64::max);
        println!("{word:12} {:3} cases, {mean:.3} s mean, {most:.3} s most", seconds.len());
    }
    Ok(())
}
