//! Probe trips, late looks, and cards that sleep or count for themselves.

use super::*;

#[test]
fn the_probe_captures_between_two_edges_and_corrections_stand_still() {
    let mut rig = Rig::running(windowed());
    rig.step(10);
    rig.take(RequestToRt::Probe(true));
    rig.correct(2);
    assert_eq!((rig.refusals(), rig.status().mode), (vec![Refusal::Probing], CorrectorMode::Probe));
    // Looks are 100 ns and counts 10 µs apart. The probe trips after a quarter of a count.
    rig.card.count += 1;
    rig.card.inputs = rig.card.inputs & !3 | [0, 1, 3, 2][rig.card.count.rem_euclid(4) as usize];
    rig.looks(25);
    rig.card.inputs |= PROBE;
    rig.looks(5);
    rig.card.inputs &= !PROBE;
    rig.looks(5);
    rig.card.inputs |= PROBE;
    rig.looks(65);
    rig.step(1);
    let capture =
        rig.events.iter().find_map(|e| if let EventKind::Trip(c) = e.kind { Some(c) } else { None }).unwrap();
    let (position, half_width) = capture.position_counts();
    assert!((position - 11.25).abs() < 0.02, "{position} ± {half_width}: {capture:?}");
    assert!(half_width < 0.02);
    assert!(rig.events.iter().any(|e| e.kind == EventKind::Bounce));
    assert_eq!(rig.status().axes[0].completed, 0);
}

#[test]
fn a_trip_before_the_axis_stops_is_reported_as_that() {
    let mut rig = Rig::running(windowed());
    rig.step(-3);
    rig.take(RequestToRt::Probe(true));
    rig.card.inputs |= PROBE;
    rig.looks(2);
    rig.card.t_ns += 200_000_000;
    rig.looks(2);
    let capture =
        rig.events.iter().find_map(|e| if let EventKind::Trip(c) = e.kind { Some(c) } else { None }).unwrap();
    assert_eq!((capture.after, capture.position_counts()), (None, (-2.0, 1.0)));
}

/// The edge at a look may be as old as the look before a late one.
/// A late look may have read its lines long before the time that it reports.
#[test]
fn a_trip_seen_right_after_a_late_look_may_be_as_old_as_the_look_before_it() {
    for (late_ns, early_ns) in [(0, 100), (10_000_000, 10_000_200)] {
        let mut rig = Rig::running(windowed());
        rig.step(3);
        rig.take(RequestToRt::Probe(true));
        rig.looks(1000);
        rig.card.t_ns += late_ns;
        rig.looks(1);
        rig.card.inputs |= PROBE;
        rig.looks(1);
        let seen_ns = rig.card.t_ns;
        rig.card.t_ns += 200_000_000;
        rig.looks(2);
        let trip = |e: &Event| if let EventKind::Trip(c) = e.kind { Some(c.trip_ns) } else { None };
        assert_eq!(rig.events.iter().find_map(trip), Some((seen_ns - early_ns, seen_ns)), "{late_ns}");
    }
}

#[test]
fn an_axis_on_its_way_that_shows_no_change_after_a_late_look_may_have_gone_round() {
    for (late_ns, latched) in [(1_000_000, false), (10_000_000, true)] {
        let mut rig = Rig::running(windowed());
        rig.step(1);
        // After four counts the lines are as they were.
        rig.card.count += 4;
        rig.card.t_ns += late_ns;
        rig.looks(1);
        assert_eq!(rig.faults().contains(&Fault::PollGap), latched, "{late_ns} ns late");
        assert_eq!(rig.status().mode == CorrectorMode::Fault, latched, "{late_ns} ns late");
    }
    // An axis that came to rest latches no fault.
    let mut rig = Rig::running(windowed());
    rig.step(3);
    rig.looks(1000);
    rig.faults();
    rig.card.t_ns += 10_000_000;
    rig.looks(1);
    assert!(!rig.faults().contains(&Fault::PollGap));
}

/// The same card, asleep until a line changes.
#[derive(Default)]
struct Sleeper(Bench);

impl Card for Sleeper {
    const SLEEPS: bool = true;

    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        self.0.sample(wake_ns)
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.0.write(mask, value)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        self.0.outputs()
    }
}

/// A polled card's latency is the time from look to look.
/// Self-test and gate use this figure. It includes the time when the process was kept away. The time before the first
/// look belongs to the set-up.
#[test]
fn a_polled_cards_latency_is_the_time_between_two_looks() {
    let mut rig = Rig::with(windowed(), true);
    let found = |rig: &Rig| {
        let gaps = rig.engine.timing().poll_gap_ns.snapshot();
        (gaps.samples(), gaps.min(), gaps.max())
    };
    rig.card.t_ns += 5_000_000;
    rig.looks(1);
    assert_eq!(rig.engine.timing().poll_gap_ns.snapshot().samples(), 0, "no look was before it");
    rig.looks(10);
    assert_eq!(found(&rig), (10, 100, 100));
    rig.card.says = Some(CardInputSample { waited_ns: 7000, ..CardInputSample::level(0, 0) });
    rig.looks(1);
    assert_eq!(found(&rig), (11, 100, 7100));
    // The age of a timestamped edge is another figure.
    rig.card.says = Some(CardInputSample::stamped(0, 0, Some(1)));
    rig.looks(3);
    assert_eq!(found(&rig), (11, 100, 7100));
}

