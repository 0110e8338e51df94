//! `rtecctl bugreport`: an archive that lets others analyse a problem.

use crate::archive::{ArchiveWriter, now_s};
use crate::daemon_connection::observe;
use crate::prelude::*;
use rtec_control::config::{Config, EMBEDDED, INSTALLED};
use rtec_control::setup_files::{self, SetupFile};
use rtec_rt::realtime_setup::SystemRoot;
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::process::Command;

/// Put configuration, model, profile, devices, state, record, log, platform and versions into one archive, for this user's eyes only
///
/// Works with or without a running daemon. What is missing is listed, also in contents.txt; the exit code is then 3 if
/// the daemon does not answer, else 1. Values of keys that sound secret (password, token, secret, key) and hosts of
/// network sensors are left out. Read it before you give it away.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The archive; it must not exist yet [default: rtec-bugreport-SECONDS.tar]
    #[arg(long, value_name = "FILE.tar")]
    out: Option<PathBuf>,
    /// The configuration to put in [default: that of --config, else /etc/rtec/rtec.toml]
    #[arg(long, value_name = "FILE")]
    of: Option<PathBuf>,
    #[command(flatten)]
    daemon: DaemonArgs,
}

/// Amount that is taken from the end of a log.
const LOG_BYTES: u64 = 1 << 20;
const LOG_LINES: &str = "2000";
/// First part of every name in the archive.
const TOP: &str = "rtec-bugreport";
/// Name of the file with the daemon's answers.
const STATE: &str = "state.json";

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let out = args.out.clone().unwrap_or_else(|| format!("rtec-bugreport-{}.tar", now_s()).into());
    let done = ArchiveWriter::create(&out).and_then(|archive| fill(args, archive));
    let (text, missing) = done?;
    if args.daemon.json {
        say_line(&serde_json::json!({ "file": out, "contents": text, "missing": missing }))?;
    } else {
        print!("{text}");
        println!("{}: read it before you give it away", out.display());
    }
    if missing.is_empty() {
        return Ok(());
    }
    let kind = if missing.contains(&STATE) { CommandFailure::Unreachable } else { CommandFailure::No };
    Err(kind(format!("{} is written without {}", out.display(), missing.join(", "))).into())
}

/// Fills the archive. Returns its contents in words, and the parts that are missing.
fn fill(args: &Args, mut archive: ArchiveWriter) -> anyhow::Result<(String, Vec<&'static str>)> {
    let (mut contents, mut missing) = (String::new(), Vec::new());
    let mut put = |name: &'static str, text: anyhow::Result<String>| -> anyhow::Result<()> {
        let text = match text {
            Ok(text) => text,
            Err(error) => {
                let _ = writeln!(contents, "{name}: missing: {error:#}");
                missing.push(name);
                return Ok(());
            }
        };
        let _ = writeln!(contents, "{name}: {} bytes", text.len());
        Ok(archive.add(&format!("{TOP}/{name}"), text.as_bytes())?)
    };
    let installed = Path::new(INSTALLED);
    let file = args.of.as_deref().or(args.daemon.config_file());
    let file = file.or_else(|| Some(installed).filter(|f| f.exists()));
    let config = match file {
        Some(file) => read(file),
        // The daemon then runs on the same configuration.
        None => Ok(format!("# There is no {INSTALLED}: the embedded default.\n{EMBEDDED}")),
    };
    let release = std::fs::read_to_string("/etc/os-release").unwrap_or_default();
    put("versions.txt", Ok(format!("{}\n{release}", rtec_files::file_format_stamp::writer())))?;
    let seen = args.daemon.view().and_then(|mut client| observe(&mut client, None));
    let runs = seen.as_ref().ok().map(|seen| seen.status.machine.clone());
    let of = config.as_ref().ok().and_then(|text| Some(Config::parse(installed, text).ok()?.machine));
    put("rtec.toml", config.map(|text| without_secrets(&text)))?;
    put(STATE, seen.and_then(|seen| pretty(&seen)))?;
    put("record.jsonl", args.daemon.log_path().and_then(|path| read(&path)))?;
    let log = output("journalctl", &["-q", "-b", "-u", "rtecd", "--no-pager", "-n", LOG_LINES]);
    let some = |text: &String| !text.trim().is_empty();
    let none = || anyhow::anyhow!("the journal has no line of the service rtecd since the boot");
    put("log.txt", log.and_then(|text| Some(text).filter(some).ok_or_else(none)))?;
    put("kernel.txt", output("uname", &["-a"]))?;
    let system = SystemRoot::live();
    let cpu = system.default_cpu();
    put("platform.json", pretty(&system.inspect(cpu, 80)))?;
    put("devices.txt", Ok(devices()))?;
    for (name, text) in file.map(files_named_by_config).unwrap_or_default() {
        let _ = writeln!(contents, "{name}: {} bytes", text.len());
        archive.add(&format!("{TOP}/{name}"), text.as_bytes())?;
    }
    if let Some((of, runs)) = of.zip(runs).filter(|(of, runs)| of != runs) {
        let takes = "`--of FILE` takes its configuration";
        let runs = format!("but the daemon that answered runs {runs:?}");
        let _ = writeln!(contents, "rtec.toml is of machine {of:?}, {runs}: {takes}");
    }
    archive.add(&format!("{TOP}/contents.txt"), contents.as_bytes())?;
    archive.finish()?;
    Ok((contents, missing))
}

