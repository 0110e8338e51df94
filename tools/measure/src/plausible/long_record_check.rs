//! Suspicions in a record that is too long for memory, piece by piece.

use super::{MistakeKind, Suspicion, steps_of, suspicions};
use rtec_files::InputNotice;
use rtec_model::record::Record;

/// Suspicions of the pieces of a record read so far.
#[derive(Debug, Default)]
pub struct LongRecordSuspicions {
    /// Per piece: its rows as `first-last`, from 1, and its suspicions.
    found: Vec<(String, Vec<Suspicion>)>,
    steps: Vec<String>,
    rows: usize,
}

impl LongRecordSuspicions {
    /// Adds the suspicions of the next piece.
    pub fn see(&mut self, piece: &Record) {
        let one = std::slice::from_ref(piece);
        let rows = format!("{}-{}", piece.first_row() + 1, piece.first_row() + piece.rows());
        self.found.push((rows, suspicions(one)));
        self.steps.extend(steps_of(one));
        self.rows += piece.rows();
    }

    /// Reports the suspicions of all pieces as [`super::report_suspicions`] does.
    /// A suspicion of every piece as a whole is reported once, for the record.
    pub fn report_suspicions(self, say: &mut dyn FnMut(InputNotice)) -> Vec<Suspicion> {
        let alike = |a: &Suspicion, b: &Suspicion| {
            a.column == b.column && a.what == b.what && a.rows.is_empty() == b.rows.is_empty()
        };
        let pieces_with =
            |s: &Suspicion| self.found.iter().filter(|(_, own)| own.iter().any(|o| alike(o, s))).count();
        let mut all = Vec::new();
        for (number, (rows, own)) in self.found.iter().enumerate() {
            for s in own {
                let pieces = pieces_with(s);
                let everywhere = s.rows.is_empty() && pieces == self.found.len();
                // Jumps in several pieces show that something is switched.
                let switched = s.what == MistakeKind::Jump && s.sensor && pieces > 1;
                if switched || everywhere && number > 0 {
                    continue;
                }
                let rows = if s.rows.is_empty() && !everywhere { rows } else { &s.rows };
                all.push(Suspicion { rows: rows.clone(), of: self.rows, ..s.clone() });
            }
        }
        all.iter().map(ToString::to_string).chain(self.steps).for_each(|s| say(InputNotice::Warning(s)));
        all
    }
}
