//! Reads a configuration, and reports every mistake in one with its line.
use rtec_control::config::{Config, EMBEDDED};
use std::path::Path;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = Path::new("rtec.toml");
    let config = Config::parse(file, EMBEDDED)?;
    for axis in &config.axes {
        println!("{}: {} µm a count", axis.name, axis.count_um);
    }
    assert_eq!(config.axes.len(), 3);

    let wrong = EMBEDDED.replace("max_correction_counts", "max_corection_counts");
    let findings = Config::parse(file, &wrong).err().ok_or("a key that is none was not seen")?;
    println!("{findings}");
    assert!(findings.0.iter().all(|f| f.line > 0));
    Ok(())
}
