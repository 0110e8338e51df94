//! No number of a configuration causes a panic or reaches arithmetic unbounded.

use super::*;

/// No number of a configuration causes a panic.
/// It is refused, or engine and control law run with it. Arithmetic that overflows panics in tests.
#[test]
fn extreme_numbers_are_refused_or_run() {
    const KEYS: [&str; 27] = [
        "axis.count_um",
        "axis.travel_mm",
        "axis.max_correction_counts",
        "axis.window_counts",
        "axis.min_separation_ns",
        "axis.max_accel_mm_s2",
        "axis.max_accel_counts_s2",
        "axis.hysteresis_counts",
        "axis.warn_counts",
        "axis.error_counts",
        "axis.max_rate_counts_s",
        "axis.rest_quiet_ms",
        "axis.reference_budget_counts",
        "axis.home_mm",
        "rt.cpu",
        "rt.priority",
        "rt.detect_ns",
        "rt.write_ns",
        "rt.guard_ns",
        "control.stale_ms",
        "model.period_ms",
        "model.ramp_um_s",
        "model.lead_ms",
        "model.log_s",
        "sensor.timeout_s",
        "sensor.freeze_s",
        "sensor.max_rate_K_per_min",
    ];
    const VALUES: [&str; 20] = [
        "0",
        "1",
        "-1",
        "2",
        "4",
        "20",
        "99",
        "0.001",
        "0.0001",
        "0.05",
        "1e-308",
        "1000",
        "1000000",
        "1000000000",
        "1e9",
        "1e15",
        "1e308",
        "nan",
        "inf",
        "9223372036854775807",
    ];
    let mut dice = test_needs::dice::Dice::new(38);
    let (mut ran, mut refused) = (0, 0);
    for n in 0..4000 {
        let mut values = BTreeMap::from([
            ("axis.count_um", "1"),
            ("axis.travel_mm", "400"),
            ("axis.max_correction_counts", "1000"),
            ("axis.window_counts", "50"),
            ("axis.min_separation_ns", "500"),
            ("control.stale_ms", "500"),
        ]);
        // Each key with each value on its own, then several at once.
        let alone = n < KEYS.len() * VALUES.len();
        if alone {
            values.insert(KEYS[n / VALUES.len()], VALUES[n % VALUES.len()]);
        } else {
            for _ in 0..dice.within(2, 6) {
                let (key, value) = (dice.within(0, 26), dice.within(0, 19));
                values.insert(KEYS[key as usize], VALUES[value as usize]);
            }
        }
        let of = |table: &str| -> String {
            let own = values.iter().filter_map(|(key, value)| Some((key.strip_prefix(table)?, value)));
            let lines: Vec<String> =
                own.map(|(key, value)| format!("{} = {value}\n", key.trim_start_matches('.'))).collect();
            lines.concat()
        };
        let rest = if values.contains_key("axis.rest_quiet_ms") { "rest_policy = 'insert'\n" } else { "" };
        let text = format!(
            "[machine]\nname = 'm'\n[card]\nbackend = 'mock'\n[[axis]]\nname = 'x'\n{rest}{}[rt]\n{}[control]\n{}[model]\n{}\
             [[sensor]]\nname = 'T1'\nsource = 'line'\nfrom = '/dev/null'\n{}",
            of("axis"),
            of("rt"),
            of("control"),
            of("model"),
            of("sensor")
        );
        match Config::parse(Path::new("rtec.toml"), &text) {
            Ok(config) => {
                ran += 1;
                runs(&config);
            }
            Err(_) => refused += 1,
        }
    }
    assert!(ran > 200 && refused > 1000, "{ran} ran, {refused} refused");
}

/// Runs engine and control law there and back with the largest totals.
fn runs(config: &Config) {
    let mut card = Strokes::default();
    let machine = MachineConfig { lines: config.lines, may_arm: true };
    let Ok(mut engine) = Engine::new(&mut card, &config.engine_axes(), machine, &[]) else { return };
    engine.start_homed_at(&mut card, |n| config.axes[n].home_counts, &mut |_| true).expect("an engine");
    let law = config.axes.iter().map(rtec_control::config::ConfiguredAxis::axis_setup).collect();
    let mut corrector = Corrector::new(law, config.model.ramp_um_s, config.model.lead_ms * 1e-3, 0.0);
    for n in 0..600_u32 {
        if n % 100 == 0 {
            let max = config.axes[0].engine.max_correction_counts;
            for total_counts in [max, -max, 0] {
                let request = RequestToRt::Correct { axis: 0, total_counts, large: true };
                engine.take(request, &mut card, &mut |_| true).expect("taken");
            }
        }
        engine.poll(&mut card, u64::MAX, &mut |_| true).expect("told");
        corrector.tick(f64::from(n) * 0.01, &engine.status(), &[]);
    }
}

