//! `tests/fetch-data`: fetches the measured data from a test server.
//! It needs the data themselves, from which it makes the owners' files.

use rtec_tests::{root, shared};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};

/// Served files by name, and requests with their first byte.
type Files = Arc<Mutex<(BTreeMap<String, Vec<u8>>, Vec<(String, usize)>)>>;

/// A server that resumes where asked, and else sends at most `cut` bytes.
fn serve(files: Files, cut: usize) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            let lines = BufReader::new(stream.try_clone().unwrap()).lines().map_while(Result::ok);
            let head: Vec<String> = lines.take_while(|l| !l.is_empty()).collect();
            let path = head.first().and_then(|l| l.split(' ').nth(1)).unwrap_or_default();
            let name = path.rsplit('/').next().unwrap_or_default().replace("%20", " ");
            let range = head
                .iter()
                .find_map(|l| l.to_ascii_lowercase().strip_prefix("range: bytes=").map(str::to_owned));
            let from: usize = range.map_or(0, |r| r.trim_end_matches('-').parse().unwrap());
            let mut files = files.lock().unwrap();
            let whole = files.0.get(&name).cloned().unwrap_or_default();
            files.1.push((name, from));
            let status = if from > 0 { "206 Partial Content" } else { "200 OK" };
            let mut answer = format!(
                "HTTP/1.1 {status}\r\nConnection: close\r\nContent-Length: {}\r\n",
                whole.len() - from
            );
            if from > 0 {
                write!(answer, "Content-Range: bytes {from}-{}/{}\r\n", whole.len() - 1, whole.len())
                    .unwrap();
            }
            let to = if from > 0 { whole.len() } else { whole.len().min(cut) };
            // The client may hang up early.
            let _ = stream.write_all(&[answer.as_bytes(), b"\r\n", &whole[from..to]].concat());
        }
    });
    address
}

fn fetch(from: &str, to: &Path) -> (bool, String) {
    let mut command = Command::new("sh");
    command.arg(root().join("tests/fetch-data")).arg(to).env("RTEC_DATA_FROM", from);
    let out = command.output().unwrap();
    (out.status.success(), String::from_utf8_lossy(&[out.stdout, out.stderr].concat()).into_owned())
}

#[test]
fn data_is_fetched_checked_and_gone_on_with() {
    let names = ["axis_iso230/y_axis.dat", "axis_iso230/y_axis_report.md", "spindle_thermal/first_half.csv"];
    let mut data = Vec::new();
    for name in names {
        let Some(file) = shared(&format!("data/{name}")) else { return };
        data.push(std::fs::read_to_string(file).unwrap());
    }
    // In the form of their owners.
    let log = "/home/anderssandstrom/source/ecmc_target_muts_logger/b02/y/y.log";
    let spindle = data[2].replacen("minute,growth_um", "delta L", 1);
    let rows =
        spindle.lines().enumerate().map(|(n, l)| if n == 0 { l } else { l.split_once(',').unwrap().1 });
    let spindle = rows.chain(["9,9"]).collect::<Vec<_>>().join("\n");
    let owned = [
        ("report_target_y.md_ISO230.dat", format!("TEST_DATA=# Input data file for: {log}\n{}", data[0])),
        ("report_target_y.md", data[1].replace("(log)", log)),
        ("Thermal Expansion Error.csv", spindle),
    ];
    let owned: BTreeMap<String, Vec<u8>> =
        owned.map(|(name, text)| (name.to_owned(), text.into_bytes())).into();
    let files = Files::new(Mutex::new((owned, Vec::new())));
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("data");
    let is_there = |n: usize| std::fs::read_to_string(to.join(names[n])).is_ok_and(|text| text == data[n]);

    // A changed file is not kept, and the others are fetched.
    files.lock().unwrap().0.get_mut("report_target_y.md").unwrap().push(b'x');
    let whole = serve(Arc::clone(&files), usize::MAX);
    let (good, said) = fetch(&whole, &to);
    assert!(!good && said.contains("y_axis_report.md: found SHA-256"), "{said}");
    assert!(is_there(0) && is_there(2), "{said}");
    assert_eq!(std::fs::read_dir(to.join("axis_iso230")).unwrap().count(), 1);

    // Repaired, and the spindle's connection breaks. The next run resumes where it stopped.
    files.lock().unwrap().0.get_mut("report_target_y.md").unwrap().pop();
    std::fs::remove_file(to.join(names[2])).unwrap();
    let broken = serve(Arc::clone(&files), 50_000);
    let (good, said) = fetch(&broken, &to);
    assert!(!good && is_there(1) && said.contains("was not fetched whole"), "{said}");
    files.lock().unwrap().1.clear();
    let (good, said) = fetch(&whole, &to);
    assert!(good && (0..3).all(is_there), "{said}");
    // Files that are there were not requested again.
    assert_eq!(files.lock().unwrap().1, [("Thermal Expansion Error.csv".to_owned(), 50_000)]);
}
