//! The real-time set-up, read from the kernel.

use super::{AXIS, GPIO, GPIO_LINES, configured, daemon};
use anyhow::{Context, ensure};
use rtec_tests::daemon::{Daemon, program};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Reads the set-up from the kernel, not from the daemon's own report.
pub(super) fn real_time((chip, _): &(String, PathBuf)) -> anyhow::Result<Vec<String>> {
    let axis = format!("{AXIS}{GPIO_LINES}");
    let (corrector, held) = daemon(GPIO, &axis)?;
    let process = PathBuf::from(format!("/proc/{}", corrector.id()));
    let mut thread = None;
    for task in fs::read_dir(process.join("task"))?.flatten() {
        if fs::read_to_string(task.path().join("comm"))?.trim() == "rtec-rt" {
            thread = Some(task.path());
        }
    }
    let thread = thread.context("no thread rtec-rt")?;
    let stat = fs::read_to_string(thread.join("stat"))?;
    // proc_pid_stat(5): after the name in parentheses field 3; 40 is the real-time priority, 41 the policy.
    let after = stat.rsplit_once(')').context("stat")?.1;
    let fields: Vec<&str> = after.split_whitespace().collect();
    ensure!((fields[37], fields[38]) == ("80", "1"), "priority {}, policy {}", fields[37], fields[38]);
    let status = fs::read_to_string(thread.join("status"))?;
    let value = |key: &str| status.lines().find_map(|l| l.strip_prefix(key)).map_or("", str::trim).to_owned();
    ensure!(value("Cpus_allowed_list:") == "1", "CPUs {}", value("Cpus_allowed_list:"));
    let locked: u64 = value("VmLck:").trim_end_matches(" kB").parse().unwrap_or(0);
    ensure!(locked > 1000, "{locked} kB locked");
    let mut latency = [0; 4];
    std::io::Read::read_exact(&mut fs::File::open("/dev/cpu_dma_latency")?, &mut latency)?;
    ensure!(latency == [0; 4], "cpu_dma_latency {latency:?}");
    let holds = fs::read_dir(process.join("fd"))?.flatten();
    let held_open = holds
        .filter_map(|fd| fs::read_link(fd.path()).ok())
        .any(|to| to == Path::new("/dev/cpu_dma_latency"));
    ensure!(held_open, "nobody holds /dev/cpu_dma_latency");
    ensure!(fs::read_to_string("/sys/kernel/realtime")?.trim() == "1", "no PREEMPT_RT kernel");
    let mut said = vec![format!(
        "from /proc: SCHED_FIFO 80, CPU 1, {locked} kB locked, cpu_dma_latency 0 held open, PREEMPT_RT"
    )];
    ensure!(corrector.status()["rt"]["may_arm"] == true, "{}", corrector.status()["rt"]);
    drop((corrector, held));

    // Without privileges it runs, names what is missing, and cannot be armed.
    let (directory, file) = configured(GPIO, &axis)?;
    let (user, group) = (1000, 1000);
    for path in [directory.path(), &file, &Path::new("/dev").join(chip)] {
        std::os::unix::fs::chown(path, Some(user), Some(group))?;
    }
    let socket = directory.path().join("s");
    let mut command = Command::new(program("rtecd"));
    std::os::unix::process::CommandExt::uid(&mut command, user);
    command.arg("--config").arg(&file).arg("--socket").arg(&socket);
    // A client of its own user, because root does not trust a process of another user.
    let corrector = Daemon::spawn_for(Some((program("rtecctl"), user)), &mut command, &socket);
    let missing = corrector.status()["rt"]["missing"].to_string();
    for what in ["scheduler", "memory_lock", "CAP_SYS_NICE"] {
        ensure!(missing.contains(what), "{what} is not named: {missing}");
    }
    corrector.expect(0, &["home", "--controller-homed"]);
    ensure!(corrector.expect(1, &["enable"]).contains("real-time set-up"), "{}", corrector.log());
    said.push("without privileges it runs, names what is missing, and refuses to be armed".to_owned());
    Ok(said)
}
