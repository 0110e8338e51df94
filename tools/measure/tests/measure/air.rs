//! The refractive index of air against published tables.

use rtec_measure::iso230::AirState;

/// NIST Engineering Metrology Toolbox, "Index of Refraction of Air", table of the modified Edlén
/// equation: °C, %, kPa, nm, n; and n by Ciddor's equation.
const PUBLISHED: [(f64, f64, f64, f64, f64, f64); 14] = [
    (20.0, 0.0, 101.325, 633.0, 1.000_271_799, 1.000_271_800),
    (20.0, 0.0, 60.0, 633.0, 1.000_160_920, 1.000_160_924),
    (20.0, 0.0, 120.0, 633.0, 1.000_321_918, 1.000_321_916),
    (50.0, 0.0, 100.0, 633.0, 1.000_243_270, 1.000_243_285),
    (5.0, 0.0, 100.0, 633.0, 1.000_282_750, 1.000_282_756),
    (-40.0, 0.0, 100.0, 633.0, 1.000_337_471, 1.000_337_580),
    (50.0, 100.0, 120.0, 633.0, 1.000_287_864, 1.000_287_924),
    (40.0, 75.0, 120.0, 633.0, 1.000_299_406, 1.000_299_418),
    (20.0, 100.0, 100.0, 633.0, 1.000_267_394, 1.000_267_394),
    (40.0, 100.0, 110.0, 1700.0, 1.000_270_237, 1.000_270_247),
    (20.0, 0.0, 101.325, 1700.0, 1.000_268_483, 1.000_268_479),
    (40.0, 100.0, 110.0, 300.0, 1.000_288_922, 1.000_289_000),
    (20.0, 0.0, 101.325, 300.0, 1.000_286_579, 1.000_286_581),
    (-40.0, 0.0, 120.0, 300.0, 1.000_427_072, 1.000_427_233),
];

#[test]
fn the_index_is_the_published_one() {
    for (degc, rh_percent, kpa, nm, n, _) in PUBLISHED {
        let found = 1.0 + AirState { degc, kpa, rh_percent }.refractivity(nm);
        assert!((found - n).abs() < 6e-10, "{degc} °C, {rh_percent} %, {kpa} kPa, {nm} nm: {found}, {n}");
    }
}

/// In the air of a shop both equations differ by at most 0.012 µm per metre.
#[test]
fn the_other_equation_says_the_same_in_a_shop() {
    let mut seen = 0;
    for (degc, rh_percent, kpa, nm, _, n) in PUBLISHED {
        let off_um_per_m = 1e6 * (1.0 + AirState { degc, kpa, rh_percent }.refractivity(nm) - n);
        let in_a_shop = (5.0..=40.0).contains(&degc) && (nm - 633.0_f64).abs() < 0.5;
        seen += usize::from(in_a_shop);
        let most = if in_a_shop { 0.0125 } else { 0.17 };
        assert!(off_um_per_m.abs() < most, "{degc} °C, {rh_percent} %, {nm} nm: {off_um_per_m} µm/m");
    }
    assert_eq!(seen, 6);
}
