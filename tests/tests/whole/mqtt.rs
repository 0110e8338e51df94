//! `rtec-mqtt` at a real broker, seen by a real client.
//! They are Debian's mosquitto and `mosquitto_sub`. A fault arrives, the daemon restarts, the broker restarts, the
//! bridge is killed.

use rtec_tests::daemon::{Daemon, among_others, program, until};
use rtec_tests::skipped;
use std::io::{BufRead, BufReader, Read};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};

struct ChildProgram(Child);

impl Drop for ChildProgram {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn broker(directory: &Path, port: u16) -> ChildProgram {
    let config = directory.join("mosquitto.conf");
    let text = format!("listener {port} 127.0.0.1\nallow_anonymous true\n");
    std::fs::write(&config, text).unwrap();
    let child =
        Command::new("mosquitto").arg("-c").arg(config).stderr(Stdio::null()).stdout(Stdio::null()).spawn();
    let broker = ChildProgram(child.unwrap());
    until("the broker listens", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    broker
}

/// A real client that records its messages, a line `TOPIC PAYLOAD` each.
struct Listener {
    _child: ChildProgram,
    heard: Arc<Mutex<Vec<String>>>,
}

impl Listener {
    fn at(port: u16) -> Self {
        let mut child = Command::new("mosquitto_sub")
            .args(["-h", "127.0.0.1", "-p", &port.to_string(), "-v", "-t", "plant/mill/#"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let heard = Arc::new(Mutex::new(Vec::new()));
        let (out, to) = (child.stdout.take().unwrap(), Arc::clone(&heard));
        std::thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                to.lock().unwrap().push(line);
            }
        });
        Self { _child: ChildProgram(child), heard }
    }

    fn heard(&self, is: impl Fn(&str) -> bool) -> bool {
        self.heard.lock().unwrap().iter().any(|line| is(line))
    }
}

#[test]
fn a_client_hears_faults_the_daemons_restart_and_the_brokers() {
    for (program, package) in [("mosquitto", "mosquitto"), ("mosquitto_sub", "mosquitto-clients")] {
        if Command::new(program).arg("-h").output().is_err() {
            return skipped(&format!("no {program} (Debian: {package})"));
        }
    }
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::enabled(&socket);
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let first_broker = broker(directory.path(), port);
    let bridge = ChildProgram(
        Command::new(program("rtec-mqtt"))
            .args([
                "--broker",
                &format!("127.0.0.1:{port}"),
                "--topic",
                "plant/mill",
                "--every",
                "100ms",
                "--socket",
            ])
            // The socket for readers is enough for the bridge.
            .arg(directory.path().join("s-view"))
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let client = Listener::at(port);
    until("online", || {
        client.heard(|l| l == "plant/mill/daemon online") && client.heard(|l| l == "plant/mill/bridge online")
    });
    until("a status", || {
        client.heard(|l| l.starts_with("plant/mill/status {") && l.contains("\"mode\":\"run\""))
    });
    until("an axis", || {
        client.heard(|l| {
            l.starts_with("plant/mill/axes/x {\"name\":\"x\"") || l.starts_with("plant/mill/axes/x {")
        })
    });
    assert!(client.heard(|l| l == "plant/mill/faults []"));

    for code in [1, 1, 4] {
        daemon.expect(code, &["correct", "x", "900"]);
    }
    let fault = |l: &str| {
        l.starts_with("plant/mill/faults [{") && l.contains("still_not_believed") && l.contains("\"x\"")
    };
    until("the fault", || client.heard(fault));
    until("its event", || {
        client.heard(|l| l.starts_with("plant/mill/event {") && l.contains("\"kind\":\"fault\""))
    });

    daemon.end("TERM");
    until("the daemon's end", || client.heard(|l| l == "plant/mill/daemon offline"));
    let daemon = Daemon::start(&socket, None);
    let times = |what: &str| client.heard.lock().unwrap().iter().filter(|l| *l == what).count();
    until("the daemon again", || times("plant/mill/daemon online") == 2);
    until("no fault any more", || times("plant/mill/faults []") == 2);
    daemon.expect(0, &["home"]);
    until("an event of the new daemon", || client.heard(|l| l.contains("\"kind\":\"homed\"")));

    // The broker starts again with nothing retained, so everything is published again.
    drop(first_broker);
    let _second_broker = broker(directory.path(), port);
    let after = Listener::at(port);
    until("told again", || {
        ["plant/mill/bridge online", "plant/mill/daemon online", "plant/mill/faults []"]
            .iter()
            .all(|wanted| after.heard(|l| l == *wanted))
            && after.heard(|l| l.starts_with("plant/mill/status {"))
    });
    // The bridge is killed, and its last will is published.
    drop(bridge);
    until("the last will", || after.heard(|l| l == "plant/mill/bridge offline"));
}

#[test]
fn a_broker_that_stays_away_is_one_line() {
    if !test_needs::long() {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    // A server that reads everything and then hangs up.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let mut command = Command::new(program("rtec-mqtt"));
    command.args(["--broker", &format!("127.0.0.1:{port}"), "--socket"]).arg(directory.path().join("s"));
    let mut bridge = ChildProgram(command.stderr(Stdio::piped()).spawn().unwrap());
    for _ in 0..4 {
        let (mut stream, _) = listener.accept().unwrap();
        assert!(stream.read(&mut [0; 1024]).unwrap() > 0);
    }
    bridge.0.kill().unwrap();
    let mut said = String::new();
    bridge.0.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(said.lines().count(), 1, "{said}");
    assert!(said.starts_with("rtec-mqtt: broker 127.0.0.1:") && said.contains("again every 1s"), "{said}");
}

#[test]
fn a_password_is_in_a_file() {
    let run = Command::new(program("rtec-mqtt"))
        .args(["--user", "anna", "--password-file", "/dev/zero"])
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(2));
    let said = String::from_utf8(run.stderr).unwrap();
    assert!(said.contains("/dev/zero: found a pipe, socket or device, expected a regular file"), "{said}");
}
