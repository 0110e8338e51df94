//! `rtecctl log`: the record of every command.

use crate::prelude::*;
use crate::terminal;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use rtec_control::audit_log::{self, ChainAnchor, ChainLine, Entry};
use rtec_files::message_text::is_hidden;
use std::collections::BTreeSet;
use std::io;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Show who asked the daemon for what, when, and what it did; check that the record is whole
///
/// Commands, what they did, and what the machine did: modes, faults with the time they were first seen. Reads the record's
/// files, whether the daemon runs or not; reading them takes the group of the view socket.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// From this time on: a duration back from now (90min, 2d), a day or a moment of local time (2026-11-22T13:00), with a Z of UTC
    #[arg(long, value_name = "TIME")]
    since: Option<String>,
    /// What was asked of this axis, or changed its total
    #[arg(long, value_name = "AXIS")]
    axis: Option<String>,
    /// Check every line and the chain through all files; exit 1 where one is missing, changed or in another place. Commands
    /// that could not be recorded are counted
    #[arg(long, conflicts_with_all = ["since", "axis", "follow"])]
    verify: bool,
    /// With --verify: that the record ends as the system's journal says (`[control] log_anchor`); FILE is what `journalctl
    /// RTEC_EVENT=record_anchor` prints, `-` standard input
    #[arg(long, value_name = "FILE", requires = "verify")]
    anchors: Option<PathBuf>,
    /// Go on with new lines as they come, until interrupted or nobody reads them; with --json one document a line
    #[arg(long)]
    follow: bool,
    /// The record [default: the configuration's]
    #[arg(long, value_name = "FILE")]
    file: Option<PathBuf>,
    #[command(flatten)]
    daemon: DaemonArgs,
}

const EVERY: Duration = Duration::from_millis(250);

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let file = args.file.clone().map_or_else(|| args.daemon.log_path(), Ok)?;
    if args.verify {
        let anchors = args.anchors.as_deref().map(anchors).transpose()?.unwrap_or_default();
        return verify(&file, &anchors, args.daemon.json);
    }
    let zone = TimeZone::system();
    let since_s = args.since.as_deref().map(|text| since(text, &zone)).transpose()?;
    let wanted = |entry: &Entry| {
        let late = since_s.is_none_or(|since| entry.seconds().is_some_and(|t| t >= since));
        late && args.axis.as_ref().is_none_or(|axis| entry.concerns(axis))
    };
    if let Some(axis) = &args.axis {
        known(&file, axis)?;
    }
    // The first is of the record, the second of the refusals.
    let (mut all, mut last_n, mut last_t) = (Vec::new(), [0; 2], None);
    let (mut shown, mut broken) = (0_u64, 0_u64);
    let mut show = |line: ChainLine, all: Option<&mut Vec<Value>>| match line.entry {
        Ok(entry) => {
            if !wanted(&entry) {
                return;
            }
            shown += 1;
            match all {
                Some(all) => all.push(serde_json::from_str(&line.text).unwrap_or_default()),
                None if args.daemon.json => println!("{}", line.text),
                None => print!("{}", text(&entry, &zone)),
            }
        }
        Err(why) => {
            broken += 1;
            eprintln!("rtecctl: {}:{}: {why}", line.file.display(), line.line);
        }
    };
    let document = args.daemon.json && !args.follow;
    audit_log::read(&file, &mut |line| {
        if let Ok(entry) = &line.entry {
            last_n[usize::from(line.refused)] = entry.n;
            last_t = Some(entry.t.clone());
        }
        show(line, document.then_some(&mut all));
    })
    .map_err(|e| unreadable(&file, &e))?;
    if document {
        say_line(&json!({ "file": file, "lines": all }))?;
    }
    if args.follow {
        while !terminal::reader_has_gone() {
            std::thread::sleep(EVERY);
            // The files may just have been renamed.
            let _ = audit_log::read(&file, &mut |line| {
                let n = line.entry.as_ref().map_or(0, |e| e.n);
                let last_n = &mut last_n[usize::from(line.refused)];
                if n > *last_n {
                    *last_n = n;
                    show(line, None);
                }
            });
        }
    }
    ensure!(broken == 0, No, "{broken} lines are not as they were written: `rtecctl log --verify`");
    if shown == 0 && !args.follow && !document {
        eprintln!("rtecctl: {}", nothing(since_s, args.axis.as_deref(), last_t.as_deref(), &zone));
    }
    Ok(())
}

/// Refuses an unknown axis before any line is shown.
fn known(file: &Path, axis: &str) -> anyhow::Result<()> {
    let mut axes = BTreeSet::new();
    audit_log::read(file, &mut |line| axes.extend(line.entry.into_iter().flat_map(|e| e.after.into_keys())))
        .map_err(|e| unreadable(file, &e))?;
    let known = axes.is_empty() || axes.contains(axis);
    ensure!(known, Bad, "found --axis {axis}, expected one of the record's: {}", list(axes));
    Ok(())
}

