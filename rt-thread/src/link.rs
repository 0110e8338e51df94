//! The link between the control side and the real-time thread.
//! Requests go down one ring, events up another, and the status is in a snapshot.
//!
//! Neither side ever waits for the other. What cannot be sent is handed back.

#[cfg(loom)]
use loom::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering},
};
#[cfg(not(loom))]
use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use crate::link_messages::{CorrectorStatus, Event, RequestToRt};
use crate::triple_buffer::{SnapshotReader, SnapshotWriter, snapshot};
use crossbeam_utils::CachePadded;
use ringbuf::traits::{Consumer, Observer, Producer, Split};
use ringbuf::{HeapCons, HeapProd, HeapRb};

/// Largest number of requests on their way.
pub const REQUESTS: usize = 256;
/// Largest number of events on their way.
pub const EVENTS: usize = 4096;

/// The words that both sides see, each on a cache line of its own.
#[derive(Debug)]
struct AliveAndStopFlags {
    /// Counter that rises while the control side is alive.
    /// Written by the control side, read by the real-time thread.
    beats: CachePadded<AtomicU64>,
    /// Asks the real-time thread to end.
    /// Written by the control side, read by the real-time thread.
    stop: CachePadded<AtomicBool>,
    /// The real-time thread has ended.
    /// Written by the real-time thread, read by the control side.
    ended: CachePadded<AtomicBool>,
}

/// The control side's end of the link.
/// It is `Send` and not `Clone`: one thread at a time is the control side.
pub struct ControlEnd {
    requests: HeapProd<RequestToRt>,
    events: HeapCons<Event>,
    status: SnapshotReader<CorrectorStatus>,
    shared: Arc<AliveAndStopFlags>,
}

/// The real-time thread's end of the link.
pub struct RtEnd {
    requests: HeapCons<RequestToRt>,
    events: HeapProd<Event>,
    status: SnapshotWriter<CorrectorStatus>,
    shared: Arc<AliveAndStopFlags>,
}

impl std::fmt::Debug for ControlEnd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ControlEnd").finish_non_exhaustive()
    }
}

impl std::fmt::Debug for RtEnd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RtEnd").finish_non_exhaustive()
    }
}

/// The request ring is full; the request is handed back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the request ring is full ({REQUESTS} requests): the real-time thread is not taking them")]
pub struct RequestRingFull(pub RequestToRt);

/// A new link whose first status is `status`.
pub fn link(status: CorrectorStatus) -> (ControlEnd, RtEnd) {
    let (request_in, request_out) = HeapRb::new(REQUESTS).split();
    let (event_in, event_out) = HeapRb::new(EVENTS).split();
    let (writer, reader) = snapshot(status);
    let shared = Arc::new(AliveAndStopFlags {
        beats: CachePadded::new(AtomicU64::new(0)),
        stop: CachePadded::new(AtomicBool::new(false)),
        ended: CachePadded::new(AtomicBool::new(false)),
    });
    (
        ControlEnd { requests: request_in, events: event_out, status: reader, shared: Arc::clone(&shared) },
        RtEnd { requests: request_out, events: event_in, status: writer, shared },
    )
}

impl ControlEnd {
    /// Sends a request.
    ///
    /// # Errors
    /// Hands the request back when the ring is full.
    pub fn send(&mut self, request: RequestToRt) -> Result<(), RequestRingFull> {
        self.requests.try_push(request).map_err(RequestRingFull)
    }

    /// Number of requests that the real-time thread has not taken yet.
    pub fn pending(&self) -> usize {
        self.requests.occupied_len()
    }

    /// The next event, oldest first.
    pub fn event(&mut self) -> Option<Event> {
        self.events.try_pop()
    }

    /// The latest status.
    pub fn status(&mut self) -> CorrectorStatus {
        self.status.read()
    }

    /// Gives a sign of life. Without one, new insertions cease after the stale time.
    pub fn beat(&mut self) {
        // Only this side writes it, so no read-modify-write is needed.
        self.shared.beats.store(self.shared.beats.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
    }

    /// Asks the real-time thread to end.
    /// Corrections freeze, and inverters stay as they are.
    pub fn stop(&self) {
        self.shared.stop.store(true, Ordering::Release);
    }

    /// Whether the real-time thread has ended.
    /// The last status and all events can then be read.
    pub fn ended(&self) -> bool {
        self.shared.ended.load(Ordering::Acquire)
    }
}

impl RtEnd {
    /// The next request.
    #[inline]
    pub fn request(&mut self) -> Option<RequestToRt> {
        self.requests.try_pop()
    }

