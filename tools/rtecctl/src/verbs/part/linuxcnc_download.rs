//! Downloads the NC program to the controller and opens it there.
//! It uses LinuxCNC's network interface `linuxcncrsh` (one command a line over TCP, port 5007). The program
//! is in LinuxCNC's own program folder.

use super::usage;
use crate::prelude::*;
use std::io::{BufRead, BufReader, Write as _};
use std::net::{TcpStream, ToSocketAddrs as _};

/// Into the controller
#[derive(Debug, clap::Args)]
pub(crate) struct DownloadArgs {
    /// Have LinuxCNC open the program, over its `linuxcncrsh` at this address; the port is 5007 where it is not given
    #[arg(long, value_name = "HOST[:PORT]", requires = "program_folder")]
    download: Option<String>,
    /// LinuxCNC's program folder, as it is reached from here; the program is written there too
    #[arg(long, value_name = "DIR")]
    program_folder: Option<PathBuf>,
    /// The same folder as LinuxCNC names it, where that is another computer's
    #[arg(long, value_name = "DIR", requires = "download")]
    folder_there: Option<PathBuf>,
    /// Password with which `linuxcncrsh` lets a client in, and the one with which it lets it command
    #[arg(long, value_name = "CONNECT,ENABLE", default_value = "EMC,EMCTOO")]
    passwords: String,
}

/// Longest wait for LinuxCNC.
const PATIENCE: Duration = Duration::from_secs(10);

impl DownloadArgs {
    /// Writes the program into the controller's folder, and opens it on request.
    ///
    /// # Errors
    /// The folder cannot be written; nothing answers (exit code 3); LinuxCNC refuses (exit code 1).
    pub(crate) fn bring(&self, name: &str, text: &str, dialect: &str) -> anyhow::Result<()> {
        if self.download.is_some() && Path::new(dialect).file_stem().is_none_or(|d| d != "linuxcnc") {
            eprintln!("rtecctl: the program is in the dialect {dialect}; LinuxCNC reads --dialect linuxcnc");
        }
        let Some(folder) = &self.program_folder else { return Ok(()) };
        if !folder.is_dir() {
            let found = format!("no folder {}", folder.display());
            return Err(usage("--program-folder", found, "the controller's program folder"));
        }
        let file = folder.join(name);
        rtec_files::atomic_write::write_atomically(&file, text.as_bytes())
            .with_context(|| format!("cannot write {}", file.display()))?;
        eprintln!("wrote {}", file.display());
        let Some(address) = &self.download else { return Ok(()) };
        let there = self.folder_there.as_ref().unwrap_or(folder).join(name);
        let (connect, enable) = self.passwords.split_once(',').unwrap_or((&self.passwords, "EMCTOO"));
        let unreachable = |e| CommandFailure::Unreachable(format!("LinuxCNC at {address}: {e}"));
        let mut client = LinuxcncrshClient::connect(address).map_err(unreachable)?;
        let mut ask = |command: &str, answer: &str| client.ask(command, answer).map_err(unreachable);
        let path = there.display().to_string();
        for (command, answer) in [
            (format!("hello {connect} rtecctl 1.0"), "HELLO"),
            ("set echo off".to_owned(), ""),
            ("set verbose on".to_owned(), "SET VERBOSE"),
            (format!("set enable {enable}"), "SET ENABLE"),
            ("set mode auto".to_owned(), "SET MODE"),
            (format!("set open {path}"), "SET OPEN"),
        ] {
            let said = ask(&command, answer)?;
            ensure!(!said.contains("NAK"), No, "LinuxCNC at {address} refuses `{command}`: {said}");
        }
        let open = ask("get program", "PROGRAM")?;
        let is_open = open.to_lowercase().ends_with(&path.to_lowercase());
        ensure!(is_open, No, "LinuxCNC at {address} has another program open: {open}");
        // LinuxCNC closes the connection; the result does not matter.
        let _ = ask("quit", "");
        eprintln!("LinuxCNC at {address} has opened {}", there.display());
        Ok(())
    }
}

struct LinuxcncrshClient {
    lines: BufReader<TcpStream>,
}

impl LinuxcncrshClient {
    fn connect(address: &str) -> std::io::Result<Self> {
        let address = if address.contains(':') { address.to_owned() } else { format!("{address}:5007") };
        let mut last = std::io::Error::new(std::io::ErrorKind::NotFound, "no such host");
        for place in address.to_socket_addrs()? {
            match TcpStream::connect_timeout(&place, PATIENCE) {
                Ok(stream) => {
                    stream.set_read_timeout(Some(PATIENCE))?;
                    stream.set_write_timeout(Some(PATIENCE))?;
                    return Ok(Self { lines: BufReader::new(stream) });
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// Sends a command and reads up to the line that answers it.
    /// Commands may be echoed first. Without an expected answer it does not wait.
    fn ask(&mut self, command: &str, answer: &str) -> std::io::Result<String> {
        self.lines.get_mut().write_all(format!("{command}\r\n").as_bytes())?;
        if answer.is_empty() {
            return Ok(String::new());
        }
        loop {
            let mut line = String::new();
            if self.lines.read_line(&mut line)? == 0 {
                return Err(std::io::Error::new(std::io::ErrorKind::UnexpectedEof, "it has hung up"));
            }
            let line = line.trim();
            // Answers are in capitals, an echo is as sent. A refusal need not name the refused command.
            if line.starts_with(answer) || line.starts_with("SET") && line.ends_with("NAK") {
                return Ok(line.to_owned());
            }
        }
    }
}
