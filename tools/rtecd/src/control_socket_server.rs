//! Serves the clients of the control sockets in one thread.
//! No client can hold up another one or the sign of life, and everything is bounded.
//!
//! | what | limit |
//! |---|---|
//! | connections | [`places`] for each role, and [`PER_USER`] of one user in each. Where all places of a role are taken, a user with fewer connections takes the place of the one with most |
//! | further ones, for urgent requests only | [`RESERVED`], and [`RESERVED_PER_USER`] of one user. A new one takes the place of that user's oldest |
//! | silence | a client that asks nothing, and a watcher that reads nothing, is dropped |
//! | order | `disable`, `park` and `hold`, then `status`, then the others, with the users in turn. A client's own requests keep their order |
//! | time | requests that are not urgent end their turn after [`TURN`], and all clients are checked again |

use crate::Outside;
use crate::audit_log_thread::{AnsweredCommand, AuditLogSender, Totals};
use crate::client_connection::{ClientConnection, ConnectionStage, RequestPriority};
use crate::control_side::{ControlSide, RequestContext, RequestOutcome};
use crate::listening_sockets::{ListeningSocket, ListeningSockets};
use crate::request_file_loader::Ticket;
use crate::service_manager::ServiceManager;
use crate::stderr_journal_log::{self, SyslogLevel};
use anyhow::Context;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::Signal;
use nix::sys::signalfd::SignalFd;
use nix::unistd::Uid;
use rtec_control::client_role::ClientRole;
use rtec_control::protocol::{ClientProcess, ClientRequest, DaemonResponse, RoleConnectionCounts};
use rtec_rt::link::ControlEnd;
use rtec_rt::link_messages::Fault;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

/// Connections of one user on the socket of one role.
const PER_USER: usize = 32;

/// Connections at one time on the socket of a role.
const fn places(role: ClientRole) -> usize {
    match role {
        ClientRole::View => 64,
        ClientRole::Operate | ClientRole::SetUp => 32,
    }
}

/// Further connections for urgent requests.
const RESERVED: usize = 32;
/// Of these, connections of one user.
const RESERVED_PER_USER: usize = 4;
/// Connections that are accepted in one turn.
const ACCEPTS: usize = 16;
/// Longest time of requests that are not urgent within one turn.
/// Then all clients are checked again.
const TURN: Duration = Duration::from_millis(8);
/// Longest wait for an insertion under way.
const BUSY: Duration = Duration::from_millis(500);
/// Longest time that counts for one turn of this loop.
const ONE_GAP: Duration = Duration::from_millis(25);
/// Time until an insertion under way is checked again, ms.
const BUSY_AGAIN: u8 = 2;

/// A load whose caller waits for the answer.
struct WaitingCaller {
    client: u64,
    caller: ClientProcess,
    request: Value,
    before: Totals,
}

/// References that serving needs.
struct ServingContext<'a> {
    session: &'a mut ControlSide,
    control: &'a mut ControlEnd,
    audit: &'a mut AuditLogSender,
    waiting: BTreeMap<Ticket, WaitingCaller>,
    own_uid: u32,
    /// Group of the socket of each role.
    groups: BTreeMap<ClientRole, String>,
    /// Last reported reason why the record of commands is not written.
    record: Option<String>,
}

/// Why serving ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ServingEnd {
    /// A signal asked for the end.
    Asked,
    /// A hangup, which is no request to end the service.
    HungUp,
    /// The real-time thread panicked.
    Panicked,
    /// The real-time thread has stopped looking at the card, but has not ended.
    StandsStill,
}