    /// Whether no request is on its way.
    #[inline]
    pub fn all_taken(&self) -> bool {
        self.requests.is_empty()
    }

    /// Sends an event up; `false` when the ring is full.
    #[inline]
    pub fn report(&mut self, event: Event) -> bool {
        self.events.try_push(event).is_ok()
    }

    /// Makes `status` the latest.
    #[inline]
    pub fn publish(&mut self, status: CorrectorStatus) {
        self.status.write(status);
    }

    /// A number that rises while the control side is alive.
    #[inline]
    pub fn beats(&self) -> u64 {
        self.shared.beats.load(Ordering::Relaxed)
    }

    /// Whether the control side has asked for the end.
    #[inline]
    pub fn stopped(&self) -> bool {
        self.shared.stop.load(Ordering::Acquire)
    }

    /// Marks the end: the last status and all events are in the link.
    pub fn end(&self) {
        self.shared.ended.store(true, Ordering::Release);
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    #[test]
    fn a_full_ring_hands_the_request_back() {
        let (mut control, mut rt) = link(CorrectorStatus::default());
        for _ in 0..REQUESTS {
            control.send(RequestToRt::Enable).unwrap();
        }
        assert_eq!(control.send(RequestToRt::Disable), Err(RequestRingFull(RequestToRt::Disable)));
        assert_eq!(rt.request(), Some(RequestToRt::Enable));
        control.send(RequestToRt::Disable).unwrap();
    }

    #[test]
    fn what_one_end_says_the_other_finds() {
        let (mut control, mut rt) = link(CorrectorStatus { t_ns: 5, ..CorrectorStatus::default() });
        assert_eq!((control.status().t_ns, control.pending(), rt.all_taken()), (5, 0, true));
        control.send(RequestToRt::Enable).unwrap();
        control.send(RequestToRt::Clear).unwrap();
        assert_eq!((control.pending(), rt.all_taken()), (2, false));
        assert_eq!((rt.request(), control.pending()), (Some(RequestToRt::Enable), 1));
        let before = rt.beats();
        for n in 1..=3 {
            control.beat();
            assert_eq!(rt.beats(), before + n);
        }
        rt.publish(CorrectorStatus { t_ns: 7, ..CorrectorStatus::default() });
        assert_eq!((control.status().t_ns, control.ended(), rt.stopped()), (7, false, false));
        control.stop();
        rt.end();
        assert!(control.ended() && rt.stopped());
        assert_eq!(format!("{control:?} {rt:?}"), "ControlEnd { .. } RtEnd { .. }");
    }

    #[test]
    fn events_beyond_the_ring_are_refused_not_overwritten() {
        use crate::link_messages::EventKind;
        let (mut control, mut rt) = link(CorrectorStatus::default());
        let event = |t_ns| Event { t_ns, axis: None, kind: EventKind::Bounce };
        let kept = (0..5000).filter(|t| rt.report(event(*t))).count();
        assert_eq!(kept, EVENTS);
        assert_eq!(control.event().map(|e| e.t_ns), Some(0));
    }
}

#[cfg(all(test, loom))]
mod tests {
    use super::*;

    /// A status published before the end flag is visible when the flag is.
    #[test]
    fn the_last_status_is_there_when_the_end_is_seen() {
        loom::model(|| {
            let (mut control, mut rt) = link(CorrectorStatus::default());
            control.beat();
            let thread = loom::thread::spawn(move || {
                assert_eq!(rt.beats(), 1);
                rt.publish(CorrectorStatus { t_ns: 7, ..CorrectorStatus::default() });
                rt.end();
                rt.stopped()
            });
            control.stop();
            if control.ended() {
                assert_eq!(control.status().t_ns, 7);
            }
            thread.join().unwrap();
            assert!(control.ended());
            assert_eq!(control.status().t_ns, 7);
        });
    }
}
