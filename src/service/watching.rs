//! The watching thread: it waits for the end, tells zero when the end begins, and ends the process when a thread hangs or dies.
//!
//! In: what the two working threads did ([`Heartbeat`], [`Progress`]), the wish to end. Out: the daemon's last word, what the service
//! manager is told (only that ping sets were processed, never that time passed), how it ended. It never waits for anybody.

use super::acquisition::{self, Delivered, Heartbeat};
use super::decision::{DecisionLoop, Ended};
use super::{ServiceError, handoff};
use crate::io::LastWord;
use crate::io::source::{Source, SourceError};
use crate::io::wire::message::VelocityCommand;
use crate::life::panic::is_dying;
use crate::life::{Notifier, Stop};
use crate::signal::{DaemonState, Reason};
use crate::time::{Clock, Stamp, SystemClock};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A thread that gives no beat for this long hangs: within two seconds the process is gone.
const HANG_LIMIT: Duration = Duration::from_millis(1_800);
/// Longest start of a source or backend before the beats are counted.
const START_LIMIT: Duration = Duration::from_secs(10);
/// Pause between two looks: part of the 50 ms from a signal to zero.
const LOOK_PAUSE: Duration = Duration::from_millis(5);
/// Time for an orderly end; after it another signal ends the process on the spot.
const ORDERLY_END: Duration = Duration::from_millis(300);
/// After so long the process ends with what is done. All of it must be over within a second of the signal.
const END_LIMIT: Duration = Duration::from_millis(700);

/// What the deciding thread has done, for whoever watches it.
#[derive(Debug, Default)]
pub struct Progress {
    beats: Heartbeat,
    ping_sets: AtomicU64,
    last_emitted_ns: AtomicU64,
    state: AtomicU32,
    reason: AtomicU32,
}

impl Progress {
    /// A ping set, emitted then, was processed.
    pub fn processed(&self, emitted_at: Stamp) {
        self.last_emitted_ns.store(emitted_at.boottime_ns, Ordering::Relaxed);
        self.ping_sets.fetch_add(1, Ordering::Relaxed);
    }

    /// The thread is alive, in this state.
    pub fn beat(&self, state: DaemonState, reason: Reason) {
        self.state.store(state.number(), Ordering::Relaxed);
        self.reason.store(reason.number(), Ordering::Relaxed);
        self.beats.beat();
    }

    fn condition(&self) -> (Option<DaemonState>, Option<Reason>) {
        let state = DaemonState::from_number(self.state.load(Ordering::Relaxed));
        (state, Reason::from_number(self.reason.load(Ordering::Relaxed)))
    }
}

/// What the watching thread watches.
struct Watch {
    progress: Arc<Progress>,
    last_word: LastWord,
    notifier: Notifier,
    told_sets: u64,
    told: Option<(DaemonState, Reason)>,
    ready: bool,
    ending_since: Option<Instant>,
}

impl Watch {
    /// Tells the service manager what is new.
    fn tell_manager(&mut self) {
        let sets = self.progress.ping_sets.load(Ordering::Relaxed);
        if sets != self.told_sets {
            self.told_sets = sets;
            self.notifier.processed();
        }
        let (Some(state), Some(reason)) = self.progress.condition() else { return };
        // The self-test is over, however it went: from now on the watchdog counts.
        if !self.ready && sets > 0 && !matches!(state, DaemonState::Boot | DaemonState::SelfTest) {
            self.ready = true;
            self.notifier.ready();
        }
        if self.told != Some((state, reason)) {
            self.told = Some((state, reason));
            self.notifier.status(&format!("{state}: {reason}"));
        }
    }

    /// Zero, from this thread, whatever the deciding one is doing.
    fn say_zero(&self, state: DaemonState, reason: Reason) {
        let captured = Stamp { boottime_ns: self.progress.last_emitted_ns.load(Ordering::Relaxed), wall_ns: 0 };
        if let Err(error) = self.last_word.say(VelocityCommand::standstill(captured, state, reason), SystemClock.now())
        {
            log::error!("{error}");
        }
    }

