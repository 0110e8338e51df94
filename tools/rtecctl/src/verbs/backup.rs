//! `rtecctl backup`: a machine's set-up in one archive.
//! `restore` puts it back, here or on another computer.

use crate::archive::ArchiveWriter;
use crate::prelude::*;
use rtec_control::audit_log;
use rtec_control::config::{Config, INSTALLED};
use rtec_control::setup_files;
use rtec_model::record::hex;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::os::unix::fs::PermissionsExt;
use std::time::SystemTime;

/// Put a machine's set-up into one archive: configuration, model, card profile, devices list, state
///
/// Each file has its SHA-256 in the archive's manifest.json, beside number and hash of the last line of the record of commands. `rtecctl restore` puts it back, also on another computer. The
/// archive is for this user's eyes only. Works with or without a running daemon.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The archive; it must not exist yet
    #[arg(long, value_name = "FILE.tar")]
    out: PathBuf,
    /// The machine's configuration
    #[arg(long, value_name = "FILE", default_value = INSTALLED)]
    config: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Manifest {
    /// Version of the archive's format.
    pub form: u32,
    /// Time of the backup, UTC.
    pub made: String,
    /// The machine's name.
    pub machine: String,
    /// The program that made it; written as in every document.
    #[serde(skip_serializing, default)]
    pub by: String,
    /// The system that it was made on (os-release).
    pub system: String,
    /// Last line of the record of commands: number and hash.
    /// Below: the same of the refusals.
    pub record: Option<(u64, String)>,
    pub refused: Option<(u64, String)>,
    pub files: Vec<PackedFile>,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct PackedFile {
    /// Its name in the archive.
    pub name: String,
    /// Kind of the file.
    /// It is `configuration`, `profile`, `model`, `trace`, `recording`, `devices`, `state` or `loaded`.
    pub kind: String,
    /// Its path, relative to the configuration's folder or to the state file's.
    /// Other files have an absolute path.
    pub path: PathBuf,
    pub mode: u32,
    pub bytes: u64,
    pub sha256: String,
}

/// Version of the archive's format that this program writes and reads.
pub(crate) const FORM: u32 = 1;
/// First part of every name in the archive.
pub(crate) const TOP: &str = "rtec-backup";
pub(crate) const MANIFEST: &str = "manifest.json";
/// Largest total size of all files, bytes.
pub(crate) const LONGEST: u64 = 1 << 30;

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let file = args.config.as_path();
    if !file.exists() {
        let expected = "a machine's configuration: --config FILE";
        return Err(InputError::whole(file, "no such file", expected).into());
    }
    let config = Config::load(file)?;
    let folder = file.parent().unwrap_or(Path::new(""));
    let (mut files, mut contents, mut absent) = (Vec::new(), Vec::new(), Vec::new());
    let state = setup_files::state(&config).into_iter().map(|(kind, path)| (kind, path, true));
    let named = setup_files::of(file, &config)?.into_iter().map(|b| (b.kind, b.path, false));
    for (kind, path, is_state) in named.chain(state) {
        if !path.exists() {
            // State exists only if a daemon has run, and a list of devices is optional.
            if !is_state && kind != "devices" {
                absent.push(path.display().to_string());
            }
            continue;
        }
        let bytes = rtec_files::text_file::bytes(&path)?;
        let mode = std::fs::metadata(&path).with_context(|| path.display().to_string())?.permissions().mode();
        let relative = if is_state {
            path.file_name().map(PathBuf::from)
        } else {
            path.strip_prefix(folder).ok().map(Path::to_owned)
        };
        // A file elsewhere has its whole path in the manifest, and a number in the archive.
        let folder = if is_state { "state" } else { "files" };
        let (name, path) = match relative {
            Some(relative) => (format!("{folder}/{}", relative.display()), relative),
            None => (format!("elsewhere/{}", files.len()), std::path::absolute(&path)?),
        };
        let (kind, sha256) = (kind.to_owned(), hex(&Sha256::digest(&bytes)));
        files.push(PackedFile { name, kind, path, mode: mode & 0o777, bytes: bytes.len() as u64, sha256 });
        contents.push(bytes);
    }
    if let Some(first) = absent.first() {
        let expected = "every file that the configuration names: what is not there cannot be put back";
        return Err(InputError::whole(Path::new(first), "no such file", expected).into());
    }
    let log = config.control.log_path();
    let manifest = Manifest {
        form: FORM,
        made: audit_log::stamp(SystemTime::now()),
        machine: config.machine,
        by: String::new(),
        system: std::fs::read_to_string("/etc/os-release").unwrap_or_default(),
        record: audit_log::end(&log),
        refused: audit_log::end(&audit_log::refused_path(&log)),
        files,
    };
    let text = pretty(&manifest)?;
    let mut archive = ArchiveWriter::create(&args.out)?;
    let fill = || {
        archive.add(&format!("{TOP}/{MANIFEST}"), text.as_bytes())?;
        for (packed, bytes) in manifest.files.iter().zip(&contents) {
            archive.add(&format!("{TOP}/{}", packed.name), bytes)?;
        }
        archive.finish()
    };
    fill().with_context(|| format!("writing {}", args.out.display()))?;
    if args.json {
        print!("{text}");
        return Ok(());
    }
    for packed in &manifest.files {
        println!("{}: {}, {} bytes", packed.kind, packed.path.display(), packed.bytes);
    }
    println!("{}: {} files of machine \"{}\"", args.out.display(), manifest.files.len(), manifest.machine);
    Ok(())
}

