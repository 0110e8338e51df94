//! `rtecctl model load` and `unload`: choose the model that the daemon runs.

use crate::daemon_connection::{absolute, check, expected, unreachable};
use crate::prelude::*;
use rtec_control::protocol::{AxisTotalChange, ClientRequest, DaemonResponse, ModelChangePreview};
use rtec_files::text_file::open_regular;
use rtec_model::machine::Machine;
use std::fs::File;
use std::io::IsTerminal;

/// Show what a model changes right now, and have the daemon take it
///
/// A changed file takes effect only through this. Corrections go to their new place in a ramp.
#[derive(Debug, clap::Args)]
pub(crate) struct LoadArgs {
    /// The machine model [default: `[model] file` of the daemon's configuration]
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Take it without asking
    #[arg(long)]
    yes: bool,
    /// Take it although its validity has ended: somebody has looked at it
    #[arg(long)]
    expired: bool,
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn load(args: &LoadArgs) -> anyhow::Result<()> {
    let file = args.file.as_deref().map(absolute);
    // The daemon receives a user's files open. A missing file, or one with a mistake, is reported here.
    let own = file.as_ref().map(|file| Machine::read_with_files(Path::new(file))).transpose()?;
    let (warnings, own) = own.map(|(machine, own)| (machine.changed_sources(), own)).unwrap_or_default();
    let mut client = args.daemon.connect()?;
    let names: Vec<String> = own.iter().map(|f| f.display().to_string()).collect();
    let mut request = |take: Option<String>| -> anyhow::Result<DaemonResponse> {
        let files = own.iter().map(|f| open_regular(f)).collect::<Result<Vec<File>, _>>()?;
        let expired = take.is_some() && args.expired;
        let request = ClientRequest::ModelLoad { file: file.clone(), take, expired, files: names.clone() };
        check(client.ask_with(&request, &files).map_err(unreachable)?)
    };
    let mut preview = expected!(request(None)?, DaemonResponse::ModelPreview(preview) => preview);
    preview.warnings.splice(0..0, warnings);
    if args.daemon.json {
        say_line(&*preview)?;
    } else {
        print!("{}", table(&preview));
    }
    let refused = !preview.expired.is_empty() && !args.expired;
    let taken = refused || args.yes || agreed()?;
    ensure!(taken, No, "nothing is loaded; the daemon goes on as before");
    request(Some(preview.sha256))?;
    if !args.daemon.json {
        println!("loaded");
    }
    Ok(())
}

pub(crate) fn unload(daemon: &DaemonArgs) -> anyhow::Result<()> {
    daemon.order(&ClientRequest::ModelUnload {}, "model unloaded; corrections go back in a ramp")
}

pub(crate) fn again(daemon: &DaemonArgs) -> anyhow::Result<()> {
    daemon.order(&ClientRequest::ModelAgain {}, "model taken up again; corrections go to it in a ramp")
}

/// Asks the user; without a terminal the answer is no.
fn agreed() -> anyhow::Result<bool> {
    if !std::io::stdin().is_terminal() {
        eprintln!("no terminal to ask at: `--yes` loads it");
        return Ok(false);
    }
    let _asking = crate::progress::asking("take it? [y/N] ");
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer)?;
    Ok(matches!(answer.trim(), "y" | "Y" | "yes"))
}

fn table(p: &ModelChangePreview) -> String {
    let mut text = format!("model \"{}\", {}\nSHA-256 {}\n", p.name, p.file, p.sha256);
    for fit in &p.fits {
        let _ = writeln!(text, "{fit}");
    }
    for warning in &p.warnings {
        let _ = writeln!(text, "warning: {warning}");
    }
    text += "axis     now/counts       now/µm then/counts      then/µm    change/µm\n";
    for AxisTotalChange { axis, now_counts, now_um, then_counts, then_um, holds } in &p.axes {
        let change_um = then_um - now_um;
        let _ = writeln!(
            text,
            "{axis:<8} {now_counts:>10} {now_um:>12.3} {then_counts:>11} {then_um:>12.3} {change_um:>12.3}"
        );
        if let Some(why) = holds {
            let _ = writeln!(text, "{axis:<8} holds: {why}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_changes_is_shown_per_axis_in_counts_and_micrometres() {
        let preview: ModelChangePreview =
            serde_json::from_str(include_str!("../../../tests/golden/model_load.json")).unwrap();
        crate::golden("model_load.txt", &table(&preview));
    }
}
