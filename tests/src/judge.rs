//! Counters of other programs, which judge the states at the MTC.

use crate::root;
use anyhow::{Context, ensure};
use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::TracePoint;
use rtec_files::quadrature_trace::AtomicTraceFile;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Result of a judge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Verdict {
    /// States at which its count was compared.
    pub judged: u64,
    /// States at which its count was wrong.
    pub wrong: u64,
    /// The first wrong count.
    pub first_wrong: Option<WrongCount>,
}

/// A state at which the judge's count is not the one that is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WrongCount {
    /// Number of the state, from 0.
    pub state: u64,
    /// Counts due since the first state.
    pub due: i64,
    /// Counts that the judge found.
    pub counted: i64,
}

impl Verdict {
    fn take(&mut self, due: i64, counted: i64) {
        if due != counted {
            self.wrong += 1;
            self.first_wrong.get_or_insert(WrongCount { state: self.judged, due, counted });
        }
        self.judged += 1;
    }
}

/// Whether the programs of a judge are installed; where not, the test ends.
/// The test then says so.
pub fn available(programs: &[&str]) -> bool {
    let missing: Vec<_> = programs.iter().filter(|p| !Path::new("/usr/bin").join(p).exists()).collect();
    if !missing.is_empty() {
        crate::skipped(&format!(
            "{missing:?} not there (Debian: linuxcnc-uspace linuxcnc-uspace-dev sigrok-cli)"
        ));
        return false;
    }
    let root = std::fs::metadata("/proc/self").is_ok_and(|own| own.uid() == 0);
    if programs == LINUXCNC && !root && !Path::new("/usr/lib/linuxcnc/modules/rtec_judge.so").exists() {
        crate::skipped("LinuxCNC lacks our component: sudo halcompile --install tests/judges/rtec_judge.c");
        return false;
    }
    true
}

/// Programs that [`LinuxCnc`] runs.
pub const LINUXCNC: &[&str] = &["halrun", "halcompile", "gcc"];
/// Programs that [`sigrok`] runs.
pub const SIGROK: &[&str] = &["sigrok-cli"];

/// LinuxCNC's `encoder` component (x4) in its own HAL.
/// It takes about a million states a second.
#[derive(Debug)]
pub struct LinuxCnc {
    directory: tempfile::TempDir,
    states: BufWriter<File>,
    due: BufWriter<File>,
}

/// TSC cycles of `encoder.update-counters` for three channels, measured by HAL.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cycles {
    /// Number of calls measured.
    pub calls: usize,
    /// Median of the three-channel update.
    pub p50: i32,
    /// 99th percentile of it.
    pub p99: i32,
    /// Median of an empty function: the cost of HAL's own measurement.
    /// The two values above contain it.
    pub empty_p50: i32,
}

impl LinuxCnc {
    /// A judge without any states.
    ///
    /// # Errors
    /// When there are no temporary files.
    pub fn new() -> anyhow::Result<Self> {
        let directory = tempfile::tempdir()?;
        let create = |name| File::create(directory.path().join(name)).map(BufWriter::new);
        let (states, due) = (create("states")?, create("due")?);
        Ok(Self { directory, states, due })
    }

    /// Shows the next state and the count that is due after it.
    ///
    /// # Errors
    /// When the disk is full.
    pub fn show(&mut self, state: State, due: i64) -> anyhow::Result<()> {
        self.states.write_all(&[state.bits()])?;
        Ok(self.due.write_all(&due.to_le_bytes())?)
    }

    fn run(self, period_ns: u64) -> anyhow::Result<(tempfile::TempDir, PathBuf)> {
        let Self { directory, states, due } = self;
        for mut file in [states, due] {
            file.flush()?;
        }
        let counts = directory.path().join("counts");
        let done = Command::new(root().join("tests/judges/linuxcnc-count"))
            .args([&directory.path().join("states"), &counts])
            .arg(period_ns.to_string())
            .stdin(Stdio::null())
            .output()
            .context("tests/judges/linuxcnc-count")?;
        ensure!(done.status.success(), "linuxcnc-count: {}", String::from_utf8_lossy(&done.stderr));
        Ok((directory, counts))
    }

    /// Lets LinuxCNC count all states, and compares at each.
    ///
    /// # Errors
    /// When LinuxCNC did not run.
    pub fn verdict(self) -> anyhow::Result<Verdict> {
        let (directory, counts) = self.run(1000)?;
        let mut due = BufReader::new(File::open(directory.path().join("due"))?);
        let mut counts = BufReader::new(File::open(counts)?);
        let (mut verdict, mut start) = (Verdict::default(), None);
        let (mut expected, mut record) = ([0; 8], [0; 12]);
        while due.read_exact(&mut expected).is_ok() {
            counts.read_exact(&mut record).context("LinuxCNC's counts end early")?;
            let counted = i64::from(word(&record, 0));
            // Its counter starts in state 00 at zero, so the step to the first state is no motion.
            let counted = counted - *start.get_or_insert(counted);
            verdict.take(i64::from_le_bytes(expected), counted);
        }
        Ok(verdict)
    }

