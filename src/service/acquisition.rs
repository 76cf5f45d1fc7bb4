//! The acquiring thread: asks the source for ping sets and hands them on, newest first. Never waits for the imaging.

use super::handoff::Giver;
use crate::io::source::{Delivery, Moment, Source, SourceError};
use crate::signal::{PingSet, Velocity};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Longest wait inside the source before the thread looks whether it is to end.
const WAIT: Duration = Duration::from_millis(20);

/// What goes from the acquiring thread to the imaging thread.
#[derive(Debug, Clone)]
pub struct Delivered {
    /// The ping set.
    pub pings: PingSet,
    /// What the source itself asks for, if it has a guidance.
    pub wanted: Option<Velocity>,
    /// What the pipeline was told with it, where the source is a recorded run.
    pub moment: Option<Moment>,
}

/// A beat that a thread gives and a watcher counts.
#[derive(Debug, Default)]
pub struct Heartbeat(AtomicU64);

impl Heartbeat {
    /// Tells that the thread is alive.
    pub fn beat(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of beats so far.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Starts the thread. It ends when `stop` is set, the source ends or fails; dropping the giver tells the other side.
///
/// # Errors
/// When the system refuses a thread.
pub fn start(
    mut source: Box<dyn Source + Send>,
    giver: Giver<Delivered>,
    mut buffer: Delivered,
    stop: Arc<AtomicBool>,
    heartbeat: Arc<Heartbeat>,
) -> std::io::Result<JoinHandle<Result<(), SourceError>>> {
    std::thread::Builder::new().name("noctule-acquire".to_owned()).spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            match source.next_ping_set(&mut buffer.pings, WAIT)? {
                Delivery::Set => {
                    buffer.wanted = source.wanted_velocity();
                    buffer.moment = source.moment();
                    giver.give(&mut buffer);
                }
                Delivery::Nothing => {}
                Delivery::End => break,
            }
            heartbeat.beat();
        }
        Ok(())
    })
}
