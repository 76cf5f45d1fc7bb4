//! The controller's log, in a thread of its own: a log that is slow or blocked must never hold the controller up.
//!
//! Reports go through a bounded queue and are dropped when it is full. One line a second for each reason; what was left
//! out is counted in the next line.

use crate::safety::{GateState, Reason, Transition};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Reports that may wait.
const QUEUE: usize = 64;
/// Shortest time between two lines for one reason.
const PAUSE: Duration = Duration::from_secs(1);
/// Longest wait for a blocked log at the end.
const FINISH_LIMIT: Duration = Duration::from_millis(100);

/// Something to be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Report {
    Transition(Transition<GateState>),
    RequestRefused(Reason),
    CommandRefused(Reason),
    SendingFails,
    Ended,
}

/// The controller's end of the queue.
pub(super) struct Reporter {
    queue: SyncSender<Report>,
    done: Receiver<()>,
    _thread: Option<JoinHandle<()>>,
}

impl Reporter {
    /// Starts the thread, whose first line is `greeting`. Without one the controller works on, in silence.
    pub(super) fn start(greeting: String) -> Self {
        let (queue, reports) = sync_channel(QUEUE);
        let (finished, done) = sync_channel(1);
        let thread = std::thread::Builder::new().name("reporter".to_owned()).spawn(move || {
            log::info!("{greeting}");
            tell(&reports);
            let _ = finished.send(());
        });
        Self { queue, done, _thread: thread.ok() }
    }

    /// Hands a report over, or drops it; never waits.
    pub(super) fn report(&self, report: Report) {
        let _ = self.queue.try_send(report);
    }

    /// Lets the thread tell what waits, for a moment.
    pub(super) fn finish(self) {
        drop(self.queue);
        let _ = self.done.recv_timeout(FINISH_LIMIT);
    }
}

/// When a reason was last told, and how often it was left out since.
struct Told {
    report: Report,
    at: Instant,
    left_out: u32,
}

impl Told {
    fn line(&self) -> String {
        let line = sentence(self.report);
        if self.left_out > 0 { format!("{line} ({} times more)", self.left_out) } else { line }
    }
}

fn tell(reports: &Receiver<Report>) {
    let mut told: Vec<Told> = Vec::new();
    loop {
        match reports.recv_timeout(PAUSE) {
            Ok(report) => tell_one(&mut told, report),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        told.iter_mut().filter(|told| told.left_out > 0 && told.at.elapsed() >= PAUSE).for_each(|told| {
            log::warn!("{}", told.line());
            (told.at, told.left_out) = (Instant::now(), 0);
        });
    }
    told.iter().filter(|told| told.left_out > 0).for_each(|told| log::warn!("{}", told.line()));
}

fn tell_one(told: &mut Vec<Told>, report: Report) {
    match told.iter_mut().find(|told| told.report == report) {
        Some(told) if told.at.elapsed() < PAUSE => told.left_out += 1,
        Some(told) => {
            log::warn!("{}", told.line());
            (told.at, told.left_out) = (Instant::now(), 0);
        }
        None => {
            log::warn!("{}", sentence(report));
            told.push(Told { report, at: Instant::now(), left_out: 0 });
        }
    }
}

fn sentence(report: Report) -> String {
    match report {
        Report::Transition(Transition { from, to, reason }) => format!("controller {from} -> {to}: {reason}"),
        Report::RequestRefused(reason) => format!("operator request refused: {reason}"),
        Report::CommandRefused(reason) => format!("command refused: {reason}"),
        Report::SendingFails => "cannot publish; the platform's own watchdog has to stop it".to_owned(),
        Report::Ended => "controller ends: the platform was told to stand still".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_queue_is_dropped_and_never_waits() {
        let (queue, _reports) = sync_channel(1);
        let (_finished, done) = sync_channel(1);
        let reporter = Reporter { queue, done, _thread: None };
        let began = Instant::now();
        for _ in 0..10_000 {
            reporter.report(Report::SendingFails);
        }
        reporter.finish();
        assert!(began.elapsed() < Duration::from_secs(1), "{:?}", began.elapsed());
    }

    #[test]
    fn one_reason_is_told_once_a_second_and_what_was_left_out_is_counted() {
        let mut told = Vec::new();
        for _ in 0..100 {
            tell_one(&mut told, Report::CommandRefused(Reason::BadChecksum));
        }
        tell_one(&mut told, Report::CommandRefused(Reason::BadSchema));
        assert_eq!(told.len(), 2);
        assert_eq!(told[0].left_out, 99);
        assert_eq!(told[0].line(), "command refused: bad_checksum (99 times more)");
        assert_eq!(told[1].left_out, 0);
    }
}
