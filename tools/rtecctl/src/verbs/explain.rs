//! `rtecctl explain`: the components of each axis's correction.

use crate::daemon_connection::{NO_EVENTS, observe};
use crate::prelude::*;
use rtec_control::protocol::{
    AxisCorrectionComponents, ClientRequest, CorrectionComponent, DaemonResponse, SensorStateReport,
};

/// Split each axis's correction now into its effects, with sensor values and their age
///
/// Values are the errors that are taken out, µm; the axis is moved by their opposite. They sum to the correction.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The axis [default: all]
    axis: Option<String>,
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let response = args.daemon.ask(&ClientRequest::Explain { axis: args.axis.clone() })?;
    if let DaemonResponse::Explained { axes } = response
        && !args.daemon.json
    {
        print!("{}", table(&axes));
        if without_effect(&axes) {
            let seen = observe(&mut args.daemon.view()?, NO_EVENTS)?;
            let why = match (seen.status.model.is_some(), without_effect(&seen.explained)) {
                (false, _) => "no model is loaded: `rtecctl model load FILE`",
                (true, true) => "the model holds no effect: `rtecctl model fit` finds them",
                (true, false) => "the model holds no effect of this axis: `rtecctl explain` shows the others",
            };
            eprintln!("rtecctl: {why}");
        }
    }
    Ok(())
}

/// Components of a correction that are not effects of the model.
const NO_EFFECTS: [&str; 6] =
    ["part table", "operator", "on its way", "rounding", "not followed now", "beyond max_correction_counts"];

fn without_effect(axes: &[AxisCorrectionComponents]) -> bool {
    let mut parts = axes.iter().flat_map(|a| &a.parts);
    parts.all(|p| NO_EFFECTS.contains(&p.name.as_str()))
}

fn table(axes: &[AxisCorrectionComponents]) -> String {
    let mut text = String::new();
    for AxisCorrectionComponents { axis, requested, total_um, parts, holds } in axes {
        let _ = writeln!(text, "axis {axis}: {} µm, {requested:+} counts", um_text(*total_um));
        for CorrectionComponent { name, um, sensors, outside_k, weight } in parts {
            let mut note = list(sensors.iter().map(shown));
            if let (Some(k), Some(w)) = (outside_k, weight) {
                let _ = write!(note, "; {k:.1} K outside its range, {:.0} % left", 100.0 * w);
            }
            let line = format!("  {:>10}  {name:<24} {note}", um_text(*um));
            let _ = writeln!(text, "{}", line.trim_end());
        }
        if let Some(why) = holds {
            let _ = writeln!(text, "  holds: {why}");
        }
    }
    text
}

/// µm to the nanometre, as long as the value is not too large.
fn um_text(um: f64) -> String {
    if um.abs() < 1e6 { format!("{um:+.3}") } else { format!("{um:+.3e}") }
}

fn shown(r: &SensorStateReport) -> String {
    let value = match (r.degc, r.age_s) {
        (Some(degc), Some(age_s)) => format!("{degc:.2} °C, {age_s:.1} s old"),
        _ => "never read".to_owned(),
    };
    let state = if r.state == "good" { String::new() } else { format!(", {}", r.state) };
    let place = if r.place.is_empty() { String::new() } else { format!(" ({})", r.place) };
    format!("{}{place} {value}{state}", r.sensor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_sensors_and_why_it_holds() {
        let axes: Vec<AxisCorrectionComponents> =
            serde_json::from_str(include_str!("../../tests/golden/explain.json")).unwrap();
        crate::golden("explain.txt", &table(&axes));
        assert!(!without_effect(&axes) && !without_effect(&axes[1..]));
        let mut bare = axes;
        bare[0].parts.drain(..2);
        assert!(without_effect(&bare[..1]));
    }
}
