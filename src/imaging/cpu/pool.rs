//! A small pool of threads that lives as long as the backend and works through a ping phase by phase.
//!
//! In: work shared by all threads and the number of a phase. Out: the phase done by all threads, the caller among them.
//! Between two phases of a ping a thread spins for some microseconds before it sleeps, since the next phase is near. Nothing
//! is allocated after start. It knows nothing of imaging; it never cancels work.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest time that the caller waits for the other threads: far beyond any ping, so that only a fault reaches it.
const PHASE_MAX: Duration = Duration::from_secs(5);
/// Turns of the spinning before a thread sleeps, about 30 microseconds.
const SPINS: usize = 1500;

/// Work that several threads share.
pub(super) trait Work: Send + Sync + 'static {
    /// Does thread `thread`'s share (1, 2, ...; 0 is the caller's, who does it himself) of phase `phase`.
    fn run(&self, phase: usize, thread: usize);
}

#[derive(Default)]
struct Control {
    generation: AtomicUsize,
    phase: AtomicUsize,
    busy: AtomicUsize,
    stop: AtomicBool,
    failed: AtomicBool,
    gate: Mutex<()>,
    wake: Condvar,
    done: Condvar,
}

impl Control {
    fn lock(&self) -> MutexGuard<'_, ()> {
        self.gate.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for the generation after `seen`; `None` when the pool ends.
    fn next_generation(&self, seen: usize) -> Option<usize> {
        let changed = || self.generation.load(Ordering::Acquire) != seen;
        for _ in 0..SPINS {
            if changed() {
                break;
            }
            std::hint::spin_loop();
        }
        let mut gate = self.lock();
        while !changed() {
            gate = self.wake.wait(gate).unwrap_or_else(PoisonError::into_inner);
        }
        drop(gate);
        (!self.stop.load(Ordering::Acquire)).then(|| self.generation.load(Ordering::Acquire))
    }

    /// Waits until no thread is busy; false when that takes longer than [`PHASE_MAX`].
    fn wait_done(&self) -> bool {
        let idle = || self.busy.load(Ordering::Acquire) == 0;
        for _ in 0..SPINS {
            if idle() {
                return true;
            }
            std::hint::spin_loop();
        }
        let deadline = Instant::now() + PHASE_MAX;
        let mut gate = self.lock();
        while !idle() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            gate = self.done.wait_timeout(gate, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }

    fn publish(&self, change: impl FnOnce()) {
        let gate = self.lock();
        change();
        self.generation.fetch_add(1, Ordering::AcqRel);
        drop(gate);
        self.wake.notify_all();
    }
}

/// The threads.
pub(super) struct Pool {
    control: Arc<Control>,
    handles: Vec<JoinHandle<()>>,
}

impl Pool {
    /// Starts `threads - 1` threads beside the caller's own.
    ///
    /// # Errors
    /// If the system refuses a thread.
    pub(super) fn start<W: Work>(work: &Arc<W>, threads: usize) -> std::io::Result<Self> {
        let mut pool = Self { control: Arc::new(Control::default()), handles: Vec::new() };
        for thread in 1..threads {
            let (control, work) = (Arc::clone(&pool.control), Arc::clone(work));
            let name = format!("imaging-{thread}");
            pool.handles.push(std::thread::Builder::new().name(name).spawn(move || serve(&control, &*work, thread))?);
        }
        Ok(pool)
    }

    /// Runs a phase on all threads, `own` being the caller's share, and waits for all. False when a thread failed, now or
    /// earlier: the results are then not to be used.
    pub(super) fn run(&self, phase: usize, own: impl FnOnce()) -> bool {
        if self.handles.is_empty() {
            own();
            return true;
        }
        if self.control.failed.load(Ordering::Acquire) {
            return false;
        }
        self.control.publish(|| {
            self.control.phase.store(phase, Ordering::Release);
            self.control.busy.store(self.handles.len(), Ordering::Release);
        });
        own();
        if !self.control.wait_done() {
            self.control.failed.store(true, Ordering::Release);
        }
        !self.control.failed.load(Ordering::Acquire)
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        self.control.publish(|| self.control.stop.store(true, Ordering::Release));
        // A thread that hangs must not keep the process from ending: it is left behind.
        let hung = self.control.busy.load(Ordering::Acquire) != 0;
        for handle in self.handles.drain(..).filter(|_| !hung) {
            let _ = handle.join();
        }
    }
}

fn serve<W: Work>(control: &Control, work: &W, thread: usize) {
    let mut seen = 0;
    while let Some(generation) = control.next_generation(seen) {
        seen = generation;
        let phase = control.phase.load(Ordering::Acquire);
        if catch_unwind(AssertUnwindSafe(|| work.run(phase, thread))).is_err() {
            control.failed.store(true, Ordering::Release);
        }
        if control.busy.fetch_sub(1, Ordering::AcqRel) == 1 {
            drop(control.lock());
            control.done.notify_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Counter {
        calls: Vec<AtomicUsize>,
        fail_in: Option<usize>,
    }

    impl Work for Counter {
        fn run(&self, phase: usize, thread: usize) {
            self.calls[thread].fetch_add(phase, Ordering::Relaxed);
            assert!(self.fail_in != Some(phase), "planted");
        }
    }

    fn counter(fail_in: Option<usize>) -> Arc<Counter> {
        Arc::new(Counter { calls: (0..3).map(|_| AtomicUsize::new(0)).collect(), fail_in })
    }

    #[test]
    fn every_thread_does_every_phase_once_even_after_a_pause() {
        let work = counter(None);
        let pool = Pool::start(&work, 3).unwrap();
        for round in 0..200 {
            if round % 50 == 0 {
                std::thread::sleep(Duration::from_millis(2));
            }
            assert!(pool.run(1, || work.run(1, 0)));
            assert!(pool.run(2, || work.run(2, 0)));
        }
        for calls in &work.calls {
            assert_eq!(calls.load(Ordering::Relaxed), 600);
        }
    }

    #[test]
    fn a_thread_that_panics_is_reported_and_the_pool_refuses_further_work() {
        let work = counter(Some(2));
        let pool = Pool::start(&work, 3).unwrap();
        assert!(pool.run(1, || {}));
        assert!(!pool.run(2, || {}));
        assert!(!pool.run(1, || {}));
    }

    #[test]
    fn in_a_daemon_a_panic_of_the_pool_ends_the_process_with_70() {
        const CHILD: &str = "NOCTULE_TEST_POOL_CHILD";
        if std::env::var_os(CHILD).is_some() {
            crate::life::panic::end_on_panic(&Arc::default());
            let work = counter(Some(2));
            let pool = Pool::start(&work, 3).unwrap();
            assert!(pool.run(1, || {}));
            pool.run(2, || {});
            std::thread::sleep(Duration::from_secs(10));
            std::process::exit(0);
        }
        let program = std::env::current_exe().unwrap();
        let test = "imaging::cpu::pool::tests::in_a_daemon_a_panic_of_the_pool_ends_the_process_with_70";
        let began = Instant::now();
        let output = std::process::Command::new(program).args(["--exact", test]).env(CHILD, "1").output().unwrap();
        assert_eq!(output.status.code(), Some(70));
        assert!(began.elapsed() < Duration::from_secs(5));
    }
}
