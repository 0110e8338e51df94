//! `rtecctl characterise record` and `evaluate` as a person runs them.

mod evaluate;
mod plan;
mod record;

use std::io::Write;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

fn rtecctl(folder: &Path, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .current_dir(folder)
        .arg("characterise")
        .args(words)
        .output()
        .unwrap()
}

fn said(out: &Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    (out.status.code(), text(&out.stdout), text(&out.stderr))
}

/// A feed of lines, one every 20 ms; returns its address.
fn feed(line: impl Fn(usize) -> String + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let Ok((mut stream, _)) = listener.accept() else { return };
        for i in 0.. {
            if stream.write_all(line(i).as_bytes()).is_err() {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    });
    address
}

struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    }
}

fn write(folder: &Path, name: &str, head: &str, columns: &[(&str, &str, &str)], rows: &[Vec<f64>]) {
    let listed = columns
        .iter()
        .map(|(column, role, unit)| format!("{column} = {{ role = \"{role}\", unit = \"{unit}\" }}"));
    let sidecar =
        format!("file = \"{name}.csv\"\n{head}\n[columns]\n{}\n", listed.collect::<Vec<_>>().join("\n"));
    let line = |r: &Vec<f64>| r.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let names = columns.iter().map(|c| c.0).collect::<Vec<_>>().join(",");
    let csv = std::iter::once(names).chain(rows.iter().map(line)).collect::<Vec<_>>().join("\n");
    std::fs::write(folder.join(format!("{name}.csv")), csv + "\n").unwrap();
    std::fs::write(folder.join(format!("{name}.run.toml")), sidecar).unwrap();
}

fn ballbar(folder: &Path, name: &str, feed_mm_s: f64) {
    let mut noise = Noise(5);
    let mut rows = Vec::new();
    let step = std::f64::consts::TAU * 1.02 / 720.0;
    let mut t = 0.0;
    for turn in [1.0, -1.0] {
        for i in 0..720 {
            let a: f64 = turn * (f64::from(i) + 0.5) * step + 0.3;
            let (s, c) = a.sin_cos();
            let square = 25e-3 * 150.0 * s * c;
            let travel = 150.0 * (1.0 - turn * s.signum() * c);
            let reversal = -turn * s.signum() * c * (2.5 + 4.0 * f64::exp(-travel / 0.6));
            let lag = turn * 0.3 * feed_mm_s * s * c;
            rows.push(vec![t, a, square + reversal + lag + 4.0 * c - 2.0 * s + 0.4 * noise.next()]);
            t += step * 150.0 / feed_mm_s;
        }
        t += 2.0;
    }
    let head = "kind = \"ballbar\"\nradius_mm = 150.0\nplane = [\"x\", \"y\"]";
    write(folder, name, head, &[("t", "time", "s"), ("a", "angle", "rad"), ("e", "error.r", "um")], &rows);
}

/// Pitch of x over 800 mm, in arcseconds.
fn tilt(folder: &Path) {
    let mut noise = Noise(30);
    let mut rows = Vec::new();
    for _ in 0..5 {
        for way in [1.0, -1.0] {
            for k in 0..11 {
                let x = 80.0 * f64::from(if way > 0.0 { k } else { 10 - k }) + 3.0;
                rows.push(vec![x, way, 2.5 * (x / 250.0).sin() + 0.3 * way + 0.2 * noise.next()]);
            }
        }
    }
    let columns =
        [("x", "position.x", "mm"), ("dir", "direction.x", "1"), ("pitch", "angle_error.x.b", "arcsec")];
    write(folder, "tilt", "kind = \"positioning\"", &columns, &rows);
}
