//! The engine's fast path against its full path, for any requests.
//! It also tests what a kill leaves in the state file.

use super::*;
use crate::axis::InsertionAtRestPolicy;
use crate::journal::STORES;
use proptest::prelude::*;
use rtec_driver::card::AxisLines;

/// A card in memory whose looks a test controls.
#[derive(Debug, Default)]
struct Lines {
    t_ns: u64,
    inputs: u64,
    outputs: u64,
    tells: bool,
}

impl Card for Lines {
    fn sample(&mut self, _wake_ns: u64) -> Result<CardInputSample, CardError> {
        Ok(CardInputSample::level(self.t_ns, self.inputs))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        Ok(self.tells.then_some(self.t_ns + 20))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// Events before a look: edges of two axes, the machine's lines, a request.
#[derive(Debug, Clone, Copy)]
enum Before {
    Steps(i8, i8),
    Probe,
    Disable,
    Stale(bool),
    Latch,
    Request(RequestToRt),
}

fn request() -> impl Strategy<Value = RequestToRt> {
    let axis = 0..2_u8;
    prop_oneof![
        8 => (axis.clone(), -7..=7_i64, any::<bool>())
            .prop_map(|(axis, total_counts, large)| RequestToRt::Correct { axis, total_counts, large }),
        1 => (axis.clone(), 0..2_i64, any::<bool>()).prop_map(|(axis, position_counts, controller_homed)| {
            RequestToRt::Home { axis, position_counts, controller_homed }
        }),
        2 => (axis, 0..2_i64)
            .prop_map(|(axis, position_counts)| RequestToRt::ConfirmHome { axis, position_counts }),
        3 => Just(RequestToRt::Enable),
        1 => Just(RequestToRt::Disable),
        1 => Just(RequestToRt::Shadow),
        1 => any::<bool>().prop_map(RequestToRt::Probe),
        1 => any::<bool>().prop_map(|on| RequestToRt::Hold { on, by: 0 }),
        2 => Just(RequestToRt::Clear),
    ]
}

fn before() -> impl Strategy<Value = Before> {
    let step = || prop_oneof![6 => Just(1_i8), 1 => Just(-1), 3 => Just(0), 1 => Just(2)];
    prop_oneof![
        40 => (step(), step()).prop_map(|(x, y)| Before::Steps(x, y)),
        1 => Just(Before::Probe),
        1 => Just(Before::Disable),
        1 => any::<bool>().prop_map(Before::Stale),
        1 => Just(Before::Latch),
        6 => request().prop_map(Before::Request),
    ]
}

fn step(inputs: &mut u64, axis: u8, counts: i8) {
    let lines = AxisLines::standard(axis, false);
    let state = lines.scale(*inputs);
    let next = if counts == 2 { state.inverted(3) } else { state.next(counts > 0) };
    for (bit, level) in [(lines.a, next.a()), (lines.b, next.b())] {
        *inputs = *inputs & !(1 << bit) | u64::from(level) << bit;
    }
}

/// An engine, and a second one that never takes the fast path.
#[derive(Debug)]
struct One {
    engine: Engine,
    card: Lines,
    told: Vec<Event>,
    careful: bool,
}

impl One {
    fn new(tells: bool, rest: InsertionAtRestPolicy, careful: bool) -> Self {
        let axis = |n| AxisConfig {
            lines: AxisLines::standard(n, false),
            max_accel_counts_s2: 1e9,
            rest,
            window_counts: 8,
            warn_counts: 6,
            error_counts: 7,
            ..AxisConfig::default()
        };
        let mut card = Lines { t_ns: 1, tells, ..Lines::default() };
        let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
        let mut engine = Engine::new(&mut card, &[axis(0), axis(1)], machine, &[]).unwrap();
        engine.start_homed(&mut card, &mut |_| true).unwrap();
        Self { engine, card, told: Vec::new(), careful }
    }

    fn look(&mut self, before: Before, gap_ns: u64) {
        self.happens(before);
        self.poll(gap_ns);
    }

    fn happens(&mut self, before: Before) {
        let Self { engine, card, told, careful } = self;
        let mut report = |event| {
            told.push(event);
            true
        };
        let own = engine.machine.lines;
        match before {
            Before::Steps(x, y) => {
                for (axis, counts) in [(0, x), (1, y)].into_iter().filter(|(_, counts)| *counts != 0) {
                    step(&mut card.inputs, axis, counts);
                }
            }
            Before::Probe => card.inputs ^= own.probe.map_or(0, |bit| 1 << bit),
            Before::Disable => card.inputs ^= own.disable.map_or(0, |bit| 1 << bit),
            Before::Stale(stale) => engine.set_control_stale(stale, &mut report),
            Before::Latch => engine.latch(Some(1), Fault::PollGap, card, &mut report).unwrap(),
            Before::Request(request) => {
                engine.take(request, card, &mut report).unwrap();
                if *careful {
                    engine.wake_all();
                    engine.update_mode(card, &mut report).unwrap();
                }
            }
        }
    }

    fn poll(&mut self, gap_ns: u64) {
        let Self { engine, card, told, careful } = self;
        if *careful {
            engine.axes.iter_mut().for_each(AxisEngine::take_care);
        }
        card.t_ns += gap_ns;
        let mut report = |event| {
            told.push(event);
            true
        };
        engine.poll(card, u64::MAX, &mut report).unwrap();
    }
}

proptest! {
    /// An engine with fast paths for edges and totals equals one without them.
    /// The requests are arbitrary.
    #[test]
    fn calm_edges_change_nothing_whatever_is_asked(
        looks in prop::collection::vec((before(), 100_u64..2000), 1..400),
        tells in any::<bool>(),
        rest in prop_oneof![Just(InsertionAtRestPolicy::Wait), (500..5000_u64).prop_map(|after_ns| InsertionAtRestPolicy::Insert { after_ns })],
    ) {
        let [mut calm, mut careful] = [false, true].map(|careful| One::new(tells, rest, careful));
        for (before, gap_ns) in looks {
            for one in [&mut calm, &mut careful] {
                one.look(before, gap_ns);
            }
            prop_assert_eq!(&calm.told, &careful.told);
            prop_assert_eq!(&calm.card.outputs, &careful.card.outputs);
            prop_assert_eq!(format!("{:?}", calm.engine.status()), format!("{:?}", careful.engine.status()));
        }
    }
}

fn kept() -> impl Strategy<Value = Before> {
    let home = |(axis, controller_homed)| RequestToRt::Home { axis, position_counts: 0, controller_homed };
    prop_oneof![
        2 => any::<bool>().prop_map(|on| Before::Request(RequestToRt::Hold { on, by: 7 })),
        2 => Just(Before::Request(RequestToRt::Clear)),
        2 => Just(Before::Latch),
        1 => (0..2_u8, any::<bool>()).prop_map(home).prop_map(Before::Request),
        1 => (0..2_u8, -8..=8_i64)
            .prop_map(|(axis, total_counts)| RequestToRt::Correct { axis, total_counts, large: true })
            .prop_map(Before::Request),
        1 => Just(Before::Steps(2, 0)),
        3 => Just(Before::Steps(1, 1)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// A kill between two stores to the state file leaves a whole record.
    /// It is the one before or the one after. No record looks damaged, and feed hold is never on without a reason.
    #[test]
    fn a_kill_at_any_store_is_no_damage(steps in prop::collection::vec((kept(), 100_u64..2000), 1..24)) {
        let folder = tempfile::tempdir().unwrap();
        let [file, copy] = ["state", "copy"].map(|name| folder.path().join(name));
        let open = |file| Journal::open(file, "kills").unwrap();
        let mut one = One::new(true, InsertionAtRestPolicy::Insert { after_ns: 100 }, false);
        one.engine.keep_journal(open(&file).0).unwrap();
        let mut found = None;
        for (what, gap_ns) in steps.into_iter().flat_map(|(what, ns)| [(Some(what), 0), (None, ns)]) {
            let mut bytes = std::fs::read(&file).unwrap();
            STORES.take();
            match what {
                Some(what) => one.happens(what),
                None => one.poll(gap_ns),
            }
            let stores = STORES.take();
            let records = |bytes: &[u8]| {
                std::fs::write(&copy, bytes).unwrap();
                let (_, before) = open(&copy);
                assert!(!before.hold_unexplained() && before.damaged == [false; MAX_AXES], "{before:?}");
                let mut all: Vec<_> = before.records.iter().map(|r| format!("{:?}", r[0])).collect();
                all.push(format!("{:?}", before.machine));
                all
            };
            let first = found.unwrap_or_else(|| records(&bytes));
            let last = records(&std::fs::read(&file).unwrap());
            for (word, value) in stores {
                bytes[8 * word..][..8].copy_from_slice(&value.to_le_bytes());
                for (n, now) in records(&bytes).iter().enumerate() {
                    prop_assert!(*now == first[n] || *now == last[n], "{what:?}, row {n}: {now}");
                }
            }
            found = Some(last);
        }
    }
}