/// Reason why no line is shown, and where lines are.
fn nothing(since_s: Option<f64>, axis: Option<&str>, last_t: Option<&str>, zone: &TimeZone) -> String {
    let Some(last) = last_t else {
        return "the record has no line yet: rtecd writes one when it starts".to_owned();
    };
    let axis = axis.map_or(String::new(), |axis| format!(" of axis {axis}"));
    let since = since_s.map_or(String::new(), |seconds| {
        let since = Duration::try_from_secs_f64(seconds).unwrap_or_default();
        format!(" since {}", local(&audit_log::stamp(UNIX_EPOCH + since), zone))
    });
    format!("no line{axis}{since}; the record's last is of {}: `rtecctl log` shows all", local(last, zone))
}

/// The anchors of the record in the journal.
fn anchors(file: &Path) -> anyhow::Result<Vec<ChainAnchor>> {
    let text = if file == Path::new("-") {
        io::read_to_string(io::stdin()).map_err(|e| InputError::whole(file, e.to_string(), "text"))?
    } else {
        rtec_files::text_file::read(file)?
    };
    let found = ChainAnchor::all(&text);
    if found.is_empty() {
        let expected = "lines of rtecd, as `journalctl RTEC_EVENT=record_anchor` prints them ([control] log_anchor = true)";
        return Err(InputError::whole(file, "no anchor", expected).into());
    }
    Ok(found)
}

fn verify(file: &Path, anchors: &[ChainAnchor], as_json: bool) -> anyhow::Result<()> {
    let found = audit_log::verify(file, anchors).map_err(|e| unreadable(file, &e))?;
    if as_json {
        say_line(&json!({ "file": file, "ok": found.broken.is_empty(), "found": found }))?;
    } else {
        for broken in &found.broken {
            let line = if broken.line > 0 { format!(":{}", broken.line) } else { String::new() };
            println!("{}{line}: {}", broken.file.display(), broken.what);
        }
        let [first, last] = found.numbers;
        println!("{}: {} lines, number {first} to {last}", file.display(), found.lines);
        if found.refused > 0 {
            println!("{}: {} lines", audit_log::refused_path(file).display(), found.refused);
        }
        if !anchors.is_empty() {
            println!("compared with {} anchors", anchors.len());
        }
        if let lost @ 1.. = found.lost {
            println!(
                "{lost} commands were not recorded, as it says itself: `rtecctl log` shows when and why"
            );
        }
    }
    let n = found.broken.len();
    ensure!(n == 0, No, "{n} findings: the record is not as it was written");
    Ok(())
}

fn unreadable(file: &Path, error: &io::Error) -> anyhow::Error {
    if error.kind() == io::ErrorKind::NotFound {
        let expected = "one that rtecd writes: start rtecd (`systemctl start rtecd`), or --file";
        return InputError::whole(file, "no record yet", expected).into();
    }
    let expected = "a record that this user may read (the group of [control] view), or --file";
    InputError::whole(file, error.to_string(), expected).into()
}

/// A time of the record in local time; other text stays as it is.
fn local(t: &str, zone: &TimeZone) -> String {
    let Ok(moment) = t.parse::<Timestamp>() else { return t.to_owned() };
    moment.to_zoned(zone.clone()).strftime("%Y-%m-%d %H:%M:%S%.3f %:z").to_string()
}

/// Parses a time: a duration back from now, or a moment. Without a Z it is local.
fn since(text: &str, zone: &TimeZone) -> anyhow::Result<f64> {
    if let Some(seconds) = audit_log::seconds(text) {
        // The moment at which local clocks show this time. The second pass is for a change of clocks between
        // both.
        let offset_s = |at: f64| {
            Timestamp::from_second(at as i64).map_or(0.0, |at| f64::from(zone.to_offset(at).seconds()))
        };
        let shift = if text.ends_with('Z') { 0.0 } else { offset_s(seconds - offset_s(seconds)) };
        return Ok(seconds - shift);
    }
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let Ok(back) = humantime::parse_duration(text) else {
        let expected =
            "a duration (90min, 2d), a day or a moment of local time (2026-11-22T13:00), with a Z of UTC";
        return Err(InputError::whole(Path::new("--since"), format!("{text:?}"), expected).into());
    };
    Ok(now.saturating_sub(back).as_secs_f64())
}