/// Serves until a signal comes, or the real-time thread is lost.
pub(crate) fn serve(
    outside: Outside<'_>,
    session: &mut ControlSide,
    control: &mut ControlEnd,
    audit: &mut AuditLogSender,
) -> anyhow::Result<ServingEnd> {
    let Outside { sockets, signals, manager, .. } = outside;
    let mut clients: Vec<ClientConnection> = Vec::new();
    let every = session.beat_every();
    let timeout = PollTimeout::try_from(every).unwrap_or(PollTimeout::from(10_u8));
    let own_uid = Uid::effective().as_raw();
    let groups = sockets.all.iter().filter_map(|d| Some((d.role, d.group.clone()?))).collect();
    let waiting = BTreeMap::new();
    let mut desk = ServingContext { session, control, audit, waiting, own_uid, groups, record: None };
    let (mut end_reported, mut next_id, mut turn, mut backlog) = (false, 1, 0, false);
    let mut watch = PollWatchdog::new(desk.session.stands_still_after(), Instant::now());
    loop {
        desk.beat(manager);
        let (polls, ended) = (desk.control.status().polls, desk.control.ended());
        if !ended && watch.stands_still(polls, Instant::now()) {
            return Ok(ServingEnd::StandsStill);
        }
        // Requests behind others, or behind their client's last one, are there already.
        let timeout = if backlog || clients.iter().any(ClientConnection::has_line) {
            PollTimeout::ZERO
        } else if clients.iter().any(|c| c.pending.is_some()) {
            BUSY_AGAIN.into()
        } else {
            timeout
        };
        let (signalled, ready) = wait(sockets, signals, &clients, timeout)?;
        if signalled && let Some(signal) = signals.read_signal().context("reading signals")? {
            manager.stopping();
            let text = format!("signal {}: parking", signal.ssi_signo);
            stderr_journal_log::say(SyslogLevel::Notice, &text);
            let totals = desk.session.totals(desk.control);
            desk.audit.note("stop", text, totals);
            let hung_up = signal.ssi_signo == Signal::SIGHUP as u32;
            return Ok(if hung_up { ServingEnd::HungUp } else { ServingEnd::Asked });
        }
        for (client, ready) in clients.iter_mut().zip(&ready[sockets.all.len()..]) {
            if client.reads() && ready.intersects(PollFlags::POLLIN | PollFlags::POLLHUP) {
                client.read();
            } else if ready.contains(PollFlags::POLLERR) || client.waits && ready.contains(PollFlags::POLLHUP)
            {
                // A client that has only closed its writing side still reads its answer.
                client.enter(ConnectionStage::Gone);
            }
        }
        for (socket, ready) in sockets.all.iter().zip(&ready) {
            if ready.contains(PollFlags::POLLIN) {
                accept(socket, &mut clients, &mut next_id);
            }
        }
        turn += 1;
        backlog = desk.work(&mut clients, turn);
        desk.finish_loads(&mut clients);
        desk.session.drain(desk.control);
        desk.session.tick(desk.control);
        desk.audit.turn();
        if desk.control.ended() && !end_reported {
            end_reported = true;
            let text = "the real-time thread has ended; corrections are frozen, status is still served";
            stderr_journal_log::say(SyslogLevel::Error, text);
        }
        desk.watch_record();
        for happened in desk.session.take_happened() {
            let totals = desk.session.totals(desk.control);
            desk.audit.happened(&happened, totals);
            for client in clients.iter_mut().filter(|c| c.watching) {
                client.put(&DaemonResponse::Event(Box::new(happened.clone())));
            }
        }
        clients.iter_mut().for_each(ClientConnection::write);
        clients.retain(|c| !c.must_close());
        if ended && desk.control.status().faults.has(Fault::ThreadLost) {
            return Ok(ServingEnd::Panicked);
        }
    }
}

/// Checks that the real-time thread looks at the card.
/// A standstill of this thread itself, as when the process was stopped, does not count.
struct PollWatchdog {
    polls: u64,
    looked: Instant,
    still: Duration,
    limit: Duration,
}

impl PollWatchdog {
    fn new(limit: Duration, now: Instant) -> Self {
        Self { polls: 0, looked: now, still: Duration::ZERO, limit }
    }

    /// Whether the thread stands still, given `polls` looks at the card so far.
    fn stands_still(&mut self, polls: u64, now: Instant) -> bool {
        let gap = now.duration_since(std::mem::replace(&mut self.looked, now));
        if std::mem::replace(&mut self.polls, polls) == polls {
            self.still += gap.min(ONE_GAP);
        } else {
            self.still = Duration::ZERO;
        }
        self.still > self.limit
    }
}

