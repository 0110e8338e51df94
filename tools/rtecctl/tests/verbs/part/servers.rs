//! The NC program in LinuxCNC, and the page of the probing points.

use crate::parts::{drawing, json, part};
use serde_json::Value;
use std::process::Command;

/// A server that answers as LinuxCNC's `linuxcncrsh` does.
/// It echoes until told not to, and acknowledges in verbose mode.
fn linuxcncrsh(opens: bool) -> (std::net::SocketAddr, std::thread::JoinHandle<Vec<String>>) {
    use std::io::{BufRead as _, Write as _};
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut heard = Vec::new();
        let (mut echo, mut verbose, mut open) = (true, false, "none".to_owned());
        for line in std::io::BufReader::new(stream.try_clone().unwrap()).lines() {
            let Ok(line) = line else { break };
            let line = line.trim().to_owned();
            let words: Vec<&str> = line.split(' ').collect();
            let mut say = |text: String| stream.write_all((text + "\r\n").as_bytes()).unwrap();
            if echo {
                say(line.clone());
            }
            match words[..] {
                ["hello", "EMC", ..] => say("HELLO ACK EMCNETSVR 1.1".into()),
                ["hello", ..] => say("HELLO NAK".into()),
                ["set", "echo", "off"] => echo = false,
                ["set", "open", _] if !opens => say("SET OPEN NAK".into()),
                ["set", what, value] => {
                    verbose |= what == "verbose";
                    if what == "open" {
                        value.clone_into(&mut open);
                    }
                    if verbose {
                        say(format!("SET {} ACK", what.to_uppercase()));
                    }
                }
                ["get", "program"] => say(format!("PROGRAM {open}")),
                ["quit"] => break,
                _ => {}
            }
            heard.push(line);
        }
        heard
    });
    (address, server)
}

/// NISTIR 4854, Operating Procedure: the program is down-loaded to the MTC.
/// Here this uses LinuxCNC's own network interface.
#[test]
fn the_program_is_opened_in_linuxcnc() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("nose.dxf"), drawing(38.1)).unwrap();
    std::fs::create_dir(folder.join("nc_files")).unwrap();
    json(folder, &["points", "nose.dxf", "--feature", "F1:5", "--tip-mm", "2.5", "--out", "o", "--json"]);
    let program = |more: &str| {
        let line = format!("program --path o/pathfin.cdl --dialect linuxcnc --set part=6304 --out o {more}");
        part(folder, &line.split_whitespace().collect::<Vec<_>>())
    };
    let (address, server) = linuxcncrsh(true);
    let done = program(&format!("--program-folder nc_files --folder-there /nc --download {address}"));
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let heard = server.join().unwrap();
    let place = heard.iter().position(|l| l == "set open /nc/pt6304s2.dnc").unwrap();
    assert!(
        heard[..place].contains(&"set enable EMCTOO".to_owned()) && heard.contains(&"get program".to_owned())
    );
    let text = |at: &str| std::fs::read_to_string(folder.join(at)).unwrap();
    assert_eq!(text("nc_files/pt6304s2.dnc"), text("o/pt6304s2.dnc"));
    // Refused, accepted with another password, nothing listening, no folder.
    let (address, server) = linuxcncrsh(false);
    let refused = program(&format!("--program-folder nc_files --download {address}"));
    assert_eq!(refused.status.code(), Some(1), "{}", String::from_utf8_lossy(&refused.stderr));
    drop(server);
    let (address, server) = linuxcncrsh(true);
    let other = program(&format!("--program-folder nc_files --download {address} --passwords x,y"));
    assert_eq!(other.status.code(), Some(1));
    drop(server);
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    assert_eq!(program(&format!("--program-folder nc_files --download {nobody}")).status.code(), Some(3));
    assert_eq!(program("--program-folder none").status.code(), Some(2));
    assert_eq!(program("--download x").status.code(), Some(2));
}

/// One request written by hand; returns the status line and the rest.
fn http(address: &str, request: &str) -> String {
    let mut stream = std::net::TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(std::time::Duration::from_secs(30))).unwrap();
    std::io::Write::write_all(&mut stream, request.as_bytes()).unwrap();
    let mut answer = String::new();
    std::io::Read::read_to_string(&mut stream, &mut answer).unwrap();
    answer
}

#[test]
fn the_page_is_for_whoever_started_it_and_nobody_holds_it_up() {
    use std::io::{BufRead, Write};
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("nose.dxf"), drawing(38.1)).unwrap();
    let mut page = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .args(["part", "points", "nose.dxf", "--feature", "F1:5", "--tip-mm", "2.5", "--web", "--out", "out"])
        .current_dir(folder.path())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    std::io::BufReader::new(page.stderr.take().unwrap()).read_line(&mut line).unwrap();
    let url = line.split_whitespace().find(|w| w.starts_with("http://")).unwrap_or_else(|| panic!("{line}"));
    let (address, secret) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let secret = secret.trim_end_matches('/');
    assert!(secret.len() == 32 && secret.chars().all(|c| c.is_ascii_hexdigit()), "{url}");
    let post = |path: &str, body: &str| {
        let length = body.len();
        let head = format!(
            "POST {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nContent-Length: {length}"
        );
        http(address, &format!("{head}\r\n\r\n{body}"))
    };
    // Another user of this computer can find the port, but nothing more.
    for path in ["/remove", "/00000000000000000000000000000000/remove", "/save", "/done", "/"] {
        let answer = post(path, "{\"index\":0}");
        assert!(answer.starts_with("HTTP/1.1 403"), "{path}: {answer}");
    }
    // Such a user cannot block it with a slow request, nor with any stated length.
    let strangers: Vec<_> = [3_000_000_u64, 1_000_000_000_000_000]
        .into_iter()
        .flat_map(|length| [format!("{length}"), format!("{length}\r\nExpect: 100-continue")])
        .map(|length| {
            let mut stranger = std::net::TcpStream::connect(address).unwrap();
            let head = format!("POST /add HTTP/1.1\r\nHost: {address}\r\nContent-Length: {length}\r\n\r\n{{");
            stranger.write_all(head.as_bytes()).unwrap();
            stranger
        })
        .collect();
    // A client that never finishes its request blocks no other.
    let mut slow = std::net::TcpStream::connect(address).unwrap();
    let head = format!("POST /{secret}/add HTTP/1.1\r\nHost: {address}\r\nContent-Length: 3000\r\n\r\n{{");
    slow.write_all(head.as_bytes()).unwrap();
    let answer = post(&format!("/{secret}/remove"), "{\"index\":0}");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    let plan: Value = serde_json::from_str(answer.split("\r\n\r\n").nth(1).unwrap()).unwrap();
    assert_eq!(plan["points"].as_array().unwrap().len(), 4);
    let answer = post(&format!("/{secret}/done"), "{}");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert_eq!(page.wait().unwrap().code(), Some(0));
    drop(strangers);
}