/// One line for people.
/// Texts of the record come from outside, so invisible characters are written out.
fn text(e: &Entry, zone: &TimeZone) -> String {
    let mut text = format!("{} ", local(&e.t, zone));
    if let Some(by) = &e.by {
        let user = if by.user.is_empty() { by.uid.to_string() } else { by.user.clone() };
        let _ = write!(text, "{user} ({} {}, {}) ", by.pid, by.exe, by.role.replace('_', " "));
    }
    if let Some(request) = e.request.as_ref().and_then(Value::as_object) {
        let name = request.get("do").and_then(Value::as_str).unwrap_or_default();
        let _ = write!(text, "{name}");
        for (key, value) in request.iter().filter(|(k, v)| *k != "do" && !v.is_null()) {
            let _ = write!(text, " {key}={value}");
        }
        let _ = write!(text, ": {}", e.result);
    } else {
        let axis = e.axis.as_ref().map_or(String::new(), |axis| format!("axis {axis} "));
        let what = e.what.replace('_', " ");
        if e.text.starts_with(&what) {
            // The text names the event itself.
            let _ = write!(text, "{axis}{}", e.text);
            return plain(&text);
        }
        let _ = write!(text, "{axis}{what}");
    }
    if let Some(times) = e.times {
        let _ = write!(text, ", {times} times");
    }
    if !e.text.is_empty() {
        let _ = write!(text, ": {}", e.text);
    }
    for (axis, now @ [requested, in_effect]) in &e.after {
        if let Some(before @ [was, was_in_effect]) = e.before.get(axis)
            && before != now
        {
            let _ = write!(text, "; {axis} requested {was:+} to {requested:+}, ");
            let _ = write!(text, "in effect {was_in_effect:+} to {in_effect:+}");
        }
    }
    plain(&text)
}

fn plain(text: &str) -> String {
    text.chars().map(|c| if c.is_control() || is_hidden(c) { '?' } else { c }).chain(['\n']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_control::protocol::ClientProcess;
    use std::collections::BTreeMap;

    /// A fixed zone with a change of clocks, whatever zone this computer has.
    fn berlin() -> TimeZone {
        TimeZone::posix("CET-1CEST,M3.5.0,M10.5.0/3").unwrap()
    }

    #[test]
    fn a_line_says_who_what_and_what_it_did() {
        let mut entry = Entry::now("command");
        entry.t = "2026-11-22T13:00:00.123Z".into();
        entry.by = Some(ClientProcess {
            uid: 1000,
            user: "anna".into(),
            pid: 42,
            exe: "/usr/bin/rtec\u{1b}ctl".into(),
            role: "set_up".into(),
            ..ClientProcess::default()
        });
        entry.request = Some(json!({"do": "correct", "axis": "x", "total_counts": 14, "large": false}));
        entry.result = "done".into();
        entry.before = BTreeMap::from([("x".into(), [0, 0]), ("y".into(), [2, 2])]);
        entry.after = BTreeMap::from([("x".into(), [14, 0]), ("y".into(), [2, 2])]);
        assert_eq!(
            text(&entry, &berlin()),
            "2026-11-22 14:00:00.123 +01:00 anna (42 /usr/bin/rtec?ctl, set up) correct axis=\"x\" large=false total_counts=14: \
             done; x requested +0 to +14, in effect +0 to +0\n"
        );
    }

    #[test]
    fn times_are_durations_or_moments() {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64();
        let zone = &berlin();
        let is = |text, wanted: f64| assert!((since(text, zone).unwrap() - wanted).abs() < 1e-6, "{text}");
        assert!((since("1h", zone).unwrap() - (now - 3600.0)).abs() < 60.0);
        is("2026-11-22", 1_795_305_600.0 - 3600.0);
        is("2026-11-22T13:00", 1_795_305_600.0 + 12.0 * 3600.0);
        is("2026-11-22T13:00Z", 1_795_305_600.0 + 13.0 * 3600.0);
        // Around the change of clocks on 2026-03-29 at 01:00 UTC.
        is("2026-03-29T01:30", 1_774_744_200.0);
        is("2026-03-29T03:30", 1_774_747_800.0);
        assert!(since("some day", zone).unwrap_err().to_string().contains("expected a duration"));
    }

    #[test]
    fn where_no_line_is_shown_it_says_where_there_are_some() {
        let last = Some("2026-11-22T14:29:07.000Z");
        assert_eq!(
            nothing(Some(1_795_305_600.0), Some("x"), last, &berlin()),
            "no line of axis x since 2026-11-22 01:00:00.000 +01:00; the record's last is of 2026-11-22 15:29:07.000 +01:00: \
             `rtecctl log` shows all"
        );
        assert!(
            nothing(Some(-1.0), None, last, &berlin())
                .starts_with("no line since 1970-01-01 01:00:00.000 +01:00; ")
        );
        assert!(nothing(Some(0.0), None, None, &berlin()).contains("no line yet"));
    }

    #[test]
    fn a_record_that_is_not_there_is_one_that_nobody_wrote_yet() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("audit.log");
        let says = |axis| known(&file, axis).unwrap_err().to_string();
        assert!(says("x").contains("no record yet") && says("x").contains("start rtecd"), "{}", says("x"));
        std::fs::write(&file, "").unwrap();
        known(&file, "x").unwrap();
    }
}
