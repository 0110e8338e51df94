//! Time of a whole reconciliation: 5000 rows of 25 channels.
//!
//! It prints wall-clock time and processor time, beside the baseline's on the same data.
//! `cargo bench -p rtec-blind [-- ROWS]`

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use rtec_blind::baseline;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use rtec_reconcile::{ReconciliationOptions, reconcile};
use std::path::Path;
use std::time::Instant;

/// Processor time of all threads of this program, s.
/// On a shared machine it says more than the wall-clock time.
fn cpu_s() -> anyhow::Result<f64> {
    let used = nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_SELF)?;
    let s = |time: nix::sys::time::TimeVal| time.tv_sec() as f64 + time.tv_usec() as f64 * 1e-6;
    Ok(s(used.user_time()) + s(used.system_time()))
}

/// A function's result, its wall-clock time and its processor time, s.
fn timed<T>(what: impl FnOnce() -> T) -> anyhow::Result<(T, f64, f64)> {
    let (start, cpu) = (Instant::now(), cpu_s()?);
    let out = what();
    Ok((out, start.elapsed().as_secs_f64(), cpu_s()? - cpu))
}

/// Time limit for 5000 rows and 25 channels, s.
const ASKED_S: f64 = 0.5;

/// A simulated day of an axis that moves up and down its travel.
/// It has eight wandering temperatures and twelve logged channels. The model lacks a lagging growth and a reversal
/// error.
fn day(rows: usize) -> anyhow::Result<Record> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(17);
    let mut noise = || (0..12).map(|_| rng.next_u64() as f64 / u64::MAX as f64).sum::<f64>() - 6.0;
    let axis = Axis::new("y").ok_or_else(|| anyhow::anyhow!("an axis"))?;
    let mut columns: Vec<(String, Role, Vec<f64>)> = Vec::new();
    let time: Vec<f64> = (0..rows).map(|i| i as f64 * 17.0).collect();
    let leg = |i: usize| i as f64 / 40.0;
    let at = |i: usize| {
        let phase = leg(i).rem_euclid(2.0);
        500.0 * if phase < 1.0 { phase } else { 2.0 - phase }
    };
    let up = |i: usize| if leg(i).rem_euclid(2.0) < 1.0 { 1.0 } else { -1.0 };
    let mut lag = 0.0;
    let mut error = vec![0.0; rows];
    for k in 0..8 {
        let mut t = 20.0 + f64::from(k) * 0.4;
        let data: Vec<f64> = (0..rows)
            .map(|i| {
                let load = if (i / 900) % 2 == 0 { 8.0 / f64::from(k + 1) } else { 0.0 };
                t += (20.0 + load - t) / (60.0 + 25.0 * f64::from(k)) + 0.02 * noise();
                t
            })
            .collect();
        if k == 2 {
            for (e, t) in error.iter_mut().zip(&data) {
                lag += (t - 20.0 - lag) / 40.0;
                *e += 3.0 * lag;
            }
        }
        columns.push((format!("T{k}"), Role::Temperature, data));
    }
    for k in 0..12 {
        let mut x = 0.0;
        let data = (0..rows)
            .map(|_| {
                x = 0.9 * x + noise();
                x
            })
            .collect();
        columns.push((format!("z{k}"), Role::Channel, data));
    }
    for (i, e) in error.iter_mut().enumerate() {
        *e += 2.0 * up(i) + 0.8 * noise();
    }
    columns.push(("t".into(), Role::Time, time));
    columns.push(("y".into(), Role::Position(axis.clone()), (0..rows).map(at).collect()));
    columns.push(("dir".into(), Role::Direction(axis.clone()), (0..rows).map(up).collect()));
    columns.push(("vy".into(), Role::Velocity(axis.clone()), (0..rows).map(|i| 20.0 * up(i)).collect()));
    columns.push(("n".into(), Role::Cycle, (0..rows).map(|i| (leg(i) / 2.0).floor()).collect()));
    columns.push(("e".into(), Role::Error(axis), error));
    let columns = columns
        .into_iter()
        .map(|(name, role, data)| Column { unit: role.unit().unwrap_or("1").to_owned(), name, role, data })
        .collect();
    Ok(Record::new(Path::new("day.run.toml"), RunKind::Positioning, columns)?)
}

fn main() -> anyhow::Result<()> {
    let rows = std::env::args().skip(1).find(|a| a != "--bench").map_or(Ok(5000), |a| a.parse())?;
    let record = day(rows)?;
    let machine = Machine::ideal("bench");
    let channels = record.columns.len() - 1;
    let (answer, ours, our_cpu) =
        timed(|| reconcile(std::slice::from_ref(&record), &[], &machine, &ReconciliationOptions::default()))?;
    let answer = answer?;
    let names: Vec<String> = answer.effects.iter().map(|(f, _)| f.effect.name()).collect();
    println!("{rows} rows, {channels} channels: {} {names:?}", answer.verdict);
    let (theirs, bic, bic_cpu) = timed(|| baseline::forward_bic(&[record], &machine))?;
    println!("forward selection by BIC: {theirs:?}");
    println!("              by the clock   of processors");
    println!("reconcile     {ours:8.2} s   {our_cpu:11.2} s   (asked: {ASKED_S} s)");
    println!("BIC           {bic:8.2} s   {bic_cpu:11.2} s");
    println!("ratio         {:8.2}     {:11.2}", ours / bic, our_cpu / bic_cpu);
    Ok(())
}
