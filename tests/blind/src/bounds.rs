//! Values that no machine exceeds, by law and parameter.
//! They come from the bounds in tools/guide/reference/effects.md, and from the sizes of machine tools. The cases are
//! within them, and every answer must be too.

/// Law, parameter, lowest and highest value.
/// Only arithmetic bounds what is not listed.
const BOUNDS: [(&str, &str, f64, f64); 36] = [
    ("offset", "um", -10_000.0, 10_000.0),
    ("scale", "ppm", -1000.0, 1000.0),
    ("screw_periodic", "period_mm", 0.5, 60.0),
    ("screw_periodic", "um", -1000.0, 1000.0),
    ("subdivision", "period_um", 1.0, 200.0),
    ("subdivision", "um", -50.0, 50.0),
    ("reversal", "um", -1000.0, 1000.0),
    ("reversal_spike", "um", -1000.0, 1000.0),
    ("reversal_spike", "length_mm", 0.0, 1e4),
    ("squareness", "urad", -5000.0, 5000.0),
    ("rotation", "urad", -10_000.0, 10_000.0),
    ("angular", "urad_per_m", -50_000.0, 50_000.0),
    ("thermal_expansion", "ppm_per_K", -200.0, 200.0),
    ("thermal_expansion", "reference_degC", 10.0, 30.0),
    ("thermal_growth", "um_per_K", -60.0, 60.0),
    ("thermal_growth", "um_per_K2", -60.0, 60.0),
    ("thermal_growth", "reference_degC", 10.0, 30.0),
    ("thermal_lag", "um_per_K", -60.0, 60.0),
    ("thermal_lag", "um_per_K2", -60.0, 60.0),
    ("thermal_lag", "reference_degC", 10.0, 30.0),
    ("thermal_lag", "tau_s", 0.0, 1e6),
    ("warm_up", "um", -10_000.0, 10_000.0),
    ("warm_up", "tau_s", 0.0, 1e6),
    ("coolant", "um", -1000.0, 1000.0),
    ("spindle_speed", "um_per_krpm", -500.0, 500.0),
    ("spindle_speed", "um_per_krpm2", -500.0, 500.0),
    ("following_error", "ms", -1000.0, 1000.0),
    ("acceleration_error", "um_per_m_s2", -10_000.0, 10_000.0),
    ("stiffness", "um_per_N", -100.0, 100.0),
    ("probe_lobing", "um", -1000.0, 1000.0),
    ("form_bump", "um", -10_000.0, 10_000.0),
    ("inertia", "kg", 0.0, 1e6),
    ("friction_viscous", "N_s_per_m", 0.0, 1e6),
    ("friction_coulomb", "N", 0.0, 1e6),
    ("friction_asymmetric", "N_s_per_m", -1e6, 1e6),
    ("force_offset", "N", -1e6, 1e6),
];

/// The values of an effect that no machine can have, as text.
/// `value` returns a parameter, where the effect has it.
pub(crate) fn beyond(name: &str, value: &dyn Fn(&str) -> Option<f64>) -> Vec<String> {
    let law = name.split('.').next().unwrap_or_default();
    let mut out = Vec::new();
    for (_, key, lo, hi) in BOUNDS.iter().filter(|(l, ..)| *l == law) {
        if let Some(v) = value(key).filter(|v| !(*lo..=*hi).contains(v)) {
            out.push(format!("{name} {key} {v}"));
        }
    }
    if let (true, Some(um), Some(period)) = (law == "subdivision", value("um"), value("period_um"))
        && um.abs() >= period / 4.0
    {
        out.push(format!("{name} um {um} at a period of {period}"));
    }
    out
}
