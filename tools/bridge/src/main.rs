//! `rtec-mqtt`: publishes the corrector's state to a plant's MQTT broker.
//! It reads the daemon's view socket and commands nothing. It subscribes to nothing either.
//!
//! | topic under `--topic` | payload | retained |
//! |---|---|---|
//! | `bridge` | `online`; `offline` is its last will | yes |
//! | `daemon` | `online`, `offline` | yes |
//! | `status` | the document of `rtecctl status --json` | yes |
//! | `axes/NAME` | that axis of it | yes |
//! | `faults` | latched faults: `[{"axis":"x","fault":"poll_gap"}]`, the machine's own with `null` | yes |
//! | `event` | each event as it comes; `{"missed":N}` where some are lost | no |
//!
//! MQTT was chosen over OPC UA because the companion specifications of OPC UA have no object for a compensation or its
//! ledger. A server would offer plain variables, and need certificates, an address space and an open port. Here nothing
//! listens, and any plant's gateway takes JSON topics. For TLS, a broker on this computer forwards the topics
//! (mosquitto: `connection`, `bridge_cafile`).
//!
//! This crate must not decide or command anything. The protocol is in `rtec-control`, and not repeated here.

mod mqtt_publisher;

use clap::Parser;
use mqtt_publisher::{BrokerConnection, ConnectOptions};
use rtec_control::config::{Config, ControlConfig};
use rtec_control::daemon_client::DaemonConnection;
use rtec_control::protocol::{ClientRequest, DaemonResponse, DaemonSnapshot, DaemonStatus, word};
use rtec_files::eprintln;
use serde_json::{Value, json};
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// The corrector's state for an MQTT broker; nothing can be commanded through it
#[derive(Debug, Parser)]
#[command(
    name = "rtec-mqtt",
    version,
    after_help = "Example: rtec-mqtt --broker 127.0.0.1:1883 --topic plant/mill3\nExit codes: 2 bad usage; it runs until it is ended"
)]
struct Args {
    /// The broker, as HOST:PORT; it is looked for again and again
    #[arg(long, default_value = "127.0.0.1:1883", value_name = "HOST:PORT")]
    broker: String,
    /// What every topic begins with
    #[arg(long, default_value = "rtec", value_name = "TOPIC")]
    topic: String,
    /// Time between two looks at the daemon
    #[arg(long, default_value = "1s", value_name = "TIME")]
    every: humantime::Duration,
    /// The name to log in with
    #[arg(long, value_name = "NAME", requires = "password_file")]
    user: Option<String>,
    /// The file that holds its password, in its first line
    #[arg(long, value_name = "FILE", requires = "user")]
    password_file: Option<PathBuf>,
    /// The client id [default: rtec- and the process number]
    #[arg(long, value_name = "ID")]
    client_id: Option<String>,
    /// The daemon's control socket, or its view socket [default: the configuration's]
    #[arg(long, value_name = "PATH", conflicts_with = "config")]
    socket: Option<PathBuf>,
    /// The daemon's configuration [default: /etc/rtec/rtec.toml where it exists]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

const AGAIN: Duration = Duration::from_secs(1);
const FASTEST: Duration = Duration::from_millis(50);
const SLOWEST: Duration = Duration::from_secs(60);

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("rtec-mqtt: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn run(args: &Args) -> anyhow::Result<()> {
    let every = Duration::from(args.every);
    anyhow::ensure!((FASTEST..=SLOWEST).contains(&every), "--every: found {every:?}, expected 50ms to 60s");
    anyhow::ensure!(
        !args.topic.is_empty() && !args.topic.contains(['+', '#', '\0']) && args.topic.len() < 1000,
        "--topic: found {:?}, expected a topic without + and #",
        args.topic
    );
    anyhow::ensure!(args.broker.contains(':'), "--broker: found {:?}, expected HOST:PORT", args.broker);
    if let Some(file) = &args.config {
        Config::load(file)?;
    }
    let password = match &args.password_file {
        None => Vec::new(),
        Some(file) => {
            let text = rtec_files::text_file::read(file)?;
            text.lines().next().unwrap_or_default().as_bytes().to_vec()
        }
    };
    let client_id = args.client_id.clone().unwrap_or_else(|| format!("rtec-{}", std::process::id()));
    let will = format!("{}/bridge", args.topic);
    let login = ConnectOptions {
        client_id: &client_id,
        user: args.user.as_deref().map(|name| (name, &password[..])),
        keep_alive: SLOWEST * 2,
        will: (&will, b"offline"),
    };
    let mut bridge = DaemonToMqttBridge { args, client: None, known: None, uptime_s: 0.0 };
    let mut said = String::new();
    loop {
        let opened = BrokerConnection::open(&args.broker, &login);
        if opened.is_ok() {
            said.clear();
        }
        if let Err(error) = opened.and_then(|mut broker| bridge.serve(&mut broker, every)) {
            let why = error.to_string();
            // The same reason is printed once, so that a broker that is away for days does not fill the log.
            if why != said {
                eprintln!("rtec-mqtt: broker {}: {why}; again every {AGAIN:?}", args.broker);
                said = why;
            }
        }
        std::thread::sleep(AGAIN);
    }
}

struct DaemonToMqttBridge<'a> {
    args: &'a Args,
    client: Option<DaemonConnection>,
    /// Number of the last event that the broker has; `None` before the first look.
    known: Option<u64>,
    uptime_s: f64,
}