/// Waits for requests; returns what is ready, listening sockets before clients.
fn wait(
    sockets: &ListeningSockets,
    signals: &SignalFd,
    clients: &[ClientConnection],
    timeout: PollTimeout,
) -> anyhow::Result<(bool, Vec<PollFlags>)> {
    let mut fds = vec![PollFd::new(signals.as_fd(), PollFlags::POLLIN)];
    fds.extend(sockets.all.iter().map(|d| PollFd::new(d.listener.as_fd(), PollFlags::POLLIN)));
    fds.extend(clients.iter().map(|c| {
        let mut flags = PollFlags::empty();
        flags.set(PollFlags::POLLIN, c.reads());
        flags.set(PollFlags::POLLOUT, c.unsent());
        PollFd::new(c.stream.as_fd(), flags)
    }));
    match poll(&mut fds, timeout) {
        Ok(_) | Err(nix::errno::Errno::EINTR) => {}
        Err(error) => return Err(error).context("poll"),
    }
    let flags = |fd: &PollFd<'_>| fd.revents().unwrap_or(PollFlags::empty());
    Ok((flags(&fds[0]).contains(PollFlags::POLLIN), fds[1..].iter().map(flags).collect()))
}

impl ServingContext<'_> {
    fn beat(&mut self, manager: &mut ServiceManager) {
        self.control.beat();
        let status = self.control.status();
        manager.turn(status.polls, || self.session.in_short(&status));
    }

    /// Answers at most one request of each client, urgent ones first.
    /// Returns whether some were left.
    fn work(&mut self, clients: &mut [ClientConnection], turn: usize) -> bool {
        clients.iter_mut().for_each(ClientConnection::take_up);
        let count = clients.len().max(1);
        // Users in turn: a client waits behind all earlier clients of its own user, and behind one of each other user.
        let mut of_user: BTreeMap<u32, usize> = BTreeMap::new();
        let mut order = Vec::new();
        for k in 0..clients.len() {
            let n = (k + turn) % count;
            let Some(pending) = &clients[n].pending else { continue };
            let rank = of_user.entry(clients[n].caller.uid).or_default();
            order.push((pending.urgency(), *rank, n));
            *rank += 1;
        }
        order.sort_by_key(|(urgency, rank, _)| (*urgency, *rank));
        let begun = Instant::now();
        for (urgency, _, n) in order {
            if urgency == RequestPriority::Turn && begun.elapsed() > TURN {
                return true;
            }
            self.answer_pending(clients, n);
        }
        false
    }

    fn answer_pending(&mut self, clients: &mut [ClientConnection], n: usize) {
        let Some(pending) = clients[n].pending.take() else { return };
        let (since, urgency) = (pending.since, pending.urgency());
        let request = match pending.request {
            Ok(request) => request,
            Err(text) => return clients[n].put(&DaemonResponse::Bad { text }),
        };
        let client = &mut clients[n];
        let with_files = matches!(
            request,
            ClientRequest::ModelLoad { .. } | ClientRequest::TableLoad(_) | ClientRequest::Keep { .. }
        );
        let files = if with_files { client.take_files() } else { Vec::new() };
        if let Some(refusal) = not_here(client, &request, urgency, &self.groups) {
            let (before, after) = (Totals::new(), Totals::new());
            self.record(&client.caller, json(&request), &refusal, None, before, after);
            if client.reserved {
                client.enter(ConnectionStage::Closing);
            }
            return client.put(&refusal);
        }
        let recorded = request.needs() > ClientRole::View;
        let before = if recorded { self.session.totals(self.control) } else { Totals::new() };
        let trusted = client.caller.uid == 0 || client.caller.uid == self.own_uid;
        let beside = RequestContext { files, trusted, user: (client.caller.uid, client.caller.user.clone()) };
        let latched = self.session.latched(&self.control.status());
        let mut response = match &request {
            ClientRequest::Whoami {} => {
                let may = client.role.may().into_iter().map(str::to_owned).collect();
                DaemonResponse::Whoami(Box::new(ClientProcess { may, ..client.caller.clone() }))
            }
            ClientRequest::Observe { events_after } => {
                let connected = connected(clients);
                self.session.observed(*events_after, self.audit.state(), connected, self.control)
            }
            request => match self.session.answer(request, beside, self.control) {
                RequestOutcome::Again(_) if since.elapsed() < BUSY => {
                    client.pending = Some(crate::client_connection::PendingRequest {
                        request: Ok(request.clone()),
                        since,
                    });
                    return;
                }
                RequestOutcome::Now(response) | RequestOutcome::Again(response) => response,
                RequestOutcome::Later(ticket) => {
                    client.waits = true;
                    let (caller, request) = (client.caller.clone(), json(request));
                    let waiting = WaitingCaller { client: client.id, caller, request, before };
                    self.waiting.insert(ticket, waiting);
                    return;
                }
            },
        };
        let client = &mut clients[n];
        client.watching |= request == ClientRequest::Watch {};
        if let DaemonResponse::Status(status) = &mut response {
            status.record_trouble.clone_from(&self.record);
        }
        if recorded {
            let after = self.session.totals(self.control);
            let released = matches!(request, ClientRequest::Clear {}).then(|| released(&latched));
            self.record(&client.caller, json(&request), &response, released.as_deref(), before, after);
        }
        client.put(&response);
    }

    /// Reports when the writing of the record of commands fails, and when it resumes.
    fn watch_record(&mut self) {
        let state = self.audit.state();
        let (file, trouble) = (&state.file, &state.trouble);
        if trouble.is_some() != self.record.is_some() {
            let now = trouble.as_ref().map(|why| format!("not written: {why}; corrections go on"));
            let now = now.unwrap_or_else(|| "written again".to_owned());
            stderr_journal_log::event(
                SyslogLevel::Warning,
                "record",
                &format!("the record of commands {file} is {now}"),
            );
        }
        self.record = state.in_words();
        if self.audit.has_moved() {
            let text = format!(
                "a file of the record of commands {file} was removed or renamed by others: another one was begun; `rtecctl log \
                 --verify` shows what is missing"
            );
            stderr_journal_log::event(SyslogLevel::Warning, "record", &text);
        }
        if self.session.anchors_record()
            && let Some(text) = self.audit.anchor()
        {
            stderr_journal_log::record(SyslogLevel::Notice, "record_anchor", &text, &[]);
        }
    }

    /// Answers the clients whose files have been read.
    fn finish_loads(&mut self, clients: &mut [ClientConnection]) {
        let waiting = &self.waiting;
        let waits = |ticket: Ticket| {
            waiting.get(&ticket).is_some_and(|w| clients.iter().any(|c| c.id == w.client && !c.gone()))
        };
        let done = self.session.loaded(waits, self.control);
        let Some((ticket, response, words)) = done else {
            if !self.session.loads() {
                // The client has gone.
                self.waiting.clear();
            }
            return;
        };
        let Some(WaitingCaller { client, caller, request, before }) = self.waiting.remove(&ticket) else {
            return;
        };
        let after = self.session.totals(self.control);
        self.record(&caller, request, &response, words.as_deref(), before, after);
        if let Some(client) = clients.iter_mut().find(|c| c.id == client) {
            client.waits = false;
            client.put(&response);
        }
    }

    /// Records a command and its answer; `words` replaces the answer's text.
    fn record(
        &mut self,
        by: &ClientProcess,
        request: Value,
        response: &DaemonResponse,
        words: Option<&str>,
        before: Totals,
        after: Totals,
    ) {
        let (result, text) = match response {
            DaemonResponse::Refused { text, .. } => ("refused", text.as_str()),
            DaemonResponse::Fault { text } => ("fault", text.as_str()),
            DaemonResponse::Bad { text } => ("bad", text.as_str()),
            DaemonResponse::ModelPreview(_) => ("done", "shown only, nothing was loaded"),
            _ => ("done", ""),
        };
        let text = words.unwrap_or(text).to_owned();
        let model = self.session.model_hash();
        self.audit.command(AnsweredCommand { by: by.clone(), request, result, text, before, after, model });
    }
}

