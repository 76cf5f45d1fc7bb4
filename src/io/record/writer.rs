//! The thread that writes: takes what is in the queues, makes messages, closes a chunk every second.
//!
//! It runs at a lower priority and alone knows of the disk. A disk that fails ends the recording, never the process: it is
//! logged once, and what comes later is taken out of the queues and counted.

use super::scribe::Scribe;
use super::slots::{Item, NOTES_MAX, Slot, Tap};
use super::{RecordError, RecordOptions, RecordSubject};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Pause of the writer when nothing waits.
const LOOK_PAUSE: Duration = Duration::from_millis(5);
/// A chunk is closed and given to the system at least this often.
const FLUSH_PERIOD: Duration = Duration::from_millis(900);
/// By how much the thread steps back behind those that drive the robot.
#[cfg(any(target_os = "linux", target_os = "android"))]
const NICENESS: i32 = 10;

/// How a recording is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum RecordState {
    /// Writing.
    Recording = 0,
    /// Ended in order.
    Finished = 1,
    /// The disk is full, or its reserve is reached.
    Full = 2,
    /// The disk failed.
    Failed = 3,
}

/// What a recording came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    /// How it is.
    pub state: RecordState,
    /// Messages written.
    pub messages: u64,
    /// Bytes written, of all parts.
    pub bytes: u64,
    /// Ping sets that found no free slot, or came after the disk failed.
    pub dropped_sets: u64,
    /// Notes that found the queue full, or came after the disk failed.
    pub dropped_notes: u64,
}

/// What both threads count.
#[derive(Debug, Default)]
pub(super) struct Shared {
    state: AtomicU8,
    messages: AtomicU64,
    bytes: AtomicU64,
    pub(super) dropped_sets: AtomicU64,
    pub(super) dropped_notes: AtomicU64,
}

impl Shared {
    pub(super) fn tally(&self) -> Tally {
        let state = match self.state.load(Ordering::Relaxed) {
            0 => RecordState::Recording,
            1 => RecordState::Finished,
            2 => RecordState::Full,
            _ => RecordState::Failed,
        };
        Tally {
            state,
            messages: self.messages.load(Ordering::Relaxed),
            bytes: self.bytes.load(Ordering::Relaxed),
            dropped_sets: self.dropped_sets.load(Ordering::Relaxed),
            dropped_notes: self.dropped_notes.load(Ordering::Relaxed),
        }
    }

    pub(super) fn is_over(&self) -> bool {
        self.state.load(Ordering::Relaxed) != RecordState::Recording as u8
    }
}

/// A recording under way.
pub struct Recorder {
    thread: JoinHandle<Result<(), RecordError>>,
    shared: Arc<Shared>,
}

/// A recorder with the side of whoever decides.
pub struct Recording {
    /// To be given to whoever decides; dropping it ends the recording.
    pub tap: Tap,
    /// To be waited for.
    pub recorder: Recorder,
}

impl Recording {
    /// Makes the first file and the slots, and starts the thread.
    ///
    /// # Errors
    /// [`RecordError`]; nothing runs then.
    pub fn start(options: &RecordOptions, subject: RecordSubject) -> Result<Self, RecordError> {
        let shared = Arc::new(Shared::default());
        let (items, inbox) = sync_channel(NOTES_MAX);
        let slot_count = options.slot_count.max(1);
        let (give_back, free) = sync_channel(slot_count + 1);
        for _ in 0..slot_count {
            // There is room for all of them.
            let _ = give_back.try_send(Box::new(Slot::new(&subject)));
        }
        let scribe = Scribe::start(options, subject)?;
        let writer = Writer { scribe, inbox, give_back, shared: Arc::clone(&shared), flushed_at: Instant::now() };
        let thread = std::thread::Builder::new()
            .name("noctule-record".to_owned())
            .spawn(move || writer.run())
            .map_err(RecordError::Thread)?;
        let tap = Tap {
            items,
            free,
            spare: None,
            shared: Arc::clone(&shared),
            raw: options.raw,
            patient: options.patient,
            step_count: 0,
        };
        Ok(Self { tap, recorder: Recorder { thread, shared } })
    }

