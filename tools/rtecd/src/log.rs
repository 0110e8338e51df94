//! Standard error, fit for the journal: one line per message, with systemd's level prefix where it listens, and never a
//! flood. What standard error does not take at once is left out: the control loop never waits for a reader, and a full
//! disk is no reason to die.

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::collections::BTreeMap;
use std::io::Write;
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

/// Levels of syslog(3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Level {
    Error = 3,
    Warning = 4,
    Notice = 5,
    Info = 6,
}

/// Messages of one kind that are written in [`PERIOD`]; the others are counted.
const BURST: u32 = 20;
const PERIOD: Duration = Duration::from_secs(10);

struct Window {
    begun: Instant,
    written: u32,
    left_out: u32,
}

pub(crate) struct Log {
    journal: bool,
    kinds: BTreeMap<String, Window>,
}

impl Log {
    pub(crate) fn new() -> Self {
        // systemd sets this where standard error is its journal (systemd.exec(5)).
        Self { journal: std::env::var_os("JOURNAL_STREAM").is_some(), kinds: BTreeMap::new() }
    }

    pub(crate) fn say(&self, level: Level, text: &str) {
        let line = if self.journal {
            format!("<{}>{text}\n", level as u8)
        } else {
            let word = match level {
                Level::Error => "error: ",
                Level::Warning => "warning: ",
                Level::Notice | Level::Info => "",
            };
            format!("rtecd: {word}{text}\n")
        };
        let mut stderr = std::io::stderr();
        // A pipe that says it can be written takes a line whole, without waiting (pipe(7)).
        let mut ready = [PollFd::new(stderr.as_fd(), PollFlags::POLLOUT)];
        if poll(&mut ready, PollTimeout::ZERO).is_ok_and(|n| n > 0) {
            let _ = stderr.write_all(line.as_bytes()); // there is nowhere to say that it failed
        }
    }

    /// As [`Log::say`], for what may come in floods: `kind` is what is counted.
    pub(crate) fn event(&mut self, level: Level, kind: &str, text: &str) {
        let now = Instant::now();
        let window =
            self.kinds.entry(kind.to_owned()).or_insert(Window { begun: now, written: 0, left_out: 0 });
        let mut before = 0;
        if now.duration_since(window.begun) > PERIOD {
            before = window.left_out;
            *window = Window { begun: now, written: 0, left_out: 0 };
        }
        let write = window.written < BURST;
        if write {
            window.written += 1;
        } else {
            window.left_out += 1;
        }
        if before > 0 {
            self.say(level, &format!("{kind}: {before} more of these were left out"));
        }
        if write {
            self.say(level, text);
        }
    }
}