/// Reads a whole archive, and checks every file by its hash.
pub(crate) fn read(path: &Path) -> anyhow::Result<(Manifest, Vec<Vec<u8>>)> {
    const OURS: &str = "an archive of `rtecctl backup`";
    let wrong = |found: String, expected: &str| InputError::whole(path, found, expected);
    let unreadable = |e: std::io::Error| wrong(e.to_string(), OURS);
    let file = rtec_files::text_file::open_regular(path)?;
    let mut archive = tar::Archive::new(std::io::Read::take(file, LONGEST));
    let mut manifest: Option<Manifest> = None;
    let mut found = std::collections::BTreeMap::new();
    for entry in archive.entries().map_err(unreadable)? {
        let mut entry = entry.map_err(unreadable)?;
        let name = entry.path().map_err(unreadable)?.to_string_lossy().into_owned();
        let name = name.strip_prefix(TOP).and_then(|n| n.strip_prefix('/')).map(str::to_owned);
        let Some(name) = name.filter(|_| entry.header().entry_type().is_file()) else {
            return Err(wrong("something that no backup has".to_owned(), OURS).into());
        };
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut entry, &mut bytes).map_err(unreadable)?;
        if name == MANIFEST {
            let read: Manifest = serde_json::from_slice(&bytes).map_err(|e| {
                wrong(format!("a manifest that cannot be read ({e})"), "one of `rtecctl backup`")
            })?;
            if read.form != FORM {
                let expected =
                    format!("form {FORM}: an `rtecctl` as new as the one that made it ({})", read.by);
                return Err(wrong(format!("form {}", read.form), &expected).into());
            }
            manifest = Some(read);
        } else if found.insert(name.clone(), bytes).is_some() {
            return Err(wrong(format!("{name} twice"), "each file once").into());
        }
    }
    let manifest = manifest.ok_or_else(|| wrong("no manifest".to_owned(), OURS))?;
    let mut contents = Vec::new();
    for packed in &manifest.files {
        let Some(bytes) = found.remove(&packed.name) else {
            return Err(wrong(format!("no {}", packed.name), "every file of its manifest").into());
        };
        if hex(&Sha256::digest(&bytes)) != packed.sha256 || bytes.len() as u64 != packed.bytes {
            let found = format!("another {} than was put in (its SHA-256 is another)", packed.name);
            return Err(wrong(found, "the archive as it was made").into());
        }
        contents.push(bytes);
    }
    if let Some((name, _)) = found.pop_first() {
        let found = format!("{name}, which its manifest does not name");
        return Err(wrong(found, "the archive as it was made").into());
    }
    Ok((manifest, contents))
}
