//! Runs the commands of a page of Markdown as its reader would.
//! One shell runs them in order, in an empty folder.
//!
//! | in a block ```` ```console ```` | meaning |
//! |---|---|
//! | `$ command` | a command; `> ` begins a further line of it |
//! | `? 2` below it | the exit code, where it is not 0 |
//! | other lines | what it prints, to standard output and standard error |
//! | `[..]` | anything within a line |
//! | `...` as a line | any number of lines |
//! | `$ rtecd …&` | the page's daemon: the next command waits until it answers, and it ends with the page |
//!
//! Blocks of other languages are not run.

use snapbox::assert::Action;
use snapbox::{Assert, Data, IntoData as _};
use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

/// Longest time that a command may take. No page is judged by its duration.
const PATIENCE: Duration = Duration::from_secs(600);
/// Languages that a block may have.
const LANGUAGES: [&str; 12] =
    ["console", "sh", "toml", "csv", "json", "text", "rust", "ini", "hal", "make", "yaml", "python"];

/// Marks the end of a command's output.
const END: &str = "~~~ end of output ~~~";

/// Runs a page's commands with the programs of a folder, in the empty folder `at`.
/// Returns the page with the present output and the number of commands. `[..]` and `...` stay where they match.
///
/// # Errors
/// A page that cannot be run: a block without an end, or a command that does not end.
pub fn run(page: &str, programs: &Path, at: &Path) -> Result<(String, usize), String> {
    let assert = Assert::new().action(Action::Verify);
    let (mut shell, mut commands) = (None, 0);
    let mut text = String::new();
    let mut lines = page.lines().enumerate().peekable();
    while let Some((n, line)) = lines.next() {
        push_line(&mut text, line);
        let Some(language) = line.strip_prefix("```") else { continue };
        // The book's own index pages have this block.
        let directive = language == "{toctree}";
        if !directive && !LANGUAGES.contains(&language) {
            return Err(format!("line {}: a block of {language:?}, expected one of {LANGUAGES:?}", n + 1));
        }
        let mut block = Vec::new();
        loop {
            match lines.next() {
                Some((_, "```")) => break,
                Some((_, line)) => block.push(line),
                None => return Err(format!("line {}: a block without an end", n + 1)),
            }
        }
        if language != "console" {
            for line in block {
                push_line(&mut text, line);
            }
            text += "```\n";
            continue;
        }
        let mut rest = block.into_iter().peekable();
        while let Some(line) = rest.next() {
            let Some(first) = line.strip_prefix("$ ") else {
                return Err(format!(
                    "line {}: a block of console begins with `$ command`, found {line:?}",
                    n + 1
                ));
            };
            let (mut command, mut shown) = (first.to_owned(), format!("{line}\n"));
            while let Some(more) = rest.next_if(|l| l.starts_with("> ")) {
                command.push('\n');
                command += &more[2..];
                push_line(&mut shown, more);
            }
            let mut expected = String::new();
            while let Some(line) = rest.next_if(|l| !l.starts_with("$ ")) {
                push_line(&mut expected, line);
            }
            let shell = match &mut shell {
                Some(shell) => shell,
                none => none.insert(Shell::start(programs, at).map_err(|e| format!("bash: {e}"))?),
            };
            let printed = shell.run(&command).map_err(|e| format!("line {}: `{command}`: {e}", n + 1))?;
            commands += 1;
            let (actual, _) = assert.normalize(printed.into_data(), expected.into_data());
            text += &shown;
            text += &actual.to_string();
        }
        text += "```\n";
    }
    Ok((text, commands))
}

fn push_line(text: &mut String, line: &str) {
    text.push_str(line);
    text.push('\n');
}

/// Compares a page with the result of [`run`].
/// `GUIDE=overwrite` writes the page instead.
///
/// # Errors
/// The difference.
pub fn judge(file: &Path, actual: String) -> Result<(), String> {
    let assert = Assert::new().action_env("GUIDE");
    let expected =
        Data::try_read_from(file, Some(snapbox::data::DataFormat::Text)).map_err(|e| e.to_string())?;
    // The patterns are filled in already, so nothing in the page is a pattern.
    assert.try_eq(Some(&"as it runs"), actual.into_data().raw(), expected.raw()).map_err(|e| e.to_string())
}

/// A shell that runs commands one by one.
struct Shell {
    child: Child,
    input: ChildStdin,
    output: Receiver<Vec<u8>>,
    read: Vec<u8>,
}

