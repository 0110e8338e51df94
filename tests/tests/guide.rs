//! README and guide show what their commands print.
//!
//! `GUIDE=overwrite` writes the pages with the present output. `GUIDE_PAGE=fault` runs only the pages of that name.
//! The whole guide takes minutes: without either, and without `RTEC_LONG=1`, README alone is run.

#![allow(clippy::unwrap_used)]

use rtec_tests::daemon::program;
use rtec_tests::{pages, root};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

fn programs() -> PathBuf {
    let rtecctl = program("rtecctl");
    rtecctl.parent().unwrap().to_owned()
}

#[test]
fn every_command_of_readme_and_guide_prints_what_stands_there() {
    if !test_needs::long() {
        return;
    }
    let only = std::env::var("GUIDE_PAGE").unwrap_or_default();
    let whole = std::env::var_os("GUIDE").is_some() || !only.is_empty() || test_needs::long();
    let mut files = if whole { pages::below(&root().join("tools/guide")) } else { Vec::new() };
    files.push(root().join("README.md"));
    files.retain(|f| f.to_string_lossy().contains(&only));
    let (waiting, wrong, run) = (Mutex::new(files), Mutex::new(Vec::new()), Mutex::new(0));
    let programs = programs();
    let worker = || {
        loop {
            let Some(file) = waiting.lock().unwrap().pop() else { break };
            let name = file.strip_prefix(root()).unwrap_or(&file).display().to_string();
            let page = std::fs::read_to_string(&file).unwrap();
            let (folder, begun) = (tempfile::tempdir().unwrap(), Instant::now());
            let judged = pages::run(&page, &programs, folder.path()).and_then(|(actual, commands)| {
                *run.lock().unwrap() += commands;
                pages::judge(&file, actual)
            });
            eprintln!("{:6.1} s  {name}", begun.elapsed().as_secs_f64());
            if let Err(why) = judged {
                wrong.lock().unwrap().push((name, why));
            }
        }
    };
    std::thread::scope(|scope| {
        // Twice as many threads as CPUs, because a page mostly waits.
        for _ in 0..2 * std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(worker);
        }
    });
    let wrong = wrong.into_inner().unwrap();
    assert!(wrong.is_empty(), "{}", pages::told(&wrong));
    let least = if whole { 20 } else { 1 };
    assert!(!only.is_empty() || run.into_inner().unwrap() > least, "there is a guide, and it runs");
}

fn of(page: &str) -> Result<(String, usize), String> {
    let folder = tempfile::tempdir().unwrap();
    pages::run(page, &programs(), folder.path())
}

#[test]
fn a_page_that_tells_the_truth_stays_as_it_is() {
    let page = "# A page\n\n```sh\nrm -rf somewhere # not run\n```\n\n```console\n$ rtecctl example --list\nlathe  [..]\n...\nspindle  [..]\n\
                $ mkdir here; cd here\n$ rtecctl config check none.toml\n? 2\n[..]none.toml[..]\n$ printf 'a\\nb' |\n> tr a c\nc\nb\n```\n\n\
                and then, in the same shell:\n\n```console\n$ basename \"$PWD\"\nhere\n```\n";
    let (actual, commands) = of(page).unwrap();
    assert_eq!(actual, page);
    assert_eq!(commands, 5);
}

#[test]
fn what_is_not_so_is_written_as_it_is() {
    for (told, is) in [
        ("$ echo 14 counts\n13 counts\n", "$ echo 14 counts\n14 counts\n"),
        ("$ echo 14 counts\n1[..] µm\n", "$ echo 14 counts\n14 counts\n"),
        ("$ printf '1\\n2\\n3\\n'\n1\n...\n4\n", "$ printf '1\\n2\\n3\\n'\n1\n2\n3\n"),
        ("$ false\n", "$ false\n? 1\n"),
        ("$ true\n? 1\n", "$ true\n"),
        ("$ echo said >&2\n", "$ echo said >&2\nsaid\n"),
        ("$ echo it\nit\nand more\n", "$ echo it\nit\n"),
    ] {
        let (actual, _) = of(&format!("```console\n{told}```\n")).unwrap();
        assert_eq!(actual, format!("```console\n{is}```\n"));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(&file, format!("```console\n{told}```\n")).unwrap();
        assert!(std::env::var_os("GUIDE").is_some() || pages::judge(file.path(), actual).is_err(), "{told}");
    }
}

#[test]
fn a_page_that_cannot_be_run_says_where() {
    for (page, why) in [
        ("text\n```console\n$ true\n", "line 2: a block without an end"),
        ("```shell\n$ true\n```\n", "line 1: a block of \"shell\""),
        ("```console\ntrue\n```\n", "begins with `$ command`"),
        ("```console\n$ exit 3\n```\n", "ended the shell"),
        ("```console\n$ rtecd --config none.toml &\n```\n", "none.toml"),
    ] {
        let error = of(page).unwrap_err();
        assert!(error.contains(why), "{page}: {error}");
    }
}

#[test]
fn a_page_has_a_daemon_of_its_own_that_ends_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let page = "```console\n$ rtecd &\n$ rtecctl get mode\ndisabled\n$ echo $! >pid\n```\n";
    let (actual, _) = pages::run(page, &programs(), folder.path()).unwrap();
    assert_eq!(actual, page);
    let pid = std::fs::read_to_string(folder.path().join("pid")).unwrap();
    assert!(!Path::new("/proc").join(pid.trim()).exists(), "{pid}");
}