    /// Measures the counter while it counts the states.
    /// It is called every `period_ns` (1000: without a pause).
    ///
    /// # Errors
    /// When LinuxCNC did not run.
    pub fn cycles(self, period_ns: u64) -> anyhow::Result<Cycles> {
        let (_directory, counts) = self.run(period_ns)?;
        let counts = std::fs::read(counts)?;
        let column = |n| {
            // The first two rows have no times, or times from before the thread ran smoothly.
            let mut column: Vec<i32> =
                counts.chunks_exact(12).skip(2).map(|record| word(record, n)).collect();
            column.sort_unstable();
            column
        };
        let (update, empty) = (column(1), column(2));
        ensure!(!update.is_empty(), "too few states to measure");
        let at = |sorted: &[i32], percent: usize| sorted[(sorted.len() - 1) * percent / 100];
        Ok(Cycles {
            calls: update.len(),
            p50: at(&update, 50),
            p99: at(&update, 99),
            empty_p50: at(&empty, 50),
        })
    }
}

fn word(record: &[u8], n: usize) -> i32 {
    let mut bytes = [0; 4];
    bytes.copy_from_slice(&record[4 * n..4 * n + 4]);
    i32::from_le_bytes(bytes)
}

/// Largest number of states that sigrok gets at a time.
/// This version leaks references and may end after millions of states.
const PIECE: usize = 200_000;

/// sigrok's graycode decoder; it takes some ten thousand states a second.
#[derive(Debug, Default)]
pub struct Sigrok {
    /// States not judged yet, with the counts due.
    /// The first one is the last of the part before.
    piece: Vec<(State, i64)>,
    verdict: Verdict,
}

impl Sigrok {
    /// Shows the next state and the count that is due after it.
    ///
    /// # Errors
    /// When sigrok did not run, or did not finish the states so far.
    pub fn show(&mut self, state: State, due: i64) -> anyhow::Result<()> {
        self.piece.push((state, due));
        if self.piece.len() > PIECE { self.count() } else { Ok(()) }
    }

    /// The verdict on all states.
    ///
    /// # Errors
    /// As [`Sigrok::show`], or when there are no states.
    pub fn verdict(mut self) -> anyhow::Result<Verdict> {
        ensure!(!self.piece.is_empty(), "an empty trace");
        if self.piece.len() > 1 || self.verdict.judged == 0 {
            self.count()?;
        }
        Ok(self.verdict)
    }

    /// Lets sigrok count a part of the states, through VCD.
    /// Its count is of states, not of times. The states follow each other evenly, because it works through every
    /// nanosecond.
    fn count(&mut self) -> anyhow::Result<()> {
        let directory = tempfile::tempdir()?;
        let vcd = directory.path().join("mtc.vcd");
        let mut file = AtomicTraceFile::create(&vcd)?;
        // It reports a state when the next one comes, and never the last. Two more edges make it report all of ours.
        let last = self.piece[self.piece.len() - 1].0;
        let more = [last.next(true), last.next(true).next(true)];
        for (n, state) in self.piece.iter().map(|(state, _)| *state).chain(more).enumerate() {
            file.write(TracePoint { t_ns: 2 * n as u64, state })?;
        }
        file.finish()?;
        let done = Command::new("sigrok-cli")
            .args(["-I", "vcd", "-P", "graycode:d0=a:d1=b", "-A", "graycode=count", "-i"])
            .arg(&vcd)
            .stdin(Stdio::null())
            .output()
            .context("sigrok-cli")?;
        // Its exit status says nothing: this version may crash at its end, after it has printed everything.
        let printed = String::from_utf8_lossy(&done.stdout);
        let counts: Vec<i64> = printed.lines().filter_map(|l| l.rsplit(' ').next()?.parse().ok()).collect();
        ensure!(
            counts.len() >= self.piece.len(),
            "sigrok counted {} of {} states: {}",
            counts.len(),
            self.piece.len(),
            String::from_utf8_lossy(&done.stderr)
        );
        // It counts from zero in every part, and the first state of a later part was judged in the part before.
        let (before, known) = (self.piece[0].1, usize::from(self.verdict.judged > 0));
        for ((_, due), counted) in self.piece.iter().zip(counts).skip(known) {
            self.verdict.take(*due, before + counted);
        }
        self.piece.drain(..self.piece.len() - 1);
        Ok(())
    }
}

/// Lets sigrok count a trace, and compares at every state.
///
/// # Errors
/// As [`Sigrok::show`].
pub fn sigrok(trace: &[(TracePoint, i64)]) -> anyhow::Result<Verdict> {
    let mut judge = Sigrok::default();
    for (point, due) in trace {
        judge.show(point.state, *due)?;
    }
    judge.verdict()
}