/// The faults that `clear` released, for the record.
fn released(latched: &[(Option<String>, String)]) -> String {
    let of = |(axis, fault): &(Option<String>, String)| match axis {
        Some(axis) => format!("axis {axis}: {fault}"),
        None => fault.clone(),
    };
    match latched {
        [] => "nothing was latched".to_owned(),
        all => format!("latched before: {}", all.iter().map(of).collect::<Vec<_>>().join(", ")),
    }
}

fn json(request: &ClientRequest) -> Value {
    serde_json::to_value(request).unwrap_or_default()
}

fn connected(clients: &[ClientConnection]) -> Vec<RoleConnectionCounts> {
    let of = |role: ClientRole| clients.iter().filter(move |c| c.role == role);
    let count = |role| {
        let (connected, watching) = (of(role).count(), of(role).filter(|c| c.watching).count());
        RoleConnectionCounts { role, connected, watching }
    };
    ClientRole::ALL.map(count).to_vec()
}

/// Refusal of a request because of the client's role or place, if any.
fn not_here(
    client: &ClientConnection,
    request: &ClientRequest,
    urgency: RequestPriority,
    groups: &BTreeMap<ClientRole, String>,
) -> Option<DaemonResponse> {
    let needed = request.needs();
    if needed > client.role {
        let (is, user) = (client.role, &client.caller.user);
        let who = match groups.get(&needed) {
            Some(group) => format!("the users of group {group} may: user {user} is to be put into it"),
            None => "no group may ([control] of the configuration), only the daemon's own user".to_owned(),
        };
        let text =
            format!("this connection may \"{is}\", and this takes \"{needed}\": {who} (`rtecctl whoami`)");
        return Some(DaemonResponse::refused("role", text));
    }
    if client.reserved && urgency == RequestPriority::Turn {
        let text = format!(
            "{PER_USER} clients of one user, or {} in all, may \"{}\" at a time and are connected already: disable, hold, \
             status and whoami are served, everything else when one of them has gone",
            places(client.role),
            client.role
        );
        return Some(DaemonResponse::refused("too_many_clients", text));
    }
    None
}

