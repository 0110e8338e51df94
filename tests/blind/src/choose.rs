//! Random error sources that a run can show.

use crate::dice::Dice;
use crate::plan::Plan;
use crate::run::Run;
use crate::source::{Source, flatten};
use std::f64::consts::{PI, TAU};

/// Arrangement of the places of an experiment.
#[derive(Clone, Copy, Debug)]
pub struct Places {
    /// All at one step, so a wave cannot be told from its aliases.
    pub regular: bool,
    /// Many places, each visited once.
    pub sweep: bool,
}

impl Plan {
    /// A random source of a law that a run of this plan can show.
    /// `None` where it cannot show the law.
    pub fn source(&self, dice: &mut Dice, run: &Run, law: &str) -> Option<Source> {
        source(dice, run, law, Places { regular: self.regular, sweep: self.design == "sweep" })
    }

    /// A random shape outside the dictionary that this run can show.
    pub fn stranger(&self, dice: &mut Dice, run: &Run) -> Option<Source> {
        stranger(dice, run, self.speed_constant)
    }
}

/// A random source of a law that a run can show, or `None`.
pub fn source(dice: &mut Dice, run: &Run, law: &str, places: Places) -> Option<Source> {
    let resp = dice.pick(&run.responses).clone();
    let (head, a) = resp.split_once('.')?;
    let force = head == "force";
    let p = run.get(&format!("position.{a}"));
    let span = |v: &[f64]| v.iter().fold((f64::MAX, f64::MIN), |(l, h), &x| (l.min(x), h.max(x)));
    let time = run.time();
    let (t0, t1) = (time[0], time[run.n - 1]);
    let name = format!("{law}.{a}");
    let needs = |ok: bool| ok.then_some(());
    if force != (law.starts_with("friction") || law == "inertia" || law == "force_offset") {
        return None;
    }
    let varies = |role: String| {
        run.has(&role)
            && run.get(&role).is_some_and(|v| {
                let (l, h) = span(v);
                h > l
            })
    };
    let others: Vec<&str> =
        run.cols.iter().filter_map(|c| c.role.strip_prefix("position.")).filter(|b| *b != a).collect();
    let sensors = run.names("temperature");
    let thermal = |dice: &mut Dice, s: Source| {
        let mut s = s;
        let one = dice.pick(&sensors).clone();
        if sensors.len() > 2 && dice.chance(0.3) {
            let two = sensors.iter().rev().find(|x| **x != one)?.clone();
            s.text = vec![("sensor", one), ("minus", two)];
        } else {
            s.text = vec![("sensor", one)];
            if dice.chance(0.25) {
                s = s.p("reference_degC", (dice.within(18.0, 24.0) * 2.0).round() / 2.0);
            }
        }
        Some(s)
    };
    let line = |dice: &mut Dice, v: &[f64], name: String| {
        let (lo, hi) = span(v);
        let k = dice.int(4, 11);
        let mut distinct: Vec<i64> = v.iter().map(|x| (x * 1000.0).round() as i64).collect();
        distinct.sort_unstable();
        distinct.dedup_by(|a, b| (*a - *b).abs() < 300);
        if distinct.len() < 5 {
            return None;
        }
        let k = k.min(distinct.len() - 1).max(4);
        let knots: Vec<f64> = (0..k).map(|i| lo + (hi - lo) * i as f64 / (k - 1) as f64).collect();
        let mut walk = 0.0;
        let mut um: Vec<f64> = (0..k)
            .map(|_| {
                walk = 0.5 * walk + dice.normal();
                walk
            })
            .collect();
        flatten(&knots, &mut um);
        let mut s = Source::new(name);
        s.arr = vec![("knots_mm", knots), ("um", um)];
        Some(s)
    };
    Some(match law {
        "offset" => Source::new(name).p("um", dice.sign()),
        "force_offset" => Source::new(name).p("N", dice.sign()),
        "scale" => {
            needs(varies(format!("position.{a}")))?;
            Source::new(name).p("ppm", dice.sign())
        }
        "position_map" => line(dice, p?, name)?,
        "straightness" => {
            let b = *others.first()?;
            let v = run.get(&format!("position.{b}"))?;
            line(dice, v, format!("straightness.{a}.{b}"))?
        }
        "screw_periodic" => {
            let (lo, hi) = span(p?);
            let mut gaps: Vec<f64> = p?.to_vec();
            gaps.sort_by(f64::total_cmp);
            gaps.dedup_by(|x, y| (*x - *y).abs() < 0.01);
            // At few places a wave is also a map, a scale or an offset.
            needs(gaps.len() >= 8)?;
            let step = (hi - lo) / gaps.len() as f64;
            let period =
                *dice.pick(&[2.0, 4.0, 5.0, 6.0, 10.0, 12.0, 16.0, 20.0, 25.0]) * dice.within(0.97, 1.03);
            needs(
                period < (hi - lo) / 2.5 && (period > 2.3 * step || (!places.regular && period > 0.5 * step)),
            )?;
            Source::new(name).p("period_mm", period).p("um", 1.0).p("phase_rad", dice.within(-PI, PI))
        }
        "subdivision" => {
            let mut met: Vec<i64> = p?.iter().map(|p| (p * 1e4).round() as i64).collect();
            met.sort_unstable();
            met.dedup();
            needs(met.len() > 50 && (places.sweep || !places.regular))?;
            let period = if dice.chance(0.5) {
                *dice.pick(&[2.0, 4.0, 10.0, 20.0, 40.0, 100.0])
            } else {
                dice.log(4.0, 150.0)
            };
            Source::new(name).p("period_um", period).p("um", 1.0).p("phase_rad", dice.within(-PI, PI))
        }
        "reversal" => {
            needs(
                span(&run.dir(a)).1 > span(&run.dir(a)).0
                    && !run.dir(a).is_empty()
                    && run.dir(a).len() == run.n,
            )?;
            Source::new(name).p("um", dice.sign())
        }
        "reversal_spike" => {
            let d = run.dir(a);
            needs(d.len() == run.n && run.kind != "probing")?;
            let (lo, hi) = span(p?);
            let length = (hi - lo) * dice.log(0.01, 0.15);
            let turns = d.windows(2).filter(|w| w[0] * w[1] < 0.0).count();
            needs(turns >= 2)?;
            Source::new(name).p("um", dice.sign()).p("length_mm", length)
        }
        "squareness" => {
            needs(run.responses.len() == 1)?;
            Source::new(format!("squareness.{a}.{}", others.first()?)).p("urad", dice.sign())
        }
        "rotation" => {
            needs(run.responses.len() == 2)?;
            let mut ab: Vec<&str> = run.responses.iter().map(|r| &r[6..]).collect();
            ab.sort_unstable();
            needs(run.has(&format!("position.{}", ab[0])) && run.has(&format!("position.{}", ab[1])))?;
            Source::new(format!("rotation.{}.{}", ab[0], ab[1])).p("urad", dice.sign())
        }
        "angular" => {
            needs(others.len() >= 2)?;
            let mut bc = [others[0], others[1]];
            bc.sort_unstable();
            Source::new(format!("angular.{a}.{}.{}", bc[0], bc[1])).p("urad_per_m", dice.sign())
        }
        "thermal_expansion" => {
            needs(!sensors.is_empty() && varies(format!("position.{a}")))?;
            let s = Source::new(name).p("ppm_per_K", dice.sign());
            thermal(dice, s)?
        }
        "thermal_growth" => {
            needs(!sensors.is_empty())?;
            let k2 = if dice.chance(0.4) { dice.within(-0.05, 0.05) } else { 0.0 };
            let s = Source::new(name).p("um_per_K", dice.sign()).p("um_per_K2", k2);
            thermal(dice, s)?
        }
        "thermal_lag" => {
            needs(!sensors.is_empty() && run.n > 80)?;
            let tau = (t1 - t0) * dice.log(0.03, 0.3);
            let s = Source::new(name).p("um_per_K", dice.sign()).p("um_per_K2", 0.0).p("tau_s", tau);
            thermal(dice, s)?
        }
        "warm_up" => Source::new(name).p("um", dice.sign()).p("tau_s", (t1 - t0) * dice.log(0.04, 0.5)),
        "coolant" => {
            needs(varies("coolant".into()))?;
            Source::new(name).p("um", dice.sign())
        }
        "spindle_speed" => {
            needs(varies("spindle_speed".into()))?;
            let k2 = if dice.chance(0.4) { dice.within(-0.06, 0.06) } else { 0.0 };
            Source::new(name).p("um_per_krpm", dice.sign()).p("um_per_krpm2", k2)
        }
        "following_error" => {
            needs(run.kind != "probing" && varies(format!("velocity.{a}")))?;
            Source::new(name).p("ms", dice.sign())
        }
        "acceleration_error" => {
            needs(varies(format!("acceleration.{a}")))?;
            Source::new(name).p("um_per_m_s2", dice.sign())
        }
        "stiffness" => {
            needs(varies(format!("load.{a}")))?;
            Source::new(name).p("um_per_N", dice.sign())
        }
        "lost_counts" => Source::new(name)
            .p("um", dice.sign())
            .p("at_s", ((t0 + (t1 - t0) * dice.within(0.15, 0.85)) * 10.0).round() / 10.0),
        "probe_latency" => {
            needs(run.kind == "probing" && varies(format!("velocity.{a}")))?;
            Source::new(name).p("us", dice.sign())
        }
        "probe_lobing" => {
            needs(run.has("angle"))?;
            Source::new("probe_lobing".into())
                .p("um", 1.0)
                .p("lobes", dice.int(2, 6) as f64)
                .p("phase_rad", dice.within(-PI, PI))
        }
        "form_bump" => {
            needs(run.has("angle"))?;
            Source::new("form_bump".into())
                .p("um", dice.sign())
                .p("centre_rad", dice.within(0.0, TAU))
                .p("width_rad", dice.log(0.25, 2.5))
        }
        "channel" => {
            let z = run.names("channel");
            needs(!z.is_empty())?;
            Source::new(format!("channel.{a}.{}", dice.pick(&z))).p("gain", dice.sign())
        }
        // Masses are positive, and friction opposes motion.
        "inertia" => Source::new(name).p("kg", dice.sign().abs()),
        "friction_viscous" => Source::new(name).p("N_s_per_m", dice.sign().abs()),
        "friction_asymmetric" => Source::new(name).p("N_s_per_m", dice.sign()),
        "friction_coulomb" => Source::new(name).p("N", dice.sign().abs()),
        _ => return None,
    })
}

