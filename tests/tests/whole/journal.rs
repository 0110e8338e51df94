//! The journal's fields, stored by a real journald and found by `journalctl`.
//! It runs in a mount namespace of its own, so that the computer's journal is left alone.

use rtec_tests::daemon::{alone, program};
use rtec_tests::skipped;
use serde_json::Value;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::Command;

const JOURNALD: &str = "/lib/systemd/systemd-journald";

/// Starts journald and `rtecd`, which end with the script.
/// `$1` is the folder of the programs.
const SCRIPT: &str = r#"
mount -t tmpfs tmpfs /run
mkdir -p /run/systemd/journal /run/log/journal /run/rtec-test
[ -s /etc/machine-id ] || { echo 0123456789abcdef0123456789abcdef >/run/id; mount --bind /run/id /etc/machine-id; }
trap 'kill $daemons' EXIT
/lib/systemd/systemd-journald >/dev/null 2>&1 & daemons=$!
for n in $(seq 100); do [ -S /run/systemd/journal/socket ] && break; sleep 0.1; done
socket=/run/rtec-test/s
JOURNAL_STREAM=1:2 "$1/rtecd" --socket $socket 2>/run/rtec-test/stderr & daemons="$daemons $!"
for n in $(seq 300); do "$1/rtecctl" status --socket $socket >/dev/null 2>&1 && break; sleep 0.1; done
"$1/rtecctl" home --socket $socket >/dev/null
"$1/rtecctl" enable --socket $socket >/dev/null
for n in 1 2 3; do "$1/rtecctl" correct y 900 --socket $socket >/dev/null 2>&1; done
find() { journalctl -D /run/log/journal --no-pager -o json "$@"; }
for n in $(seq 100); do [ -n "$(find RTEC_EVENT=fault)" ] && break; sleep 0.1; done
find RTEC_EVENT=mode RTEC_REASON=run
find RTEC_EVENT=fault RTEC_AXIS=y
find RTEC_EVENT=homed RTEC_AXIS=x | tail -1
grep -c "mode run" /run/rtec-test/stderr
"#;

#[test]
fn journalctl_finds_faults_modes_and_homing_by_their_fields() {
    let root = std::fs::metadata("/proc/self").is_ok_and(|m| m.uid() == 0);
    if !root || !Path::new(JOURNALD).exists() || Command::new("unshare").arg("--version").output().is_err() {
        return skipped("journald in a namespace needs root, systemd and unshare");
    }
    let _alone = alone();
    let rtecd = program("rtecd");
    let run = Command::new("unshare")
        .args(["-m", "--propagation", "private", "bash", "-c", SCRIPT, "journal"])
        .arg(rtecd.parent().unwrap().canonicalize().unwrap())
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&run.stdout);
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 4, "{text}\n{}", String::from_utf8_lossy(&run.stderr));
    let entry = |n: usize| serde_json::from_str::<Value>(lines[n]).unwrap();
    let (mode, fault, homed) = (entry(0), entry(1), entry(2));
    assert_eq!((&mode["MESSAGE"], &mode["PRIORITY"]), (&"mode run".into(), &"5".into()));
    assert_eq!(mode["MESSAGE_ID"], "7c49ee60f8204124bef7667a46dd3815");
    assert_eq!((&fault["RTEC_REASON"], &fault["PRIORITY"]), (&"still_not_believed".into(), &"3".into()));
    assert_eq!((&fault["_TRANSPORT"], &fault["SYSLOG_IDENTIFIER"]), (&"journal".into(), &"rtecd".into()));
    assert_eq!(homed["MESSAGE"], "axis x: homed");
    assert_eq!(lines[3], "0", "said twice");
}