    /// Ends the recording and waits for its last byte.
    ///
    /// # Errors
    /// What ended the recording before.
    pub fn finish(self, limit: Duration) -> Result<Tally, RecordError> {
        let Self { tap, recorder } = self;
        drop(tap);
        recorder.finish(limit)
    }
}

impl Recorder {
    /// How the recording is.
    #[must_use]
    pub fn tally(&self) -> Tally {
        self.shared.tally()
    }

    /// Waits at most `limit` for the last byte, after the tap was dropped. A file that is not finished by then lacks its index; it
    /// is read up to its last whole chunk.
    ///
    /// # Errors
    /// What ended the recording before.
    pub fn finish(self, limit: Duration) -> Result<Tally, RecordError> {
        let begun = Instant::now();
        while !self.thread.is_finished() {
            if begun.elapsed() > limit {
                log::warn!("the recording is not finished after {} ms: its index is missing", limit.as_millis());
                return Ok(self.tally());
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        match self.thread.join() {
            Ok(ended) => ended.map(|()| self.shared.tally()),
            Err(_) => Err(RecordError::Thread(std::io::Error::other("it died"))),
        }
    }
}

struct Writer {
    scribe: Scribe,
    inbox: Receiver<Item>,
    give_back: SyncSender<Box<Slot>>,
    shared: Arc<Shared>,
    flushed_at: Instant,
}

impl Writer {
    fn run(mut self) -> Result<(), RecordError> {
        step_back();
        let ended = self.write_all();
        let ended = ended.and_then(|()| self.scribe.finish());
        let state = match &ended {
            Ok(()) => RecordState::Finished,
            Err(error) => error.state(),
        };
        self.count();
        self.shared.state.store(state as u8, Ordering::Relaxed);
        if let Err(error) = &ended {
            log::error!("recording ends: {error}");
            // What is whole is kept: the end of the file is written if the disk still takes it.
            if matches!(error, RecordError::Full { .. }) && self.scribe.finish().is_err() {
                log::error!("the recording has no index; it is read up to its last whole chunk");
            }
            self.drain();
        }
        ended
    }

    fn write_all(&mut self) -> Result<(), RecordError> {
        loop {
            match self.inbox.try_recv() {
                Ok(Item::Note(now, note)) => self.scribe.note(now, &note)?,
                Ok(Item::Set(now, mut slot)) => {
                    let written = self.scribe.slot(now, &mut slot);
                    // There is room for every slot there is.
                    let _ = self.give_back.try_send(slot);
                    written?;
                }
                Err(TryRecvError::Empty) => std::thread::sleep(LOOK_PAUSE),
                Err(TryRecvError::Disconnected) => return Ok(()),
            }
            if self.flushed_at.elapsed() >= FLUSH_PERIOD {
                self.flushed_at = Instant::now();
                self.scribe.flush()?;
                self.count();
            }
        }
    }

    fn count(&self) {
        let (messages, bytes) = self.scribe.written();
        self.shared.messages.store(messages, Ordering::Relaxed);
        self.shared.bytes.store(bytes, Ordering::Relaxed);
    }

    /// After a failure: empties the queues until nobody sends any more.
    fn drain(&mut self) {
        loop {
            match self.inbox.try_recv() {
                Ok(Item::Note(..)) => drop(self.shared.dropped_notes.fetch_add(1, Ordering::Relaxed)),
                Ok(Item::Set(_, slot)) => {
                    self.shared.dropped_sets.fetch_add(1, Ordering::Relaxed);
                    let _ = self.give_back.try_send(slot);
                }
                Err(TryRecvError::Empty) => std::thread::sleep(LOOK_PAUSE),
                Err(TryRecvError::Disconnected) => return,
            }
        }
    }
}

fn step_back() {
    // Where the system refuses, the thread is one among equals: it still waits for nobody.
    #[cfg(any(target_os = "linux", target_os = "android"))]
    let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), NICENESS);
}