/// A sleeping card's latency is the age of an edge when it is seen.
/// The time without an edge is no latency.
#[test]
fn a_sleeping_cards_latency_is_the_age_of_an_edge() {
    let config = AxisConfig { lines: AxisLines::standard(0, false), ..windowed() };
    let mut rig = Rig::on(Sleeper::default(), config, true);
    rig.looks(2);
    rig.card.0.t_ns += 60_000_000_000;
    rig.looks(5);
    assert_eq!(rig.engine.timing().poll_gap_ns.snapshot().samples(), 0, "no edge, no age");
    let seen_ns = rig.card.0.t_ns + 100;
    rig.card.0.says = Some(CardInputSample::stamped(0, 0, Some(seen_ns - 42)));
    rig.looks(1);
    let gaps = rig.engine.timing().poll_gap_ns.snapshot();
    assert_eq!((gaps.samples(), gaps.min(), gaps.max()), (1, 42, 42));
    // Later looks without an edge.
    rig.card.0.says = None;
    rig.looks(5);
    assert_eq!(rig.engine.timing().poll_gap_ns.snapshot().samples(), 1);
}

#[test]
fn a_late_look_before_the_second_edge_is_judged_from_rest() {
    // From rest at 1e6 counts/s² three counts take 2.4 ms. So a gap of 1 ms loses no counts, and one of 10 ms may.
    for (late_ns, latched) in [(1_000_000, false), (10_000_000, true)] {
        let mut rig = Rig::running(windowed());
        rig.step(1);
        rig.card.count += 1;
        rig.card.inputs = rig.card.inputs & !3 | [0, 1, 3, 2][rig.card.count.rem_euclid(4) as usize];
        rig.card.t_ns += late_ns;
        rig.looks(1);
        assert_eq!(rig.faults().contains(&Fault::PollGap), latched, "{late_ns} ns late");
    }
}

#[test]
fn nothing_is_written_while_a_further_change_is_known() {
    let mut rig = Rig::running(windowed());
    rig.step(3);
    let before = rig.card.writes;
    rig.correct(2);
    rig.card.says = Some(CardInputSample { more: true, ..CardInputSample::level(0, 0) });
    rig.step(1);
    assert_eq!(rig.card.writes, before);
    // The last queued change shows where the axis is. From then on the engine may act.
    rig.card.says = None;
    rig.step(1);
    assert_eq!((rig.card.writes - before, rig.status().axes[0].completed), (2, 2));
    assert!(rig.status().balanced() && rig.faults().is_empty());
}

#[test]
fn a_card_that_counts_for_itself_may_be_looked_at_late() {
    let mut rig = Rig::running(windowed());
    rig.step(3);
    rig.card.says = Some(CardInputSample { complete: 0b11, ..CardInputSample::level(0, 0) });
    rig.card.t_ns += 1_000_000_000;
    rig.step(3);
    assert!(rig.faults().is_empty() && rig.status().balanced());
}

#[test]
fn the_read_back_waits_for_levels_of_this_very_moment() {
    let mut rig = Rig::wired_back(Bench::default(), windowed());
    // A' and B' stay as they were, because the gate does not follow. That is unknown until they are read.
    rig.card.says = Some(CardInputSample { fresh: 0, ..CardInputSample::level(0, 0) });
    rig.step(3);
    rig.correct(2);
    rig.step(2);
    assert_eq!((rig.status().axes[0].completed, rig.faults().len()), (2, 0));
    rig.card.says = None;
    rig.looks(2);
    assert_eq!(rig.faults(), [Fault::ReadBackMismatch]);
}

/// A card whose A' and B' are those of `behind_ns` ago, as with slow receivers.
struct Following {
    bench: Bench,
    behind_ns: u64,
    was: Vec<(u64, u64)>,
}

impl Card for Following {
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        let sample = self.bench.sample(wake_ns)?;
        let now = (self.bench.inputs ^ self.bench.outputs) & 0b11;
        if self.was.last().is_none_or(|(_, back)| *back != now) {
            self.was.push((sample.t_ns, now));
        }
        let back = self.was.iter().rev().find(|(t_ns, _)| t_ns + self.behind_ns <= sample.t_ns);
        Ok(CardInputSample { inputs: sample.inputs | back.map_or(0, |(_, back)| back << 2), ..sample })
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.bench.write(mask, value)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        self.bench.outputs()
    }
}

/// Regression: an input filter of a microsecond was latched as a fault.
/// A' and B' were compared at the first look after a write.
#[test]
fn a_read_back_that_follows_within_the_mtcs_separation_is_no_fault() {
    for (behind_ns, follows) in [(0, true), (100, true), (400, true), (2_000, false)] {
        let card = Following { bench: Bench::default(), behind_ns, was: Vec::new() };
        let mut rig = Rig::wired_back(card, AxisConfig::default());
        for n in 0..200_u64 {
            let total_counts = if n % 40 < 20 { 6 } else { -6 };
            rig.take(RequestToRt::Correct { axis: 0, total_counts, large: true });
            rig.card.bench.inputs = [0, 1, 3, 2][n as usize % 4];
            // An edge every 5 µs, and ten looks a microsecond.
            rig.looks(50);
        }
        let (axis, faults) = (rig.status().axes[0], rig.faults());
        if follows {
            assert!(faults.is_empty() && axis.insertions > 20, "{behind_ns} ns behind: {faults:?}, {axis:?}");
        } else {
            assert_eq!(faults, [Fault::ReadBackMismatch], "{behind_ns} ns behind");
        }
    }
}

/// The machine's own lines are read at the look that shows them.
/// That also holds when two of them change at once, at rest and in regular motion.
#[test]
fn a_switch_is_seen_though_the_probe_trips_with_it() {
    for lines in [SWITCH, SWITCH | PROBE] {
        let mut rig = Rig::running(windowed());
        rig.step(4);
        rig.card.inputs |= lines;
        rig.looks(1);
        assert_eq!(rig.status().mode, CorrectorMode::Disabled, "{lines:#x}");
    }
}
