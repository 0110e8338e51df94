//! The judges accept right traces and catch wrong ones.
//! `.ci/run` installs them, and no test is skipped there.

use rtec_driver::trace_replay::TracePoint;
use rtec_files::quadrature_trace::{TraceFormat, TraceReader, TraceWriter};
use rtec_tests::judge::{LINUXCNC, LinuxCnc, SIGROK, Verdict, available, sigrok};
use rtec_tests::ledger;
use rtec_tests::planted_traces::{PlantedFault, corrected, motion};
use std::path::Path;

fn linuxcnc(trace: &[(TracePoint, i64)]) -> Verdict {
    let mut judge = LinuxCnc::new().unwrap();
    for (point, due) in trace {
        judge.show(point.state, *due).unwrap();
    }
    judge.verdict().unwrap()
}

/// Asserts that the first wrong count is at the planted fault.
fn assert_caught(verdict: Verdict, fault: PlantedFault) {
    let wrong = verdict.first_wrong.unwrap_or_else(|| panic!("{fault:?} was not caught: {verdict:?}"));
    assert!(verdict.wrong > verdict.judged / 4, "{fault:?} caught by chance only: {verdict:?}");
    assert!(wrong.state > verdict.judged / 4, "{fault:?} caught before it was there: {verdict:?}");
}

const FAULTS: [PlantedFault; 3] = [PlantedFault::Missing, PlantedFault::WrongOrder, PlantedFault::BothAtOnce];

#[test]
fn linuxcnc_counts_what_is_due_at_every_state() {
    if !available(LINUXCNC) {
        return;
    }
    let trace = corrected(&motion(500_000), 7, 500, PlantedFault::None);
    let verdict = linuxcnc(&trace);
    assert_eq!(verdict, Verdict { judged: trace.len() as u64, wrong: 0, first_wrong: None });
}

#[test]
fn linuxcnc_catches_every_planted_fault() {
    if !available(LINUXCNC) {
        return;
    }
    for fault in FAULTS {
        assert_caught(linuxcnc(&corrected(&motion(20_000), 7, 500, fault)), fault);
    }
}

#[test]
fn sigrok_counts_what_is_due_at_every_state_and_catches_every_planted_fault() {
    if !available(SIGROK) {
        return;
    }
    let trace = corrected(&motion(5000), 7, 500, PlantedFault::None);
    let verdict = sigrok(&trace).unwrap();
    assert_eq!(verdict, Verdict { judged: trace.len() as u64, wrong: 0, first_wrong: None });
    for fault in [PlantedFault::Missing, PlantedFault::WrongOrder] {
        assert_caught(sigrok(&corrected(&motion(5000), 7, 500, fault)).unwrap(), fault);
    }
    // It has no count for a double transition, so one of the states has none.
    let both = sigrok(&corrected(&motion(5000), 7, 500, PlantedFault::BothAtOnce)).unwrap_err().to_string();
    assert!(both.contains("sigrok counted"), "{both}");
}

/// The counts due, from the two traces alone, equal those of the generator.
#[test]
fn the_ledger_of_two_traces_is_the_planted_one() {
    let scale = motion(50_000);
    let trace = corrected(&scale, 7, 500, PlantedFault::None);
    let mut due = trace.iter();
    let totals =
        ledger::walk(scale.iter().map(|p| Ok(*p)), trace.iter().map(|(p, _)| Ok(*p)), |point, count| {
            assert_eq!(due.next(), Some(&(point, count)));
            Ok(())
        })
        .unwrap();
    assert!(totals.inversions > 5000, "{totals:?}");
    let (phases, fewest) = totals.phases_seen();
    assert!(phases == 16 && fewest > 20, "{totals:?}");
    assert_eq!(totals.scale_counts + totals.inserted, trace.last().unwrap().1);
}

#[test]
fn the_ledger_refuses_what_the_gates_cannot_have_made() {
    let scale = motion(5000);
    let walk = |trace: &[(TracePoint, i64)]| {
        ledger::walk(scale.iter().map(|p| Ok(*p)), trace.iter().map(|(p, _)| Ok(*p)), |_, _| Ok(()))
    };
    let both = walk(&corrected(&scale, 7, 500, PlantedFault::BothAtOnce)).unwrap_err().to_string();
    assert!(both.contains("both inverters turn at once"), "{both}");

    let mut late = corrected(&scale, 7, 500, PlantedFault::None);
    late[1].0.t_ns += 1;
    let late = walk(&late).unwrap_err().to_string();
    assert!(late.contains("is not in the MTC's trace"), "{late}");

    let mut short = corrected(&scale, 7, 500, PlantedFault::None);
    short.truncate(100);
    let short = walk(&short).unwrap_err().to_string();
    assert!(short.contains("is not in the MTC's trace"), "{short}");
}

/// A trace keeps its states in both file formats, on its way to the judges.
#[test]
fn a_planted_trace_survives_both_formats() {
    let trace = corrected(&motion(5000), 7, 500, PlantedFault::None);
    for format in [TraceFormat::Csv, TraceFormat::Vcd] {
        let mut writer = TraceWriter::new(format, Vec::new()).unwrap();
        for (point, _) in &trace {
            writer.write(*point).unwrap();
        }
        let text = writer.finish().unwrap();
        let back = TraceReader::new(format, Path::new("memory"), text.as_slice()).unwrap();
        assert!(back.map(Result::unwrap).eq(trace.iter().map(|(point, _)| *point)));
    }
}
