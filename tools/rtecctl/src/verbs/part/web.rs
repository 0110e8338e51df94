//! A small page on this machine only: the drawing, click to add or remove points, the probe's path, save.

use rtec_part::contour::Contour;
use rtec_part::fit::Zx;
use rtec_part::path::Plan;
use rtec_part::unit::Unit;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use tiny_http::{Header, Method, Request, Response, Server};

const PAGE: &str = include_str!("page.html");
/// A larger request is none of the page's.
const MAX_BODY: usize = 4096;

/// What the page edits.
#[derive(Debug)]
pub(crate) struct PlanEditor {
    /// The part that is probed.
    pub(crate) contour: Contour,
    /// Gauging points and the probe's path, as edited so far.
    pub(crate) plan: Plan,
    /// Unit of the path file.
    pub(crate) unit: Unit,
    /// Folder that `Save` writes to.
    pub(crate) folder: PathBuf,
    /// Clearance of the by-passes the page adds on request.
    pub(crate) clear_mm: f64,
}

/// A page that waits to be served.
pub(crate) struct Page {
    server: Server,
    address: SocketAddr,
}

impl Page {
    /// Listen on the loopback address; port 0 takes a free one.
    ///
    /// # Errors
    /// As the system reports them: the port is taken, no loopback.
    pub(crate) fn listen(port: u16) -> std::io::Result<Self> {
        let server = Server::http(SocketAddr::from(([127, 0, 0, 1], port))).map_err(std::io::Error::other)?;
        let address = server.server_addr().to_ip().ok_or_else(|| std::io::Error::other("no IP address"))?;
        Ok(Self { server, address })
    }

    /// Address of the page, for a browser on this computer.
    #[must_use]
    pub(crate) fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Answer until the page says it is done.
    ///
    /// # Errors
    /// The listening socket failed.
    pub(crate) fn serve(&self, session: &mut PlanEditor) -> std::io::Result<()> {
        loop {
            let mut request = self.server.recv()?;
            let (status, kind, body) = if self.is_ours(&request) {
                answer(session, &mut request)
            } else {
                (403, "text/plain", "only the page of this machine may ask".to_owned())
            };
            let done = status == 200 && request.url() == "/done";
            let headers = [("Content-Type", kind), ("Cache-Control", "no-store")];
            let response =
                headers.iter().fold(Response::from_string(body).with_status_code(status), |r, (k, v)| {
                    match Header::from_bytes(*k, *v) {
                        Ok(header) => r.with_header(header),
                        Err(()) => r,
                    }
                });
            // The browser may be gone: its next request will show it.
            let _ = request.respond(response);
            if done {
                return Ok(());
            }
        }
    }

    /// Another site in the same browser must not drive this page: its name and origin give it away.
    fn is_ours(&self, request: &Request) -> bool {
        let header = |name: &str| {
            request
                .headers()
                .iter()
                .find(|h| h.field.as_str().as_str().eq_ignore_ascii_case(name))
                .map(|h| h.value.as_str())
        };
        let hosts = [self.address.to_string(), format!("localhost:{}", self.address.port())];
        let is_host = |h: &str| hosts.iter().any(|mine| mine == h);
        header("Host").is_some_and(is_host)
            && header("Origin").is_none_or(|o| o.strip_prefix("http://").is_some_and(is_host))
    }
}

fn answer(session: &mut PlanEditor, request: &mut Request) -> (u16, &'static str, String) {
    const JSON: &str = "application/json";
    let get = *request.method() == Method::Get;
    if get && request.url() == "/" {
        return (200, "text/html; charset=utf-8", PAGE.to_owned());
    }
    if get && request.url() == "/plan" {
        return (200, JSON, state(session).to_string());
    }
    if *request.method() != Method::Post {
        return (404, "text/plain", "no such page".to_owned());
    }
    let mut body = String::new();
    let read = std::io::Read::read_to_string(
        &mut std::io::Read::take(request.as_reader(), MAX_BODY as u64),
        &mut body,
    );
    let asked: Value = match read.ok().and_then(|_| serde_json::from_str(&body).ok()) {
        Some(asked) => asked,
        None => return (400, "text/plain", "a JSON object was expected".to_owned()),
    };
    match change(session, request.url(), &asked) {
        Ok(()) => (200, JSON, state(session).to_string()),
        Err(why) => (400, "text/plain", why),
    }
}

fn change(session: &mut PlanEditor, what: &str, asked: &Value) -> Result<(), String> {
    let number =
        |key: &str| asked[key].as_f64().filter(|v| v.is_finite()).ok_or(format!("{key} must be a number"));
    let place = || Ok::<_, String>(Zx::new(number("z")?, number("x")?));
    match what {
        "/add" => {
            let nearest = session.contour.nearest(place()?).ok_or("the drawing has no contour")?;
            session.plan.add(nearest);
        }
        "/remove" | "/clear" => {
            let index = asked["index"].as_u64().map(|i| i as usize);
            let index = index.filter(|i| *i < session.plan.points.len()).ok_or("no such point")?;
            match what {
                "/remove" => session.plan.remove(index),
                _ => session.plan.points[index].bypass.clear(),
            }
        }
        "/bypass" => {
            let at = place()?;
            let index = number("index")? as usize;
            let point = session.plan.points.get_mut(index).filter(|_| index > 0);
            point.ok_or("a by-pass leads from one point to the next")?.bypass.push(at);
        }
        "/bypasses" => session.plan.add_bypasses(&session.contour, session.clear_mm),
        "/save" => save(session).map_err(|e| format!("cannot save: {e}"))?,
        "/done" => {}
        other => return Err(format!("nothing is known as {other}")),
    }
    Ok(())
}

fn save(session: &PlanEditor) -> std::io::Result<()> {
    std::fs::create_dir_all(&session.folder)?;
    for (name, text) in session.plan.files(&session.contour, session.unit) {
        rtec_files::write::whole(&Path::new(&session.folder).join(name), text.as_bytes())?;
    }
    Ok(())
}

/// What the page draws, as JSON.
fn state(session: &PlanEditor) -> Value {
    let pair = |p: Zx| [p.z, p.x];
    let contour: Vec<Value> = session
        .contour
        .chords()
        .iter()
        .map(|(i, chords)| {
            let points: Vec<[f64; 2]> = chords.iter().map(|&p| pair(p)).collect();
            json!({"name": session.contour.features[*i].name, "points": points})
        })
        .collect();
    let expected = session.plan.expected();
    let points: Vec<Value> = session
        .plan
        .points
        .iter()
        .zip(&expected)
        .map(|(p, &trip)| {
            let bypass: Vec<[f64; 2]> = p.bypass.iter().map(|&b| pair(b)).collect();
            json!({"at": pair(p.place.at), "feature": session.contour.features[p.place.feature].name,
                   "trip": pair(trip), "bypass": bypass})
        })
        .collect();
    let moves: Vec<Value> =
        session.plan.records().iter().map(|r| json!({"role": r.role, "at": pair(r.at)})).collect();
    json!({"contour": contour, "points": points, "moves": moves, "hits": session.plan.hits(&session.contour),
           "tip_mm": session.plan.probe.tip_mm, "folder": session.folder})
}