fn accept(socket: &ListeningSocket, clients: &mut Vec<ClientConnection>, next_id: &mut u64) {
    for _ in 0..ACCEPTS {
        let stream = match socket.listener.accept() {
            Ok((stream, _)) => stream,
            Err(e) if matches!(e.kind(), ErrorKind::Interrupted | ErrorKind::ConnectionAborted) => continue,
            Err(e) if e.kind() == ErrorKind::WouldBlock => return,
            Err(error) => {
                // Out of descriptors. The socket stays ready, so it waits here to give the others time.
                stderr_journal_log::event(
                    SyslogLevel::Warning,
                    "accept",
                    &format!("a client was not served: {error}"),
                );
                std::thread::sleep(Duration::from_millis(5));
                return;
            }
        };
        let set = stream.set_nonblocking(true).map_err(anyhow::Error::from);
        match set.and_then(|()| Ok(ClientConnection::new(*next_id, stream, socket.role, &socket.path)?)) {
            Ok(client) => {
                *next_id += 1;
                admit_client(client, clients);
            }
            Err(error) => stderr_journal_log::event(
                SyslogLevel::Warning,
                "accept",
                &format!("a client was not served: {error}"),
            ),
        }
    }
}

/// Gives a new client a place, or a reserved one where no other is free.
fn admit_client(mut client: ClientConnection, clients: &mut Vec<ClientConnection>) {
    let (uid, role) = (client.caller.uid, client.role);
    let ordinary = |c: &ClientConnection| !c.reserved && c.role == role;
    let count = |clients: &[ClientConnection], kind: &dyn Fn(&ClientConnection) -> bool| {
        clients.iter().filter(|c| kind(c)).count()
    };
    let own = count(clients, &|c| ordinary(c) && c.caller.uid == uid);
    let all = count(clients, &ordinary);
    if own >= PER_USER || all >= places(role) && !give_way(clients, own + 2, &ordinary) {
        client.reserved = true;
        let reserved = |c: &ClientConnection| c.reserved;
        let of_user = |c: &ClientConnection| c.reserved && c.caller.uid == uid;
        if count(clients, &of_user) >= RESERVED_PER_USER {
            give_way(clients, 0, &of_user);
        } else if count(clients, &reserved) >= RESERVED {
            give_way(clients, 0, &reserved);
        }
    }
    clients.push(client);
}