/// A card whose axis moves there and back, one edge per look, ever slower.
#[derive(Default)]
struct Strokes {
    t_ns: u64,
    looks: u64,
    outputs: u64,
}

impl Card for Strokes {
    fn sample(&mut self, _wake_ns: u64) -> Result<CardInputSample, CardError> {
        self.looks += 1;
        self.t_ns += 1 << (self.looks % 34);
        let place = if self.looks % 200 < 100 { self.looks } else { 400 - self.looks % 200 };
        Ok(CardInputSample::level(self.t_ns, [0, 1, 3, 2][place as usize % 4]))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// Replaces every number of a full configuration by every extreme.
/// It is refused, or the results are finite and an engine accepts them.
#[test]
fn no_number_reaches_arithmetic_unbounded() {
    const ALL: &str = "[machine]\nname = 'm'\n[card]\nbackend = 'mock'\n[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 500.0\n\
        max_correction_counts = 300\nwindow_counts = 50\nwarn_counts = 100\nerror_counts = 200\nmin_separation_ns = 500\n\
        max_accel_mm_s2 = 1000.0\nrapid_mm_min = 10000.0\nhysteresis_counts = 0.1\nmax_rate_counts_s = 1000.0\n\
        rest_policy = 'insert'\nrest_quiet_ms = 5.0\nreference_budget_counts = 400\nhome_mm = 10.0\n\
        simulated = { count_um = 2.0, compensates_ppm = 5.0 }\n[rt]\ncpu = 0\npriority = 80\ndetect_ns = 1000\n\
        write_ns = 300\nguard_ns = 100\n[control]\nstale_ms = 500\n[model]\nperiod_ms = 10\nramp_um_s = 5.0\nlead_ms = 20.0\n\
        log_s = 5.0\n[[sensor]]\nname = 'T1'\nsource = 'iio'\ndevice = 'd'\nchannel = 1\nperiod_s = 1.0\n\
        range_degC = [ -20.0, 120.0]\nmax_rate_K_per_min = 10.0\ntimeout_s = 5.0\nstuck_s = 600.0\nfreeze_s = 60.0\n";
    let accel = ALL.replace("max_accel_mm_s2", "max_accel_counts_s2");
    let mut tried = 0;
    for all in [ALL, &accel] {
        Config::parse(Path::new("rtec.toml"), all).unwrap();
        let begins = |before: &str| [" = ", ", "].iter().any(|b| before.ends_with(b));
        let numbers = all.char_indices().filter(|(n, _)| begins(&all[..*n]));
        for (at, _) in numbers.filter(|(_, c)| c.is_ascii_digit()) {
            let end = at + all[at..].find(|c: char| !c.is_ascii_digit() && c != '.').unwrap();
            for extreme in [
                "1e-308",
                "-1e-308",
                "1e308",
                "-1e308",
                "0",
                "-1",
                "inf",
                "-inf",
                "nan",
                "9223372036854775807",
            ] {
                let text = format!("{}{extreme}{}", &all[..at], &all[end..]);
                tried += 1;
                let Ok(config) = Config::parse(Path::new("rtec.toml"), &text) else { continue };
                let axis = &config.axes[0];
                let travel_counts = axis.travel_mm * 1000.0 / axis.simulated.count_um;
                let numbers =
                    [travel_counts, axis.engine.max_accel_counts_s2, axis.count_um, config.model.lead_ms];
                assert!(numbers.iter().all(|n| n.is_finite() && n.abs() < 1e16), "{text}");
                assert!(axis.home_counts.abs() < 1 << 52 && axis.engine.gate().is_some(), "{text}");
                assert!(
                    axis.corrected_hz().unwrap().is_finite() && axis.followed_hz().is_none_or(f64::is_finite)
                );
            }
        }
    }
    assert!(tried > 400, "{tried}");
}
