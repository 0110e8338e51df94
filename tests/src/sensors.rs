//! Two simulated temperature sensors on a line: T1 is adjustable, T2 is 20 °C.

use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// The sensors, until the process ends.
#[derive(Debug)]
pub struct Sensors {
    /// Address of the sensors for `from` in a configuration.
    pub address: String,
    /// The sensors are silent while this is set.
    pub silent: Arc<AtomicBool>,
    t1: Arc<AtomicU64>,
}

impl Sensors {
    /// Starts the sensors with T1 at this temperature, °C.
    pub fn start(t1_c: f64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap_or_else(|e| panic!("{e}"));
        let address = listener.local_addr().unwrap_or_else(|e| panic!("{e}")).to_string();
        let sensors = Self { address, t1: Arc::new(AtomicU64::new(t1_c.to_bits())), silent: Arc::default() };
        let (t1, silent) = (Arc::clone(&sensors.t1), Arc::clone(&sensors.silent));
        std::thread::spawn(move || {
            for peer in listener.incoming().map_while(Result::ok) {
                let (t1, silent) = (Arc::clone(&t1), Arc::clone(&silent));
                std::thread::spawn(move || send_readings(&peer, &t1, &silent));
            }
        });
        sensors
    }

    /// Sets the temperature of T1, °C.
    pub fn set(&self, t1_c: f64) {
        self.t1.store(t1_c.to_bits(), Ordering::Relaxed);
    }

    /// Both sensors as tables of a configuration.
    pub fn config(&self) -> String {
        ["T1", "T2"].map(|name| {
            format!(
                "[[sensor]]\nname = '{name}'\nplace = 'spindle'\nsource = 'line'\nfrom = '{}'\nperiod_s = 0.2\ntimeout_s = 1\n\
                 freeze_s = 2\nmax_rate_K_per_min = 10000\n",
                self.address
            )
        })
        .concat()
    }
}

fn send_readings(mut peer: &TcpStream, t1: &AtomicU64, silent: &AtomicBool) {
    loop {
        let said = format!("T1 {}\nT2 20\n", f64::from_bits(t1.load(Ordering::Relaxed)));
        if !silent.load(Ordering::Relaxed) && peer.write_all(said.as_bytes()).is_err() {
            return;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}
