//! Judges a guided jog: sign, unit, and compensation by the controller itself.

use rtec_files::InputError;
use rtec_model::effect::STANDARD_DEGC;
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::machine::Machine;

/// Largest relative difference of indicator and scale; no machine errs by more.
const UNIT: f64 = 0.01;

/// Largest step of a model's correction from one moment to the next, µm.
/// Steps occur where the axis turns and where coolant comes on; all other effects creep or are part of a
/// motion. The model is evaluated at `places_mm`.
///
/// # Errors
/// The model has no effect on the axis, or reads what no machine has.
pub fn largest_step_um(machine: &Machine, axis: &str, places_mm: [f64; 3]) -> Result<f64, InputError> {
    let refused = |found: String, expected: &str| InputError::whole(&machine.path, found, expected);
    let mut layout = MachineStateLayout { sensors: machine.sensors(), ..MachineStateLayout::default() };
    for effect in machine.effects() {
        layout.axes.extend(effect.axes().iter().cloned());
        layout.channels.extend(effect.channel().map(str::to_owned));
    }
    layout.axes.sort();
    layout.axes.dedup();
    layout.channels.sort();
    layout.channels.dedup();
    let own = layout.axes.iter().position(|a| a.as_str() == axis);
    let own = own.ok_or_else(|| refused(format!("no effect on axis {axis}"), "the model of this machine"))?;
    let (degc, channels) = (vec![STANDARD_DEGC; layout.sensors.len()], vec![0.0; layout.channels.len()]);
    let mut axes = vec![AxisMotionState::default(); layout.axes.len()];
    let mut live = LiveModel::of(machine, layout)
        .map_err(|missing| refused(missing.to_string(), "a model of axes, sensors and channels"))?;
    let mut t_s = 0.0;
    let mut step_um: f64 = 0.0;
    for position_mm in places_mm {
        let mut before: Option<f64> = None;
        for (direction, coolant) in [(-1.0, 0.0), (1.0, 0.0), (1.0, 1.0), (-1.0, 1.0)] {
            t_s += 1.0;
            axes[own] = AxisMotionState { position_mm, direction, ..AxisMotionState::default() };
            let (axes, temperatures_degc) = (&axes[..], &degc[..]);
            live.evaluate(&MachineState {
                t_s,
                axes,
                temperatures_degc,
                channels: &channels,
                coolant,
                ..MachineState::default()
            });
            let now = live.errors_um()[own];
            step_um = before.map_or(step_um, |before| step_um.max((now - before).abs()));
            before = Some(now);
        }
    }
    Ok(step_um)
}

/// Readings of an axis at rest: display, indicator and scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JogReading {
    /// The controller's display, mm.
    pub display_mm: f64,
    /// The indicator at the axis, mm; NaN while it is off.
    pub indicator_mm: f64,
    /// The scale's count.
    pub scale_counts: i64,
    /// The controller's count minus the scale's, counts.
    pub in_effect: i64,
    /// Configured size of one count, µm.
    pub count_um: f64,
}

impl JogReading {
    /// The scale's position, mm.
    pub fn scale_mm(&self) -> f64 {
        self.scale_counts as f64 * self.count_um / 1000.0
    }

    /// Position in the feedback that the controller receives, mm.
    pub fn fed_mm(&self) -> f64 {
        (self.scale_counts + self.in_effect) as f64 * self.count_um / 1000.0
    }
}

/// Result of one check, in words.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct JogFinding {
    /// The finding as one word: `right`, `wrong_sign`, `wrong_unit`, …
    pub verdict: &'static str,
    /// The finding as a sentence, with the figures and what to do.
    pub text: String,
}

/// Judges sign and unit by a jog with the indicator; `None` if they are right.
pub fn judge_jog(a: &JogReading, b: &JogReading, tolerance_um: f64) -> Option<JogFinding> {
    let scale = b.scale_mm() - a.scale_mm();
    let indicator = b.indicator_mm - a.indicator_mm;
    let display = b.display_mm - a.display_mm;
    let moved = |mm: f64| mm.abs() * 1000.0 > 10.0 * tolerance_um;
    let both = format!("the indicator moved by {indicator:+.4} mm and the scale by {scale:+.4} mm");
    let (verdict, text) = if !moved(display) || !moved(indicator) {
        let moved = format!("the display moved by {display:+.4} mm and the indicator by {indicator:+.4} mm");
        ("not_jogged", format!("{moved}: too little to tell anything"))
    } else if !moved(scale) {
        let moved = format!("the axis moved by {indicator:+.4} mm and its scale by {scale:+.4} mm");
        ("wrong_scale", format!("{moved}: another scale is wired here"))
    } else if scale * indicator < 0.0 {
        let or = "(or the indicator's direction, if it counts backwards)";
        ("wrong_sign", format!("{both}: swap A and B of this axis {or}"))
    } else if (scale / indicator - 1.0).abs() > UNIT
        && (scale - indicator).abs() * 1000.0 > 2.0 * tolerance_um
    {
        let right = a.count_um * indicator / scale;
        ("wrong_unit", format!("{both}: count_um = {} should be about {right:.4}", a.count_um))
    } else {
        return None;
    };
    Some(JogFinding { verdict, text })
}