/// A random shape outside the dictionary that this run can show.
pub fn stranger(dice: &mut Dice, run: &Run, one_speed: bool) -> Option<Source> {
    let resp = dice.pick(&run.responses).clone();
    let a = resp.split_once('.')?.1.to_owned();
    let has = |role: &str| run.has(&format!("{role}.{a}"));
    let mut can: Vec<(&str, f64)> = vec![];
    if resp.starts_with("force") {
        can.extend([
            ("?f_speed_squared", 0.0),
            ("?f_stribeck", 0.0),
            ("?f_cogging", dice.within(4.0, 9.0)),
            ("?f_position_friction", 0.0),
        ]);
    } else {
        let d = run.dir(&a);
        if has("position") && d.len() == run.n && run.kind != "probing" {
            can.push(("?dir_times_wave", dice.within(0.7, 2.0)));
        }
        // In a single turn the angle is the time, and a burst is a bump of the shape.
        let once = run.get("angle").is_some_and(|w| w.windows(2).all(|w| w[1] >= w[0]));
        if !once {
            can.extend([
                ("?time_wave", dice.within(1.5, 6.0)),
                ("?time_burst", dice.within(-0.7, 0.7)),
                ("?time_saw", dice.within(1.5, 4.0)),
            ]);
        }
        if run.kind == "feed_sweep" || (run.kind == "ballbar" && !one_speed) {
            can.extend([("?speed_squared", 0.0), ("?stribeck", 0.0)]);
        }
        if !run.names("temperature").is_empty() {
            can.extend([
                ("?temperature_wave", dice.within(1.5, 3.0)),
                ("?temperature_knee", dice.within(-0.3, 0.5)),
            ]);
        }
        if run.has("angle") {
            can.extend([("?angle_square", dice.int(1, 3) as f64), ("?angle_saw", dice.int(1, 4) as f64)]);
        }
        if has("position") && run.kind == "positioning" {
            can.extend([("?drifting_scale", 0.0), ("?position_time_wave", dice.within(0.8, 2.0))]);
        }
        if has("load") {
            can.push(("?load_squared", 0.0));
        }
    }
    let (law, c) = *dice.pick(&can);
    let mut s = Source::new(format!("{law}.{a}")).p("um", dice.sign()).p("c", c);
    if law.starts_with("?temp") {
        s.text = vec![("sensor", dice.pick(&run.names("temperature")).clone())];
    }
    Some(s)
}