impl Shell {
    fn start(programs: &Path, at: &Path) -> std::io::Result<Self> {
        let (home, run) = (at.join(".home"), at.join(".run"));
        std::fs::create_dir_all(&home)?;
        std::fs::create_dir_all(&run)?;
        let mut path = programs.as_os_str().to_owned();
        path.push(":/usr/sbin:/usr/bin:/sbin:/bin");
        let mut child = Command::new("bash")
            .args(["--noprofile", "--norc"])
            .env_clear()
            .env("PATH", path)
            .env("HOME", home)
            .env("RTEC_RUN_DIR", run)
            .env("LC_ALL", "C.UTF-8")
            .env("COLUMNS", "100")
            .current_dir(at)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .process_group(0)
            .spawn()?;
        let (Some(mut input), Some(mut pipe)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(std::io::Error::other("no pipes"));
        };
        // One output for both, in the order that a terminal shows.
        input.write_all(b"exec 2>&1\n")?;
        let (to, output) = channel();
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(n @ 1..) = pipe.read(&mut buffer) {
                if to.send(buffer[..n].to_vec()).is_err() {
                    break;
                }
            }
        });
        Ok(Self { child, input, output, read: Vec::new() })
    }

    /// The output of a command, after its exit code where that is not 0.
    fn run(&mut self, command: &str) -> Result<String, String> {
        if let Some(daemon) = command.strip_suffix('&').filter(|c| c.starts_with("rtecd")) {
            self.ask(&format!("{daemon} </dev/null >\"$RTEC_RUN_DIR/rtecd.log\" 2>&1 &"))?;
            let (answered, _) = self.ask(
                "for n in {1..600}; do rtecctl whoami >/dev/null 2>&1 && break; kill -0 $! 2>/dev/null || break; sleep 0.1; done; \
                 rtecctl whoami >/dev/null 2>&1",
            )?;
            if answered != 0 {
                return Err(format!(
                    "the daemon does not answer: {}",
                    self.ask("cat \"$RTEC_RUN_DIR/rtecd.log\"")?.1
                ));
            }
            return Ok(String::new());
        }
        let (code, printed) = self.ask(&format!("{{ {command}\n}} </dev/null"))?;
        Ok(if code == 0 { printed } else { format!("? {code}\n{printed}") })
    }

    fn ask(&mut self, command: &str) -> Result<(i32, String), String> {
        let whole = format!("{command}\nprintf '\\n%s %s\\n' '{END}' \"$?\"\n");
        self.input.write_all(whole.as_bytes()).map_err(|e| e.to_string())?;
        let mark = format!("\n{END} ");
        loop {
            let text = String::from_utf8_lossy(&self.read).into_owned();
            if let Some((printed, rest)) = text.split_once(&mark)
                && let Some((code, rest)) = rest.split_once('\n')
            {
                self.read = rest.as_bytes().to_vec();
                let code = code.parse().map_err(|e| format!("exit code {code:?}: {e}"))?;
                // Ends the last line where the command does not.
                let ended = if printed.is_empty() || printed.ends_with('\n') { "" } else { "\n" };
                return Ok((code, format!("{printed}{ended}")));
            }
            match self.output.recv_timeout(PATIENCE) {
                Ok(more) => self.read.extend(more),
                Err(RecvTimeoutError::Timeout) => return Err(format!("goes on for ever: {text}")),
                Err(RecvTimeoutError::Disconnected) => return Err(format!("ended the shell: {text}")),
            }
        }
    }
}

impl Drop for Shell {
    /// Ends the shell, its daemon and all their processes, which are one group.
    fn drop(&mut self) {
        let group = nix::unistd::Pid::from_raw(-(self.child.id() as i32));
        for signal in [nix::sys::signal::Signal::SIGTERM, nix::sys::signal::Signal::SIGKILL] {
            // An error means that the group has ended already.
            let _ = nix::sys::signal::kill(group, signal);
            for _ in 0..100 {
                if nix::sys::signal::kill(group, None).is_err() {
                    break;
                }
                let _ = self.child.try_wait();
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        let _ = self.child.wait();
    }
}

/// All pages below a folder, in order.
pub fn below(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(below(&path));
        } else if path.extension().is_some_and(|e| e == "md") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// All failures as text, one paragraph a page.
pub fn told(wrong: &[(String, String)]) -> String {
    wrong.iter().fold(String::new(), |mut text, (page, why)| {
        // Writing to a String does not fail.
        let _ = writeln!(text, "{page}: {why}\n");
        text
    })
}
