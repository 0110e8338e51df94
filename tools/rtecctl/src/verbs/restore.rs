//! `rtecctl restore`: a machine's set-up from an archive of `rtecctl backup`.

use super::backup::{Manifest, PackedFile, read};
use crate::prelude::*;
use nix::unistd::{Gid, Uid, fchown};
use rtec_control::config::{Config, INSTALLED};
use rtec_control::single_process_lock;
use rtec_files::untrusted_folder::UntrustedFolder;
use std::os::unix::fs::MetadataExt;
use std::path::{Component, Path, PathBuf};

/// Put back a machine's set-up from an archive of `rtecctl backup`, here or on another computer
///
/// Every file is compared with its hash, and the configuration is checked, before anything is written. A file that is there and
/// differs stays, and nothing is written, unless --replace. The daemon must not run. What the controller had in effect when the
/// archive was made is not put back: home scale and controller after it. The record of commands stays as it is.
#[derive(Debug, clap::Args)]
#[allow(clippy::struct_excessive_bools)] // One per option.
pub(crate) struct Args {
    /// The archive
    #[arg(value_name = "FILE.tar")]
    archive: PathBuf,
    /// The configuration to write; files that were beside it are put beside it
    #[arg(long, value_name = "FILE", default_value = INSTALLED)]
    config: PathBuf,
    /// Write over files that differ
    #[arg(long)]
    replace: bool,
    /// Write files that were outside the configuration's folder to the places that they had, too
    #[arg(long)]
    elsewhere: bool,
    /// Put back the state, too: counts in effect, faults, hold. Only where neither the machine nor its axes moved since
    #[arg(long)]
    with_state: bool,
    /// Show what would be written, and write nothing; the daemon may run
    #[arg(long)]
    dry_run: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

struct RestoredFile<'a> {
    packed: &'a PackedFile,
    bytes: &'a [u8],
    to: PathBuf,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let (manifest, contents) = read(&args.archive)?;
    let folder = args.config.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        let expected = "a folder that is there: install the package first, or --config FILE";
        return Err(InputError::whole(folder, "no folder", expected).into());
    }
    let config = checked(args, &manifest, &contents, folder)?;
    let (wanted, left_out) = wanted(args, &manifest, &contents, folder, &config)?;
    let running = |e| {
        CommandFailure::No(format!("{e}: end the daemon first (`systemctl stop rtecd`); nothing is written"))
    };
    // A dry run does not need the daemon to be stopped.
    let _held = if args.dry_run {
        None
    } else {
        Some(single_process_lock::keep_out(&config.control.socket).map_err(running)?)
    };
    let differs = |w: &&RestoredFile<'_>| std::fs::read(&w.to).is_ok_and(|there| there != w.bytes);
    let files = list(wanted.iter().filter(differs).map(|w| w.to.display()));
    if !files.is_empty() && !args.replace {
        fail!(No, "{files} is there and differs: nothing is written; --replace writes over it");
    }
    if !args.dry_run {
        // The configuration is written last: until then the daemon finds the machine unchanged.
        let (first, last): (Vec<_>, Vec<_>) = wanted.iter().partition(|w| w.packed.kind != "configuration");
        for w in first.into_iter().chain(last) {
            write(w).with_context(|| format!("writing {}", w.to.display()))?;
        }
    }
    let names: Vec<String> = wanted.iter().map(|w| w.to.display().to_string()).collect();
    let Manifest { machine, made, record, .. } = &manifest;
    if args.json {
        return say_line(&serde_json::json!({
            "machine": machine, "made": made, "written": names, "left_out": left_out,
            "dry_run": args.dry_run, "record": record,
        }));
    }
    let done = if args.dry_run { "would be written" } else { "written" };
    for name in &names {
        println!("{name}: {done}");
    }
    for text in &left_out {
        println!("{text}");
    }
    println!("machine \"{machine}\" as of {made}: home scale and controller before you enable");
    Ok(())
}

