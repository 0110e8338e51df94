//! `rtecctl top` in a real terminal, which tmux runs, types into and reads.

use rtec_tests::daemon::{Daemon, alone, program, until};
use rtec_tests::skipped;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A terminal of tmux.
pub(crate) struct Terminal {
    server: PathBuf,
}

impl Terminal {
    /// A terminal that runs `rtecctl top`.
    fn start(directory: &Path, socket: &Path, size: (u16, u16), variables: &str) -> Self {
        Self::of(directory, &["top", "--every", "100ms"], socket, size, variables)
    }

    /// A terminal that runs `rtecctl` with these words and then prints its exit code.
    /// It has a tmux server of its own.
    pub(crate) fn of(
        directory: &Path,
        words: &[&str],
        socket: &Path,
        size: (u16, u16),
        variables: &str,
    ) -> Self {
        let terminal = Self { server: directory.join(format!("tmux-{}-{}", size.0, variables.len())) };
        let command = format!(
            "{variables} {} {} --socket {}; echo ended with $?; sleep 60",
            program("rtecctl").display(),
            words.join(" "),
            socket.display()
        );
        let (width, height) = (size.0.to_string(), size.1.to_string());
        terminal.tmux(&["-f", "/dev/null", "new-session", "-d", "-x", &width, "-y", &height, &command]);
        terminal
    }

    pub(crate) fn tmux(&self, args: &[&str]) -> String {
        let run = Command::new("tmux").arg("-S").arg(&self.server).args(args).output().unwrap();
        String::from_utf8_lossy(&run.stdout).into_owned()
    }

    pub(crate) fn screen(&self) -> String {
        self.tmux(&["capture-pane", "-p"])
    }

    pub(crate) fn shows(&self, text: &str) {
        until(text, || self.screen().contains(text));
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.tmux(&["kill-server"]);
    }
}

#[test]
fn it_shows_the_machine_and_outlives_its_daemon() {
    if !test_needs::long() {
        return;
    }
    if Command::new("tmux").arg("-V").output().is_err() {
        return skipped("no tmux (Debian: tmux)");
    }
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::enabled(&socket);
    let terminal = Terminal::start(directory.path(), &socket, (100, 30), "");
    terminal.shows("embedded default");
    terminal.shows("RUN");
    daemon.expect(0, &["correct", "x", "12"]);
    until("the correction", || {
        let screen = terminal.screen();
        screen.lines().any(|l| l.starts_with("x ") && l.split_whitespace().nth(3) == Some("12"))
            && screen.lines().any(|l| l.contains("operator") && l.contains("12.00"))
    });
    let screen = terminal.screen();
    for text in ["poll gap p50", "last events", "mode run", "? help   q quit"] {
        assert!(screen.contains(text), "no {text:?} in\n{screen}");
    }
    terminal.tmux(&["send-keys", "?"]);
    terminal.shows("Nothing is commanded from here.");
    terminal.tmux(&["send-keys", "?"]);
    for code in [1, 1, 4] {
        daemon.expect(code, &["correct", "y", "900"]);
    }
    terminal.shows("still not believed");
    terminal.shows("FAULT");
    drop(daemon);
    terminal.shows("NO ANSWER for");
    let _daemon = Daemon::start(&socket, None);
    terminal.shows("? help   q quit");
    terminal.shows("DISABLED");
    // Another size gives another layout. A size that is too small is reported.
    terminal.tmux(&["resize-window", "-x", "50", "-y", "12"]);
    terminal.shows("needs 60x16");
    terminal.tmux(&["resize-window", "-x", "80", "-y", "24"]);
    terminal.shows("last events");
    terminal.tmux(&["send-keys", "q"]);
    terminal.shows("ended with 0");

    // The eight foreground colours, as the terminal writes them.
    let coloured = |terminal: &Terminal| {
        let screen = terminal.tmux(&["capture-pane", "-p", "-e"]);
        (30..38).any(|code| ['[', ';'].iter().any(|from| screen.contains(&format!("{from}{code}m"))))
    };
    let plain = Terminal::start(directory.path(), &socket, (90, 25), "NO_COLOR=1");
    plain.shows("DISABLED");
    assert!(!coloured(&plain));
    let bright = Terminal::start(directory.path(), &socket, (91, 25), "env -u NO_COLOR");
    bright.shows("DISABLED");
    until("colours", || coloured(&bright));

    // A closed terminal leaves no process behind.
    let here = socket.display().to_string();
    assert!(shown_by(&here) > 0);
    drop((terminal, plain, bright));
    until("the end of what they showed", || shown_by(&here) == 0);
}

/// Number of `rtecctl top` processes on this socket.
fn shown_by(socket: &str) -> usize {
    let commands = std::fs::read_dir("/proc").unwrap().filter_map(|p| {
        let command = std::fs::read(p.ok()?.path().join("cmdline")).ok()?;
        Some(String::from_utf8_lossy(&command).into_owned())
    });
    commands.filter(|c| c.split('\0').nth(1) == Some("top") && c.contains(socket)).count()
}

#[test]
fn without_a_terminal_or_a_daemon_it_says_what_to_do() {
    let run = Command::new(program("rtecctl")).arg("top").output().unwrap();
    assert_eq!(run.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&run.stderr).contains("rtecctl status --watch"));
}