/// Compensation by the controller over the jog, µm: feedback less display.
pub fn compensation_um(a: &JogReading, b: &JogReading) -> f64 {
    1000.0 * ((b.fed_mm() - a.fed_mm()) - (b.display_mm - a.display_mm))
}

/// Judges by a long jog whether the controller compensates; `None` if it does not.
pub fn judge_compensation(a: &JogReading, b: &JogReading, tolerance_um: f64) -> Option<JogFinding> {
    let own_um = compensation_um(a, b);
    if own_um.abs() <= tolerance_um {
        return None;
    }
    let display = b.display_mm - a.display_mm;
    let text = format!(
        "the display moved by {display:+.4} mm and the feedback by {:+.4} mm: the controller compensates \
         {own_um:+.1} µm by itself; switch its own table off, or leave these effects out of the model",
        b.fed_mm() - a.fed_mm()
    );
    Some(JogFinding { verdict: "controller_compensates", text })
}

/// Judges how an insertion moved the scale; `None` if it moved as it should.
pub fn judge_insertion(before: &JogReading, after: &JogReading, inserted: i64) -> Option<JogFinding> {
    let moved = after.scale_counts - before.scale_counts;
    // A servo comes to rest within a count or two.
    let near = |counts: i64| (moved - counts).abs() <= 2;
    let (verdict, text) = if near(-inserted) {
        return None;
    } else if near(0) {
        let why = "the controller closes its loop on another encoder, or A' and B' do not reach it";
        ("controller_ignores", format!("{inserted:+} counts were inserted and the axis did not move: {why}"))
    } else {
        let how = if near(inserted) {
            ": the wrong way; check A' and B' at the controller".to_owned()
        } else {
            format!(" counts on its scale, expected {:+}", -inserted)
        };
        ("wrong_insertion", format!("{inserted:+} counts moved the axis by {moved:+}{how}"))
    };
    Some(JogFinding { verdict, text })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn at(display_mm: f64, indicator_mm: f64, scale_counts: i64) -> JogReading {
        JogReading { display_mm, indicator_mm, scale_counts, in_effect: 0, count_um: 0.5 }
    }

    fn verdict(b: JogReading) -> Option<&'static str> {
        judge_jog(&at(0.0, 0.0, 0), &b, 5.0).map(|f| f.verdict)
    }

    #[test]
    fn a_jog_names_sign_and_unit() {
        assert_eq!(verdict(at(10.0, 10.004, 20_003)), None);
        assert_eq!(verdict(at(-10.0, -9.998, -19_990)), None);
        assert_eq!(verdict(at(10.0, 10.0, -20_000)), Some("wrong_sign"));
        assert_eq!(verdict(at(10.0, 10.0, 40_000)), Some("wrong_unit"));
        assert_eq!(verdict(at(10.0, 10.0, 20_600)), Some("wrong_unit"));
        assert_eq!(verdict(at(10.0, 0.01, 20_000)), Some("not_jogged"));
        assert_eq!(verdict(at(10.0, 10.0, 3)), Some("wrong_scale"));
    }

    #[test]
    fn what_the_controller_adds_is_display_against_feedback_corrections_and_all() {
        let (a, b) = (at(0.0, 0.0, 0), JogReading { in_effect: -20, ..at(50.0, 50.0, 100_044) });
        assert!((compensation_um(&a, &b) - 12.0).abs() < 1e-9, "{}", compensation_um(&a, &b));
    }

    #[test]
    fn inserted_counts_move_the_axis_by_their_opposite() {
        let judge =
            |moved: i64| judge_insertion(&at(0.0, 0.0, 7), &at(0.0, 0.0, 7 + moved), 20).map(|f| f.verdict);
        assert_eq!((judge(-20), judge(-19)), (None, None));
        assert_eq!(
            (judge(0), judge(20), judge(-10)),
            (Some("controller_ignores"), Some("wrong_insertion"), Some("wrong_insertion"))
        );
    }

    #[test]
    fn the_window_is_three_of_the_largest_step() {
        let machine =
            |effects: &str| Machine::parse(Path::new("m.toml"), &format!("name = \"m\"\n{effects}")).unwrap();
        let step = |effects: &str| largest_step_um(&machine(effects), "x", [0.0, 10.0, 50.0]).unwrap();
        let reversal = "[[effect]]\nname = \"reversal.x\"\num = 6.0\n";
        let coolant = "[[effect]]\nname = \"coolant.x\"\num = -15.0\n";
        let growing = "[[effect]]\nname = \"reversal_slope.x\"\num_per_m = 40.0\n";
        let other =
            "[[effect]]\nname = \"reversal.y\"\num = 90.0\n[[effect]]\nname = \"scale.x\"\nppm = 500.0\n";
        for (effects, um) in [
            (reversal.to_owned(), 6.0),
            ([reversal, coolant].concat(), 15.0),
            ([reversal, growing].concat(), 8.0),
            ([reversal, other].concat(), 6.0),
        ] {
            assert!((step(&effects) - um).abs() < 1e-9, "{effects}: {}", step(&effects));
        }
        let window = crate::belief_window_counts;
        assert_eq!(
            (window(1.0, 6.0), window(0.5, 6.0), window(1.0, 0.0), window(20.0, 0.0)),
            (18, 36, 12, 2)
        );
        let none = largest_step_um(&machine(""), "x", [0.0; 3]).unwrap_err();
        assert!(none.to_string().contains("no effect on axis x"), "{none}");
    }
}