/// Reads the archive's configuration, with its files, in a temporary folder.
/// The paths in the result are those after the restore.
fn checked(args: &Args, manifest: &Manifest, contents: &[Vec<u8>], folder: &Path) -> anyhow::Result<Config> {
    let trial = tempfile::Builder::new().prefix(".rtec-restore-").tempdir_in(folder);
    let trial = trial.with_context(|| format!("writing into {}", folder.display()))?;
    let mut config = None;
    for (packed, bytes) in manifest.files.iter().zip(contents) {
        if packed.path.is_absolute() || is_state(packed) {
            continue;
        }
        let to = trial.path().join(inside(args, packed)?);
        if packed.kind == "configuration" {
            config = Some(to.clone());
        }
        std::fs::create_dir_all(to.parent().unwrap_or(trial.path()))?;
        std::fs::write(to, bytes)?;
    }
    let none = || InputError::whole(&args.archive, "no configuration", "an archive of `rtecctl backup`");
    let mut config = Config::load(&config.ok_or_else(none)?).context("the configuration in the archive")?;
    let at_last = |path: &mut PathBuf| {
        if let Ok(relative) = path.strip_prefix(trial.path()) {
            *path = folder.join(relative);
        }
    };
    at_last(&mut config.control.socket);
    config.control.state_file.iter_mut().for_each(at_last);
    Ok(config)
}

fn is_state(packed: &PackedFile) -> bool {
    matches!(packed.kind.as_str(), "state" | "loaded")
}

/// A path of the archive, checked to stay inside its folder.
fn inside(args: &Args, packed: &PackedFile) -> Result<PathBuf, InputError> {
    let plain = packed.path.components().all(|part| matches!(part, Component::Normal(_)));
    if plain && !packed.path.as_os_str().is_empty() {
        return Ok(packed.path.clone());
    }
    let found = format!("the path {}", packed.path.display());
    Err(InputError::whole(&args.archive, found, "paths below the configuration's folder"))
}

/// The files to be written, and those that are not, in words.
fn wanted<'a>(
    args: &Args,
    manifest: &'a Manifest,
    contents: &'a [Vec<u8>],
    folder: &Path,
    config: &Config,
) -> anyhow::Result<(Vec<RestoredFile<'a>>, Vec<String>)> {
    let state = config.control.state_path();
    let (mut wanted, mut left_out) = (Vec::new(), Vec::new());
    for (packed, bytes) in manifest.files.iter().zip(contents) {
        let to = if is_state(packed) {
            let relative = inside(args, packed)?;
            if packed.kind == "state" && !args.with_state {
                Err("what the controller had in effect then (--with-state)".to_owned())
            } else if state.parent().is_none_or(|folder| !folder.is_dir()) {
                Err(format!("no folder for {}", state.display()))
            } else if packed.kind == "state" {
                Ok(state.clone())
            } else {
                Ok(state.with_file_name(relative))
            }
        } else if packed.path.is_absolute() {
            let why = || "it was outside the configuration's folder (--elsewhere)".to_owned();
            args.elsewhere.then(|| packed.path.clone()).ok_or_else(why)
        } else if packed.kind == "configuration" {
            Ok(args.config.clone())
        } else {
            Ok(folder.join(inside(args, packed)?))
        };
        match to {
            Ok(to) => wanted.push(RestoredFile { packed, bytes, to }),
            Err(why) => left_out.push(format!("{}: left out: {why}", packed.path.display())),
        }
    }
    Ok((wanted, left_out))
}

/// Writes a file whole, owned like its folder.
fn write(wanted: &RestoredFile<'_>) -> std::io::Result<()> {
    let parent = wanted.to.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(parent)?;
    let name = wanted.to.file_name().unwrap_or_default().to_string_lossy();
    let folder = UntrustedFolder::open(parent)?;
    folder.write(&name, wanted.bytes, wanted.packed.mode & 0o666 | 0o600, &|| true)?;
    if Uid::effective().is_root() {
        let owner = std::fs::metadata(parent)?;
        fchown(folder.file(&name)?, Some(Uid::from_raw(owner.uid())), Some(Gid::from_raw(owner.gid())))?;
    }
    Ok(())
}
