//! Counter cards, and the card's commands beside a running daemon.

use rtec_driver::card_profile::Width;
use rtec_driver::mapped_registers::MappedRegisterFile;
use rtec_driver::quadrature::State;
use rtec_tests::daemon::{Bench, CONFIG, Lines, alone, program, until};
use serde_json::json;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicI16, AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// A counter card in a file.
///
/// A flag is cleared by writing zeros, because memory can do no more. Lines and count are in one word, so that one
/// write changes both, as one edge does in hardware.
const PROFILE: &str = "name = 'counter card'\nsource = 'tests'\ninputs = [{ register = 0, width = 16 }]\n\
    outputs = [{ register = 4, width = 32 }]\n[lines]\na = { input = 0 }\nb = { input = 1 }\ninvert_a = { output = 0 }\n\
    invert_b = { output = 1 }\nhold = { output = 28 }\n\
    [[counter]]\na = 0\nb = 1\nlatch = { register = 8, width = 32, value = 1 }\ncount = { register = 2, width = 16 }\n\
    overflow = { register = 20, width = 32, bit = 0 }\nerror = { register = 20, width = 32, bit = 1 }\n\
    clear = { register = 20, width = 32, value = 0 }\n";
const OUTPUTS: usize = 4;
const LATCH: usize = 8;
const FLAGS: usize = 20;
/// Time between two counts of a burst, too short for a look per count.
const BURST: Duration = Duration::from_micros(60);

/// The card's side of the registers: a decoder in hardware, for the daemon.
struct Counter {
    words: MappedRegisterFile,
    state: State,
    count: u16,
    /// Counts left in a burst, always whole cycles.
    burst: Arc<AtomicU32>,
    /// Wrong counts that the decoder adds at the next look.
    wrong: Arc<AtomicI16>,
}

impl Counter {
    fn step(&mut self, to: State) {
        self.count = self.count.wrapping_add(if self.state.next(true) == to { 1 } else { u16::MAX });
        self.state = to;
        self.set();
    }

    fn set(&mut self) {
        self.words.write(0, Width::Bits32, u32::from(self.count) << 16 | u32::from(self.state.bits()));
    }
}

impl Lines for Counter {
    fn outputs(&mut self) -> u64 {
        u64::from(self.words.read(OUTPUTS, Width::Bits32))
    }

    fn show(&mut self, scale: State) {
        if scale != self.state {
            self.step(scale);
        }
        for _ in 0..self.burst.swap(0, Ordering::AcqRel) {
            let since = Instant::now();
            self.step(self.state.next(true));
            while since.elapsed() < BURST {
                std::hint::spin_loop();
            }
        }
        self.count = self.count.wrapping_add_signed(self.wrong.swap(0, Ordering::AcqRel));
        self.set();
    }
}