impl DaemonToMqttBridge<'_> {
    /// Publishes until the broker is gone.
    fn serve(&mut self, broker: &mut BrokerConnection, every: Duration) -> io::Result<()> {
        eprintln!("rtec-mqtt: at broker {}, topics {}/…", self.args.broker, self.args.topic);
        self.put(broker, "bridge", b"online")?;
        let (mut daemon, mut faults) = ("", Value::Null);
        loop {
            let now = match self.look() {
                Ok(seen) => {
                    let status = &seen.status;
                    self.put(broker, "status", json!(status).to_string().as_bytes())?;
                    for axis in &status.axes {
                        let name = axis.name.replace(['/', '+', '#'], "_");
                        self.put(broker, &format!("axes/{name}"), json!(axis).to_string().as_bytes())?;
                    }
                    let latched = latched(status);
                    if latched != faults {
                        self.put(broker, "faults", latched.to_string().as_bytes())?;
                        faults = latched;
                    }
                    self.tell(broker, &seen)?;
                    "online"
                }
                Err(error) => {
                    if daemon != "offline" {
                        // The error's text includes its cause.
                        eprintln!("rtec-mqtt: {error}");
                    }
                    self.client = None;
                    "offline"
                }
            };
            if now != daemon {
                self.put(broker, "daemon", now.as_bytes())?;
                daemon = now;
            }
            broker.ping()?;
            std::thread::sleep(every);
        }
    }

    fn put(&self, broker: &mut BrokerConnection, topic: &str, payload: &[u8]) -> io::Result<()> {
        broker.publish(&format!("{}/{topic}", self.args.topic), payload, true)
    }

    /// Publishes new events, and notes them once the broker has answered a ping.
    fn tell(&mut self, broker: &mut BrokerConnection, seen: &DaemonSnapshot) -> io::Result<()> {
        let last = seen.events.last().map_or(self.known.unwrap_or(0), |e| e.n);
        if self.known.is_some() {
            let topic = format!("{}/event", self.args.topic);
            if seen.events_missed > 0 {
                broker.publish(
                    &topic,
                    json!({ "missed": seen.events_missed }).to_string().as_bytes(),
                    false,
                )?;
            }
            for event in &seen.events {
                broker.publish(&topic, json!(event).to_string().as_bytes(), false)?;
            }
            broker.ping()?;
        }
        self.known = Some(last);
        Ok(())
    }

    fn look(&mut self) -> anyhow::Result<DaemonSnapshot> {
        let seen = self.observe()?;
        // A daemon that has restarted counts its events from the beginning.
        let anew = seen.status.uptime_s < self.uptime_s;
        self.uptime_s = seen.status.uptime_s;
        if anew && self.known.is_some() {
            self.known = Some(0);
            return self.observe();
        }
        Ok(seen)
    }

    fn observe(&mut self) -> anyhow::Result<DaemonSnapshot> {
        let client = match &mut self.client {
            Some(client) => client,
            empty => empty.insert(connect(self.args)?),
        };
        match client.ask(&ClientRequest::Observe { events_after: Some(self.known.unwrap_or(0)) })? {
            DaemonResponse::Observed(seen) => Ok(*seen),
            other => anyhow::bail!("rtecd answered {other:?}; are rtec-mqtt and rtecd of the same version?"),
        }
    }
}

/// Connects to the view socket, or to the control socket where this user may not.
fn connect(args: &Args) -> anyhow::Result<DaemonConnection> {
    let sockets = ControlConfig::of(args.config.as_deref(), args.socket.as_deref())?.sockets();
    Ok(DaemonConnection::connect_to(&[&sockets[2].path, &sockets[1].path, &sockets[0].path])?)
}

fn latched(status: &DaemonStatus) -> Value {
    let machine = status.faults.iter().map(|f| json!({ "axis": null, "fault": word(f) }));
    let axes = status.axes.iter();
    let axes = axes.flat_map(|a| a.faults.iter().map(|f| json!({ "axis": a.name, "fault": word(f) })));
    machine.chain(axes).collect()
}