    /// Begins and paces the end. The first word of it is zero, unless the deciding thread is done and said so itself.
    fn end(&mut self, stop: &Stop, decided: bool) -> Result<(), ServiceError> {
        let Some(since) = self.ending_since else {
            match is_dying() {
                _ if decided => {}
                true => self.say_zero(DaemonState::Fault, Reason::InternalError),
                false => self.say_zero(DaemonState::Shutdown, Reason::Terminated),
            }
            self.notifier.stopping();
            self.ending_since = Some(Instant::now());
            return Ok(());
        };
        if since.elapsed() > ORDERLY_END {
            stop.allow_abrupt(true);
        }
        if since.elapsed() > END_LIMIT {
            return Err(ServiceError::Internal("a thread does not end: the process ends without it".to_owned()));
        }
        Ok(())
    }
}

type Decided = (Ended, String, String);

/// Starts the two working threads and watches them from this one.
pub(super) fn supervise(
    decision: DecisionLoop,
    source: Box<dyn Source + Send>,
    empty: Delivered,
    limit: Option<Duration>,
    stop: &Stop,
) -> Result<(), ServiceError> {
    let internal = |what: std::io::Error| ServiceError::Internal(format!("no thread: {what}"));
    let last_word = decision.topics.last_word();
    let (giver, taker) = handoff::handoff(empty.clone());
    let beat = Arc::new(Heartbeat::default());
    let flag = Arc::clone(stop.flag());
    let acquirer = acquisition::start(source, giver, empty.clone(), flag, Arc::clone(&beat)).map_err(internal)?;
    let progress = Arc::new(Progress::default());
    let decider = start_deciding(decision, taker, empty, limit, stop, &progress).map_err(internal)?;
    let notifier = Notifier::from_environment();
    let mut watch = Watch { progress, last_word, notifier, told_sets: 0, told: None, ready: false, ending_since: None };
    let start = Instant::now() + START_LIMIT;
    let (mut seen, mut deadlines) = ([0_u64; 2], [start; 2]);
    while !decider.is_finished() {
        std::thread::sleep(LOOK_PAUSE);
        for (index, count) in [beat.count(), watch.progress.beats.count()].into_iter().enumerate() {
            if count != seen[index] {
                (seen[index], deadlines[index]) = (count, Instant::now() + HANG_LIMIT);
            }
        }
        if stop.is_asked() {
            watch.end(stop, false)?;
        } else {
            watch.tell_manager();
        }
        let hangs = |index: usize| Instant::now() > deadlines[index];
        // The acquiring thread may be done before the deciding one; the deciding one may not be missing at all.
        if hangs(1) || (hangs(0) && !acquirer.is_finished()) {
            watch.say_zero(DaemonState::Fault, Reason::InternalError);
            return Err(ServiceError::Internal(
                "a thread hangs: the process ends, the robot was told to stand".to_owned(),
            ));
        }
    }
    stop.ask();
    finish(decider, acquirer, &mut watch, stop)
}

fn start_deciding(
    mut decision: DecisionLoop,
    taker: handoff::Taker<Delivered>,
    empty: Delivered,
    limit: Option<Duration>,
    stop: &Stop,
    progress: &Arc<Progress>,
) -> std::io::Result<JoinHandle<Decided>> {
    let (stopping, progress) = (Arc::clone(stop.flag()), Arc::clone(progress));
    std::thread::Builder::new().name("noctule-decide".to_owned()).spawn(move || {
        let ended = decision.run(&taker, empty, &stopping, limit, &progress);
        (ended, decision.reason_text(), decision.root_text())
    })
}

/// Puts together how it ended. A source that does not come back is left behind: the process ends.
fn finish(
    decider: JoinHandle<Decided>,
    acquirer: JoinHandle<Result<(), SourceError>>,
    watch: &mut Watch,
    stop: &Stop,
) -> Result<(), ServiceError> {
    let died = |which: &str| ServiceError::Internal(format!("the {which} thread died"));
    let joined = decider.join();
    if joined.is_err() {
        watch.say_zero(DaemonState::Fault, Reason::InternalError);
    }
    let (ended, reason, root) = joined.map_err(|_| died("deciding"))?;
    watch.end(stop, true)?;
    while !acquirer.is_finished() {
        watch.end(stop, true)?;
        std::thread::sleep(LOOK_PAUSE);
    }
    acquirer.join().map_err(|_| died("acquiring"))??;
    if is_dying() {
        return Err(ServiceError::Internal("a thread panicked".to_owned()));
    }
    match ended {
        Ended::Asked => Ok(()),
        Ended::Code(code) => Err(ServiceError::Gave { code, reason }),
        Ended::RootLost => Err(ServiceError::RootLost(root)),
    }
}