/// Frees a place of one kind.
/// The user with most places (at least `least`) loses the client that has been silent longest.
fn give_way(
    clients: &mut Vec<ClientConnection>,
    least: usize,
    kind: &dyn Fn(&ClientConnection) -> bool,
) -> bool {
    let of_user = |uid: u32| clients.iter().filter(|c| kind(c) && c.caller.uid == uid).count();
    let crowd = clients.iter().filter(|c| kind(c)).map(|c| c.caller.uid).max_by_key(|uid| of_user(*uid));
    let Some(crowd) = crowd.filter(|uid| of_user(*uid) >= least) else { return false };
    let of_crowd = clients.iter().enumerate().filter(|(_, c)| kind(c) && c.caller.uid == crowd);
    let Some((n, _)) = of_crowd.min_by_key(|(_, c)| c.silent_since()) else { return false };
    clients.remove(n);
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixStream;

    /// A stalled thread is found within 0.2 s.
    /// A process that was itself stopped, or a slow thread, is not reported.
    #[test]
    fn a_thread_that_stands_still_is_found_and_a_stopped_process_is_not() {
        let begun = Instant::now();
        let at = |ms: u64| begun + Duration::from_millis(ms);
        let mut watch = PollWatchdog::new(crate::control_side::STANDS_STILL, begun);
        assert!((1..50).all(|n| !watch.stands_still(n, at(n * 10))));
        let found = (1..100).find(|n| watch.stands_still(49, at(490 + n * 10)));
        assert!(found.is_some_and(|n| n * 10 <= 200), "{found:?}");
        // Stopped once for a minute. The thread may have been stopped too.
        let mut watch = PollWatchdog::new(crate::control_side::STANDS_STILL, begun);
        assert!(!watch.stands_still(7, at(10)));
        assert!(!watch.stands_still(7, at(60_000)));
        assert!(!watch.stands_still(8, at(60_010)));
    }

    fn client(id: u64, uid: u32, role: ClientRole) -> ClientConnection {
        let (stream, _) = UnixStream::pair().unwrap();
        let mut client = ClientConnection::new(id, stream, role, std::path::Path::new("s")).unwrap();
        client.caller.uid = uid;
        client
    }

    fn seated(clients: &[ClientConnection], uid: u32, role: ClientRole) -> usize {
        clients.iter().filter(|c| !c.reserved && c.caller.uid == uid && c.role == role).count()
    }

    #[test]
    fn no_user_takes_the_places_of_others() {
        let (mut clients, mut id) = (Vec::new(), 0);
        let mut come = |clients: &mut Vec<ClientConnection>, uid, role, n| {
            for _ in 0..n {
                id += 1;
                admit_client(client(id, uid, role), clients);
            }
        };
        // Two viewers with all their places. Operators and users who set up still have theirs.
        come(&mut clients, 1, ClientRole::View, 100);
        come(&mut clients, 2, ClientRole::View, 100);
        assert_eq!((seated(&clients, 1, ClientRole::View), seated(&clients, 2, ClientRole::View)), (32, 32));
        come(&mut clients, 3, ClientRole::Operate, 1);
        come(&mut clients, 4, ClientRole::SetUp, 1);
        assert_eq!(
            (seated(&clients, 3, ClientRole::Operate), seated(&clients, 4, ClientRole::SetUp)),
            (1, 1)
        );
        // Other viewers get places too: the user with most loses one, until all have the same.
        for uid in 5..9 {
            come(&mut clients, uid, ClientRole::View, 20);
        }
        let each: Vec<usize> = [1, 2, 5, 6, 7, 8].map(|uid| seated(&clients, uid, ClientRole::View)).to_vec();
        assert_eq!(each.iter().sum::<usize>(), places(ClientRole::View));
        assert!(each.iter().all(|n| (10..=12).contains(n)), "{each:?}");
        // A user's own role is bounded by itself, and urgent requests have their places.
        come(&mut clients, 3, ClientRole::Operate, 100);
        assert_eq!(seated(&clients, 3, ClientRole::Operate), PER_USER);
        assert!(clients.iter().filter(|c| c.reserved).count() <= RESERVED);
        assert!(clients.iter().filter(|c| c.reserved && c.caller.uid == 3).count() == RESERVED_PER_USER);
    }

    #[test]
    fn the_client_that_is_silent_longest_gives_way() {
        let mut clients: Vec<ClientConnection> = Vec::new();
        for id in 0..u64::try_from(places(ClientRole::View)).unwrap() {
            admit_client(client(id, u32::try_from(id % 2).unwrap(), ClientRole::View), &mut clients);
        }
        admit_client(client(1000, 9, ClientRole::View), &mut clients);
        let ids: Vec<u64> = clients.iter().map(|c| c.id).collect();
        assert_eq!((ids.len(), ids.contains(&1000)), (places(ClientRole::View), true));
        assert!(!ids.contains(&0) || !ids.contains(&1), "{ids:?}");
    }
}