/// The readable files that a configuration names: model, profile, list of devices.
/// A file that cannot be read has the reason in place of its text.
fn files_named_by_config(file: &Path) -> Vec<(String, String)> {
    let named = Config::load(file)
        .map_err(anyhow::Error::from)
        .and_then(|config| Ok(setup_files::of(file, &config)?));
    let named = match named {
        Ok(named) => named,
        // A configuration with mistakes may be the subject of the report.
        Err(error) => return vec![("findings.txt".to_owned(), format!("{error:#}\n"))],
    };
    // Recordings and traces are private and long.
    let named = named.into_iter().filter(|b| matches!(b.kind, "model" | "profile" | "devices"));
    let named = named.filter(|b| b.kind != "devices" || b.path.exists());
    let text =
        |b: &SetupFile| read(&b.path).map_or_else(|e| format!("{e:#}\n"), |text| without_secrets(&text));
    let name = |b: &SetupFile| b.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    named.map(|b| (format!("{}/{}", b.kind, name(&b)), text(&b))).collect()
}

/// The devices that a card may be: who may open each, and what it is.
fn devices() -> String {
    let mut text = String::new();
    let show = |text: &mut String, path: &Path| {
        let Ok(is) = path.metadata() else { return };
        let _ = writeln!(text, "{:o} {}:{} {}", is.mode() & 0o7777, is.uid(), is.gid(), path.display());
    };
    for (folder, kinds) in [("/dev", &["gpiochip", "uio", "parport"][..]), ("/sys/bus/pci/devices", &[""])] {
        let mut all: Vec<PathBuf> =
            std::fs::read_dir(folder).into_iter().flatten().filter_map(|e| Some(e.ok()?.path())).collect();
        all.sort();
        for path in all {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if !kinds.iter().any(|kind| name.starts_with(kind)) {
                continue;
            }
            show(&mut text, &path);
            for key in ["vendor", "device", "class"] {
                if let Ok(value) = std::fs::read_to_string(path.join(key)) {
                    let _ = writeln!(text, "  {key} {}", value.trim());
                }
            }
        }
    }
    text
}

/// A file's text; of a long file only the end.
fn read(path: &Path) -> anyhow::Result<String> {
    let named = || path.display().to_string();
    let mut file = rtec_files::text_file::open_regular(path)?;
    let long = file.metadata().with_context(named)?.len();
    file.seek(SeekFrom::Start(long.saturating_sub(LOG_BYTES))).with_context(named)?;
    let mut bytes = Vec::new();
    file.take(LOG_BYTES).read_to_end(&mut bytes).with_context(named)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn output(program: &str, args: &[&str]) -> anyhow::Result<String> {
    let run = Command::new(program).args(args).output().with_context(|| program.to_owned())?;
    anyhow::ensure!(run.status.success(), "{program}: {}", String::from_utf8_lossy(&run.stderr).trim());
    Ok(String::from_utf8_lossy(&run.stdout).into_owned())
}

/// A configuration without passwords, keys and host names.
/// Lines and keys stay, so that findings keep their positions.
fn without_secrets(text: &str) -> String {
    let line = |line: &str| {
        let Some((key, _)) = line.split_once('=') else { return line.to_owned() };
        let word = key.trim().trim_matches('"').to_lowercase();
        let secret = ["password", "passwd", "secret", "token", "key", "host", "credential"];
        if secret.iter().any(|s| word.contains(s)) && !line.trim_start().starts_with('#') {
            format!("{key}= \"(left out)\"")
        } else {
            masked(line)
        }
    };
    text.lines().map(|l| line(l) + "\n").collect()
}

/// Masks an address, which may hold a password: `tcp://user:word@host`.
fn masked(line: &str) -> String {
    let Some(scheme) = line.find("://") else { return line.to_owned() };
    let rest = &line[scheme + 3..];
    let end = rest.find(['/', '"', '\'']).unwrap_or(rest.len());
    format!("{}(left out){}", &line[..scheme + 3], &rest[end..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_left_out_and_lines_stay() {
        let text = "[machine]\nname = \"mill\" # = one\n[[sensor]]\nhost = \"10.1.2.3\"\nfrom = \"tcp://me:word@plant/7\"\n\
                    api_token=\"abc\"\n";
        let found = without_secrets(text);
        let wanted = "[machine]\nname = \"mill\" # = one\n[[sensor]]\nhost = \"(left out)\"\nfrom = \"tcp://(left out)/7\"\n\
                      api_token= \"(left out)\"\n";
        assert_eq!(found, wanted);
    }
}
