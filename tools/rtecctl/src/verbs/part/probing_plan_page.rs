//! A page for this computer only that edits the probing points.
//! It shows the drawing and the probe's path; a click adds or removes points.
//!
//! Every user of this computer can reach the port. The address contains a secret that only the user who
//! started the page receives. A request without it is refused unread. Each request has a thread, so one that
//! never ends does not block others.

use crate::http_server::{HttpRequest, HttpRequestHandler, HttpResponse, HttpServer};
use crate::prelude::*;
use rtec_model::record::hex;
use rtec_part::contour::Contour;
use rtec_part::geometric_fit::Zx;
use rtec_part::length_unit::LengthUnit;
use rtec_part::probe_path::ProbingPlan;
use std::fs::File;
use std::io::Read;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

const PAGE: &str = include_str!("page.html");

#[derive(Debug)]
pub(crate) struct ProbingPlanEditor {
    /// The part that is probed.
    pub(crate) contour: Contour,
    /// Gauging points and the probe's path, as edited so far.
    pub(crate) plan: ProbingPlan,
    /// Unit of the path file.
    pub(crate) unit: LengthUnit,
    /// Folder that `Save` writes to.
    pub(crate) folder: PathBuf,
    /// Clearance of the by-passes the page adds on request.
    pub(crate) clear_mm: f64,
}

pub(crate) struct ProbingPlanPageServer {
    server: HttpServer,
    address: SocketAddr,
    /// First part of every path.
    secret: String,
}

impl ProbingPlanPageServer {
    /// Listens on the loopback address; port 0 takes a free one.
    ///
    /// # Errors
    /// As the system reports them: the port is taken, no loopback.
    pub(crate) fn listen(port: u16) -> std::io::Result<Self> {
        let server = HttpServer::tcp(SocketAddr::from(([127, 0, 0, 1], port)))?;
        let address = server.address()?;
        let mut bytes = [0; 16];
        File::open("/dev/urandom")?.read_exact(&mut bytes)?;
        Ok(Self { server, address, secret: format!("/{}", hex(&bytes)) })
    }

    /// Address of the page, for a browser on this computer.
    pub(crate) fn url(&self) -> String {
        format!("http://{}{}/", self.address, self.secret)
    }

    /// Answers until the page reports that it is done.
    ///
    /// # Errors
    /// The listening socket failed.
    pub(crate) fn serve(&self, session: ProbingPlanEditor) -> std::io::Result<()> {
        let done = Arc::<AtomicBool>::default();
        let asked = PlanRequestHandler {
            secret: self.secret.clone(),
            address: self.address,
            session: Mutex::new(session),
            done: Arc::clone(&done),
        };
        self.server.serve(&Arc::new(asked), &done)?;
        // The last answer is still being sent.
        std::thread::sleep(LAST_ANSWER);
        Ok(())
    }
}

const LAST_ANSWER: Duration = Duration::from_millis(100);

struct PlanRequestHandler {
    secret: String,
    address: SocketAddr,
    session: Mutex<ProbingPlanEditor>,
    done: Arc<AtomicBool>,
}

impl PlanRequestHandler {
    fn what<'r>(&self, request: &'r HttpRequest) -> Option<&'r str> {
        request.path.strip_prefix(&self.secret).filter(|what| what.starts_with('/'))
    }

    /// Whether a request comes from this page.
    /// Another site in the same browser must not drive it; its host and origin differ.
    fn is_ours(&self, request: &HttpRequest) -> bool {
        let hosts = [self.address.to_string(), format!("localhost:{}", self.address.port())];
        let is_host = |h: &str| hosts.iter().any(|mine| mine == h);
        let origin = request.header("Origin");
        request.header("Host").is_some_and(is_host)
            && origin.is_none_or(|o| o.strip_prefix("http://").is_some_and(is_host))
    }
}

impl HttpRequestHandler for PlanRequestHandler {
    fn check_head(&self, head: &HttpRequest) -> Result<(), HttpResponse> {
        match self.what(head) {
            Some(_) if self.is_ours(head) => Ok(()),
            _ => Err(HttpResponse::plain(403, "only the page of whoever started it may ask")),
        }
    }

    fn answer(&self, request: &HttpRequest) -> HttpResponse {
        const JSON: &str = "application/json";
        let what = self.what(request).unwrap_or_default();
        // If a thread panicked, no change is half done: each is one call.
        let mut editor = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        let (status, kind, body) = match (request.method.as_str(), what) {
            ("GET", "/") => (200, "text/html; charset=utf-8", PAGE.to_owned()),
            ("GET", "/plan") => (200, JSON, state(&editor).to_string()),
            ("POST", _) => match serde_json::from_slice(&request.body) {
                Err(_) => (400, "text/plain", "a JSON object was expected".to_owned()),
                Ok(asked) => match change(&mut editor, what, &asked) {
                    Ok(()) => (200, JSON, state(&editor).to_string()),
                    Err(why) => (400, "text/plain", why),
                },
            },
            _ => (404, "text/plain", "no such page".to_owned()),
        };
        self.done.fetch_or(status == 200 && what == "/done", Ordering::AcqRel);
        HttpResponse { status, kind, body }
    }
}

fn change(session: &mut ProbingPlanEditor, what: &str, asked: &Value) -> Result<(), String> {
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

fn save(session: &ProbingPlanEditor) -> std::io::Result<()> {
    std::fs::create_dir_all(&session.folder)?;
    for (name, text) in session.plan.files(&session.contour, session.unit) {
        rtec_files::atomic_write::write_atomically(&Path::new(&session.folder).join(name), text.as_bytes())?;
    }
    Ok(())
}

/// State of the page as JSON, for drawing.
fn state(session: &ProbingPlanEditor) -> Value {
    let pair = |p: Zx| [p.z, p.x];
    let pairs = |all: &[Zx]| all.iter().map(|&p| pair(p)).collect::<Vec<_>>();
    let ProbingPlanEditor { contour, plan, folder, .. } = session;
    let name = |feature: usize| &contour.features[feature].name;
    let chords = contour.chords();
    let lines = chords.iter().map(|(i, chords)| json!({"name": name(*i), "points": pairs(chords)}));
    let expected = plan.expected();
    let points = plan.points.iter().zip(&expected).map(|(p, &trip)| {
        json!({"at": pair(p.place.at), "feature": name(p.place.feature), "trip": pair(trip), "bypass": pairs(&p.bypass)})
    });
    let records = plan.records();
    let moves = records.iter().map(|r| json!({"role": r.role, "at": pair(r.at)}));
    json!({"contour": lines.collect::<Vec<_>>(), "points": points.collect::<Vec<_>>(),
           "moves": moves.collect::<Vec<_>>(), "hits": plan.hits(contour), "tip_mm": plan.probe.tip_mm, "folder": folder})
}
