//! A bounded history for later questions.
//! It counts how often each fault was latched, and keeps the changes of each axis's ledger since homing.

use rtec_control::protocol::{LedgerPage, LedgerRow, word};
use rtec_rt::link_messages::{AxisStatus, CorrectorStatus, Event, EventKind};
use std::collections::{BTreeMap, VecDeque};

/// Number of changes of an axis's ledger that are kept.
const ROWS: usize = 8192;
/// Rows of one answer, which take a tenth of a millisecond of the control loop.
const PAGE: usize = 256;

#[derive(Debug, Default)]
pub(crate) struct FaultLedgerHistory {
    latched: BTreeMap<String, u64>,
    ledgers: Vec<LedgerRing>,
}

/// The ledger of one axis since homing, or since the daemon's start.
#[derive(Debug, Default)]
struct LedgerRing {
    rows: VecDeque<LedgerRow>,
    dropped: u64,
    /// Time, ns, and position, counts, at the last look.
    last: (u64, i64),
    /// The next look begins a new ledger.
    restart_pending: bool,
}

impl FaultLedgerHistory {
    pub(crate) fn new(axes: usize) -> Self {
        let fresh = || LedgerRing { restart_pending: true, ..LedgerRing::default() };
        Self { ledgers: (0..axes).map(|_| fresh()).collect(), ..Self::default() }
    }

    /// Notes an event.
    pub(crate) fn note(&mut self, event: &Event) {
        match event.kind {
            EventKind::Fault(fault) => *self.latched.entry(word(fault)).or_default() += 1,
            EventKind::Homed { .. } => {
                let axis = event.axis.and_then(|n| self.ledgers.get_mut(usize::from(n)));
                if let Some(ledger) = axis {
                    ledger.restart_pending = true;
                }
            }
            _ => {}
        }
    }

    /// Notes the changes of the axes' ledgers.
    pub(crate) fn look(&mut self, status: &CorrectorStatus) {
        for (ledger, axis) in self.ledgers.iter_mut().zip(status.axes()) {
            ledger.look(status.t_ns, axis);
        }
    }

    /// Number of times that each fault was latched.
    pub(crate) fn latched(&self) -> &BTreeMap<String, u64> {
        &self.latched
    }

    /// Changes of an axis's ledger from number `from` on.
    /// If that one is dropped, it begins with the oldest that is kept.
    pub(crate) fn ledger(&self, n: usize, from: u64) -> LedgerPage {
        let Some(ledger) = self.ledgers.get(n) else { return LedgerPage::default() };
        let first = from.clamp(ledger.dropped, ledger.dropped + ledger.rows.len() as u64);
        let rows = ledger.rows.iter().skip((first - ledger.dropped) as usize).take(PAGE);
        let rows: Vec<LedgerRow> = rows.copied().collect();
        LedgerPage {
            first,
            rows,
            end: ledger.dropped + ledger.rows.len() as u64,
            dropped: ledger.dropped,
            now_ns: ledger.last.0,
            now_counts: ledger.last.1,
        }
    }
}

impl LedgerRing {
    fn look(&mut self, t_ns: u64, axis: &AxisStatus) {
        let same = |row: &LedgerRow| {
            (row.requested, row.completed, row.in_effect, row.insertions)
                == (axis.requested, axis.completed, axis.in_effect, axis.insertions)
        };
        if self.restart_pending {
            *self = Self { last: (t_ns, axis.position_counts), ..Self::default() };
        }
        if !self.rows.back().is_some_and(same) {
            if self.rows.len() == ROWS {
                self.rows.pop_front();
                self.dropped += 1;
            }
            self.rows.push_back(LedgerRow {
                since_ns: self.last.0,
                since_counts: self.last.1,
                t_ns,
                position_counts: axis.position_counts,
                requested: axis.requested,
                completed: axis.completed,
                in_effect: axis.in_effect,
                insertions: axis.insertions,
            });
        }
        self.last = (t_ns, axis.position_counts);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(t_ns: u64, position_counts: i64, completed: i64, insertions: u64) -> CorrectorStatus {
        let mut status = CorrectorStatus { t_ns, axes_used: 1, ..CorrectorStatus::default() };
        let axis = &mut status.axes[0];
        (axis.position_counts, axis.requested, axis.completed) = (position_counts, completed, completed);
        (axis.in_effect, axis.insertions) = (completed, insertions);
        status
    }

    #[test]
    fn every_change_is_a_row_between_two_looks_and_homing_begins_anew() {
        let mut history = FaultLedgerHistory::new(1);
        for (t, position, completed, insertions) in
            [(10, 0, 0, 0), (20, 5, 0, 0), (30, 9, 2, 1), (40, 12, 2, 1), (50, 20, 2, 3)]
        {
            history.look(&status(t, position, completed, insertions));
        }
        let page = history.ledger(0, 0);
        let rows: Vec<_> =
            page.rows.iter().map(|r| (r.since_ns, r.t_ns, r.completed, r.insertions)).collect();
        assert_eq!(rows, [(10, 10, 0, 0), (20, 30, 2, 1), (40, 50, 2, 3)]);
        assert_eq!((page.first, page.end, page.dropped, page.now_ns, page.now_counts), (0, 3, 0, 50, 20));
        let homed = Event { t_ns: 60, axis: Some(0), kind: EventKind::Homed { kept_counts: 0 } };
        history.note(&homed);
        history.look(&status(70, 0, 0, 3));
        let page = history.ledger(0, 0);
        assert_eq!((page.rows.len(), page.rows[0].since_ns, page.dropped), (1, 70, 0));
    }

    #[test]
    fn what_is_too_much_is_dropped_and_counted() {
        let mut history = FaultLedgerHistory::new(1);
        let many = ROWS as u64 + 10;
        for n in 0..many {
            history.look(&status(n * 10, 0, n as i64 * 2, n));
        }
        let page = history.ledger(0, 3);
        assert_eq!((page.first, page.dropped, page.end, page.rows.len()), (10, 10, many, PAGE));
        assert_eq!(page.rows[0].insertions, 10);
        let last = history.ledger(0, many - 1);
        assert_eq!((last.rows.len(), last.first), (1, many - 1));
        assert!(history.ledger(0, many + 5).rows.is_empty());
        assert!(history.ledger(7, 0).rows.is_empty());
    }
}
