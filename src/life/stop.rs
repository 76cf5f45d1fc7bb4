//! Asked to end: SIGTERM and SIGINT set a flag, and end the process on the spot where nothing has to be put in order.
//!
//! In: signals. Out: a flag that loops look at. Never decides what an orderly end is.

use signal_hook::consts::{SIGINT, SIGTERM};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Exit code when a second signal ends a tool at once.
const EXIT_SECOND_SIGNAL: i32 = 130;

/// A flag that SIGTERM and SIGINT set; a second signal ends the process at once. For tools, which hold nothing that moves.
///
/// # Errors
/// When the system refuses to watch for signals.
pub fn stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT] {
        signal_hook::flag::register_conditional_shutdown(signal, EXIT_SECOND_SIGNAL, Arc::clone(&stop))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}

/// The wish to end of a process that moves a robot. A second signal hurries nothing as long as the orderly end, which tells zero first and
/// takes some milliseconds, is under way; [`Stop::allow_abrupt`] says when it is not.
#[derive(Debug, Clone, Default)]
pub struct Stop {
    asked: Arc<AtomicBool>,
    abrupt: Arc<AtomicBool>,
}

impl Stop {
    /// Watches for signals. Until [`Stop::hold`] a signal ends the process on the spot, with 0: nothing is there to be left behind.
    ///
    /// # Errors
    /// When the system refuses to watch for signals.
    pub fn on_signals() -> io::Result<Self> {
        let stop = Self::default();
        stop.allow_abrupt(true);
        for signal in [SIGTERM, SIGINT] {
            signal_hook::flag::register_conditional_shutdown(signal, 0, Arc::clone(&stop.abrupt))?;
            signal_hook::flag::register(signal, Arc::clone(&stop.asked))?;
        }
        Ok(stop)
    }

    /// From now on there is something to be put in order; the next signal only sets the flag.
    pub fn hold(&self) {
        self.allow_abrupt(false);
    }

    /// Whether a signal may end the process on the spot.
    pub fn allow_abrupt(&self, allowed: bool) {
        self.abrupt.store(allowed, Ordering::Relaxed);
    }

    /// Whether the process is to end.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.asked.load(Ordering::Relaxed)
    }

    /// Asks it to end.
    pub fn ask(&self) {
        self.asked.store(true, Ordering::Relaxed);
    }

    /// The flag itself.
    #[must_use]
    pub fn flag(&self) -> &Arc<AtomicBool> {
        &self.asked
    }
}

impl From<Arc<AtomicBool>> for Stop {
    fn from(asked: Arc<AtomicBool>) -> Self {
        Self { asked, abrupt: Arc::default() }
    }
}