#[test]
fn a_counter_card_counts_for_us_and_its_flags_are_latched() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let (burst, wrong) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicI16::new(0)));
    let config = CONFIG
        .replace(
            "file = 'CARD'\nhold = 'out28'\nprobe = 'in28'\ndisable = 'in29'",
            "file = 'card'\nprofile = 'counter.toml'\nhold = 'hold'",
        )
        .replace("'in0'", "'a'")
        .replace("'in1'", "'b'")
        .replace("'out0'", "'invert_a'")
        .replace("'out1'", "'invert_b'");
    let bench = Bench::on(&config, |file| {
        std::fs::write(file.with_file_name("counter.toml"), PROFILE).unwrap();
        let words = MappedRegisterFile::open(file, 24, "counter card").unwrap();
        let (burst, wrong) = (Arc::clone(&burst), Arc::clone(&wrong));
        // Just below the counter's wrap.
        let mut counter = Counter { words, state: State::default(), count: 0xff00, burst, wrong };
        counter.set();
        counter
    });
    let words = MappedRegisterFile::open(&bench.at("card"), 24, "test").unwrap();
    let daemon = bench.daemon();
    assert_eq!(words.read(LATCH, Width::Bits32), 1, "the count is latched before it is read");
    bench.go();
    bench.correct(4);
    bench.balances();
    let count = || words.read(0, Width::Bits32) >> 16;
    assert_eq!(count() >> 8, 0xff, "before its wrap");

    // More counts than any looks could see. None is lost, through the counter's wrap, beside the MTC's four.
    let from =
        bench.x()["position_counts"].as_i64().unwrap() - bench.machine.seen.scale.load(Ordering::Relaxed);
    let mut made = 0;
    for counts in [40_000, 28_000] {
        burst.store(counts, Ordering::Release);
        made += i64::from(counts);
        until("every count is taken", || {
            let scale = bench.machine.seen.scale.load(Ordering::Relaxed);
            burst.load(Ordering::Acquire) == 0 && bench.x()["position_counts"] == from + made + scale
        });
        assert_eq!((&bench.x()["faults"], &daemon.status()["balanced"]), (&json!([]), &true.into()));
    }
    assert!((1000..4000).contains(&count()), "through its wrap, twice");
    bench.correct(-2);
    bench.balances();

    // A flag of the card, and a decoder that contradicts its lines.
    for (fault, provoke) in [
        ("counter_overflow", &(|| words.write(FLAGS, Width::Bits32, 1)) as &dyn Fn()),
        ("counter_error", &|| words.write(FLAGS, Width::Bits32, 2)),
        ("counter_error", &|| wrong.store(1, Ordering::Release)),
    ] {
        provoke();
        until("the fault is latched", || !bench.x()["faults"].as_array().unwrap().is_empty());
        let (status, x) = (daemon.status(), bench.x());
        assert_eq!(
            (&status["mode"], &x["homed"], &x["faults"][0]),
            (&"fault".into(), &false.into(), &fault.into())
        );
        until("feed hold, and the card's flag cleared", || {
            bench.outputs() >> 28 & 1 == 1 && words.read(FLAGS, Width::Bits32) == 0
        });
        assert_eq!(bench.user(&["status"]).0, Some(4));
        assert_eq!(bench.user(&["clear"]).0, Some(0));
        until("nothing latched", || bench.x()["faults"].as_array().unwrap().is_empty());
        bench.go();
    }
    bench.correct(2);
    assert_eq!(bench.machine.illegal(), 0);
}

fn drive(config: &Path) -> (Option<i32>, String) {
    let mut command = Command::new(program("rtecctl"));
    command.args(["card", "probe", "--drive", "--mtc-is-off", "--config"]).arg(config);
    let run = command.output().unwrap();
    (run.status.code(), String::from_utf8_lossy(&run.stderr).into_owned())
}

/// Regression: outputs were switched under a running daemon.
#[test]
fn outputs_are_not_driven_while_a_daemon_has_them() {
    let _alone = alone();
    let bench = Bench::with("[control]\nsocket = 's'\n");
    let daemon = bench.daemon();
    bench.go();
    bench.correct(2);
    let (code, text) = drive(&bench.at("rtec.toml"));
    assert!(code == Some(1) && text.contains("another rtecd (process"), "{code:?} {text}");
    assert!(text.contains("stop it first"), "{text}");
    // The same card in a configuration without that daemon.
    let other =
        std::fs::read_to_string(bench.at("rtec.toml")).unwrap().replace("socket = 's'", "socket = 'other'");
    std::fs::write(bench.at("other.toml"), other).unwrap();
    let (code, text) = drive(&bench.at("other.toml"));
    assert!(code == Some(1) && text.contains("holds the card"), "{code:?} {text}");
    bench.balances();
    assert_eq!((daemon.status()["mode"].clone(), bench.machine.offset()), ("run".into(), 2));
    daemon.end("TERM");
    bench.machine.move_axis(false);
    assert_eq!(drive(&bench.at("rtec.toml")).0, Some(0));
    assert!(bench.machine.inverted(), "as they were");
}
