//! Where GPU devices are opened and closed: a thread of its own, since either may take long or never end.
//!
//! In: jobs, which are handed over without a wait. Out: the device that was opened, or why not, whenever it is there. A device that
//! cannot be closed keeps a thread and is forgotten; one that cannot be opened keeps this one. Decides nothing.

use super::backend::{Backend, BackendError};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Opens a device anew.
pub type Opener = Box<dyn FnMut() -> Result<Box<dyn Backend>, BackendError> + Send>;

/// What is given up at the end of the program is waited for so long.
const CLOSE_LIMIT: Duration = Duration::from_millis(300);
/// Pause between two looks at a thread that is to end.
const LOOK_PAUSE: Duration = Duration::from_millis(5);
/// Jobs that may wait. One device is open at a time, so there are never as many.
const JOBS_MAX: usize = 4;

/// Threads of this process that are inside a driver, opening or closing a device.
static AT_WORK: AtomicUsize = AtomicUsize::new(0);

/// Counts as one of [`AT_WORK`] as long as it lives.
struct AtWork;

impl AtWork {
    fn begin() -> Self {
        AT_WORK.fetch_add(1, Ordering::AcqRel);
        Self
    }
}

impl Drop for AtWork {
    fn drop(&mut self) {
        AT_WORK.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Whether a driver is still opening or closing a device for somebody who no longer waits. A process that ends now must not run the
/// destructors of its libraries: the driver would lose what it works with, and abort.
#[must_use]
pub fn driver_at_work() -> bool {
    AT_WORK.load(Ordering::Acquire) > 0
}

enum Job {
    Open,
    Close(Box<dyn Backend>),
}

type Opened = Arc<Mutex<Option<Result<Box<dyn Backend>, BackendError>>>>;

/// The thread, seen from the path of the pings.
pub(super) struct Workshop {
    jobs: Option<SyncSender<Job>>,
    opened: Opened,
    thread: Option<JoinHandle<()>>,
}

impl Workshop {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system refuses it.
    pub(super) fn start(opener: Opener) -> std::io::Result<Self> {
        let (jobs, inbox) = sync_channel(JOBS_MAX);
        let opened: Opened = Arc::new(Mutex::new(None));
        let tray = Arc::clone(&opened);
        let named = std::thread::Builder::new().name("noctule-gpu".to_owned());
        let thread = named.spawn(move || work(opener, &inbox, &tray))?;
        Ok(Self { jobs: Some(jobs), opened, thread: Some(thread) })
    }

    /// Asks for a new device. Returns at once.
    pub(super) fn open(&self) {
        self.hand_over(Job::Open);
    }

    /// Lets go of a device. Returns at once.
    pub(super) fn close(&self, backend: Box<dyn Backend>) {
        self.hand_over(Job::Close(backend));
    }

    fn hand_over(&self, job: Job) {
        if let Some(Err(TrySendError::Full(job) | TrySendError::Disconnected(job))) =
            self.jobs.as_ref().map(|jobs| jobs.try_send(job))
        {
            // Closing it here could hang the path of the pings.
            std::mem::forget(job);
        }
    }

    /// Waits until the device asked for is there, for simulations: their time does not pass meanwhile.
    pub(super) fn wait(&self, limit: Duration) {
        let limit = Instant::now() + limit;
        while self.opened.lock().unwrap_or_else(PoisonError::into_inner).is_none() && Instant::now() < limit {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// The device asked for, once it is there. Returns at once.
    pub(super) fn take(&self) -> Option<Result<Box<dyn Backend>, BackendError>> {
        match self.opened.try_lock() {
            Ok(mut opened) => opened.take(),
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner().take(),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        self.jobs = None;
        let Some(thread) = self.thread.take() else { return };
        // A driver that is at work when the program ends may crash it; one that hangs must not hold it up.
        let limit = Instant::now() + CLOSE_LIMIT;
        while (!thread.is_finished() || driver_at_work()) && Instant::now() < limit {
            std::thread::sleep(LOOK_PAUSE);
        }
    }
}

fn work(mut opener: Opener, inbox: &Receiver<Job>, tray: &Opened) {
    while let Ok(job) = inbox.recv() {
        match job {
            Job::Open => {
                let at_work = AtWork::begin();
                let opened = opener();
                drop(at_work);
                *tray.lock().unwrap_or_else(PoisonError::into_inner) = Some(opened);
            }
            Job::Close(backend) => close(backend),
        }
    }
}

/// Closes a device in a thread of its own and waits a little for it: the program may be about to end.
pub(super) fn close_and_wait(backend: Box<dyn Backend>) {
    close_within(backend, CLOSE_LIMIT);
}

/// Closes a device in a thread of its own.
pub(super) fn close(backend: Box<dyn Backend>) {
    close_within(backend, Duration::ZERO);
}

fn close_within(backend: Box<dyn Backend>, limit: Duration) {
    let (done, ended) = sync_channel::<()>(1);
    let held = Arc::new(Mutex::new(Some(backend)));
    let taken = Arc::clone(&held);
    let named = std::thread::Builder::new().name("noctule-gpu-end".to_owned());
    let at_work = AtWork::begin();
    let started = named.spawn(move || {
        drop(taken.lock().unwrap_or_else(PoisonError::into_inner).take());
        drop((at_work, done));
    });
    if started.is_err() {
        // Without a thread it is not closed at all: closing it here could take for ever.
        std::mem::forget(held.lock().unwrap_or_else(PoisonError::into_inner).take());
        return;
    }
    match ended.recv_timeout(limit) {
        Ok(()) | Err(RecvTimeoutError::Disconnected | RecvTimeoutError::Timeout) => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_driver_that_still_works_is_told_of_until_it_ends() {
        let (release, released) = sync_channel::<()>(0);
        let opener: Opener = Box::new(move || {
            let _ = released.recv();
            Err(BackendError::Unavailable("opened too late".to_owned()))
        });
        let workshop = Workshop::start(opener).expect("a thread");
        workshop.open();
        let begun = Instant::now();
        drop(workshop);
        assert!(begun.elapsed() >= CLOSE_LIMIT, "the end waits a little");
        assert!(driver_at_work(), "what was given up is known");
        release.send(()).expect("still at work");
        // Other tests of this program may have drivers at work as well.
        let limit = Instant::now() + Duration::from_secs(60);
        while driver_at_work() && Instant::now() < limit {
            std::thread::sleep(LOOK_PAUSE);
        }
        assert!(!driver_at_work(), "it ended");
    }
}
