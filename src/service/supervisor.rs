//! Child processes kept alive: restarted with growing pauses, given up after too many deaths, ended on request.
//!
//! The supervisor of the safe-state contract where no systemd is: `demo` is the parent of daemon and controller.

use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

/// First pause before a restart; doubled each time up to [`PAUSE_MAX`].
const PAUSE_FIRST: Duration = Duration::from_secs(1);
const PAUSE_MAX: Duration = Duration::from_secs(30);
/// Deaths within [`DEATHS_WINDOW`] after which a process stays down.
const DEATHS_MAX: usize = 5;
const DEATHS_WINDOW: Duration = Duration::from_secs(60);
/// Time that a process has to end after SIGTERM before it is killed.
const END_LIMIT: Duration = Duration::from_millis(1_500);

/// When a process that died is to be started again.
#[derive(Debug, Clone, Default)]
pub struct Restarts {
    deaths: Vec<Duration>,
}

impl Restarts {
    /// Notes a death at `now` (time since any fixed moment) and gives the pause before the next start, `None` for never.
    pub fn after_death(&mut self, now: Duration) -> Option<Duration> {
        self.deaths.retain(|death| now.saturating_sub(*death) < DEATHS_WINDOW);
        self.deaths.push(now);
        if self.deaths.len() >= DEATHS_MAX {
            return None;
        }
        Some((PAUSE_FIRST * (1 << (self.deaths.len() - 1))).min(PAUSE_MAX))
    }
}

/// One child process.
pub struct Supervised {
    name: &'static str,
    make: Box<dyn Fn(u64) -> Command + Send>,
    child: Option<Child>,
    starts: u64,
    restarts: Restarts,
    begun: Instant,
    start_again_at: Option<Instant>,
}

/// What [`Supervised::watch`] saw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Watched {
    /// It runs, or waits for its next start.
    Alive,
    /// It ended with code 0.
    Finished,
    /// It died too often, or with a code that a restart cannot cure; the code it ended with.
    GivenUp(u8),
}

impl Supervised {
    /// Starts a process; `make` is given the number of earlier starts.
    ///
    /// # Errors
    /// When it cannot be started at all.
    pub fn start(name: &'static str, make: impl Fn(u64) -> Command + Send + 'static) -> std::io::Result<Self> {
        let child = make(0).spawn()?;
        Ok(Self {
            name,
            make: Box::new(make),
            child: Some(child),
            starts: 1,
            restarts: Restarts::default(),
            begun: Instant::now(),
            start_again_at: None,
        })
    }

    /// Looks after the process without waiting; starts it again when its pause is over.
    ///
    /// # Errors
    /// When the system refuses to look or to start.
    pub fn watch(&mut self) -> std::io::Result<Watched> {
        if let Some(status) = self.child.as_mut().map(Child::try_wait).transpose()?.flatten() {
            self.child = None;
            if status.success() {
                return Ok(Watched::Finished);
            }
            log::error!("{} ended: {status}", self.name);
            let code = code_of(status);
            // Usage and configuration do not change by trying again.
            let pause =
                if matches!(code, 2 | 65 | 78) { None } else { self.restarts.after_death(self.begun.elapsed()) };
            match pause {
                Some(pause) => self.start_again_at = Some(Instant::now() + pause),
                None => return Ok(Watched::GivenUp(code)),
            }
        }
        if self.start_again_at.is_some_and(|at| Instant::now() >= at) {
            self.start_again_at = None;
            log::warn!("{} starts again", self.name);
            self.child = Some((self.make)(self.starts).spawn()?);
            self.starts += 1;
        }
        Ok(Watched::Alive)
    }

    /// Asks the process to end, waits a bounded time, and kills it if it has not.
    pub fn end(&mut self) {
        let Some(child) = &mut self.child else { return };
        if let Some(pid) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
            // It may have ended by itself meanwhile: then there is nobody to tell.
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
        let deadline = Instant::now() + END_LIMIT;
        while Instant::now() < deadline {
            if matches!(child.try_wait(), Ok(Some(_)) | Err(_)) {
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        log::error!("{} did not end and is killed", self.name);
        let _ = child.kill();
        let _ = child.wait();
    }
}

impl Drop for Supervised {
    fn drop(&mut self) {
        self.end();
    }
}

fn code_of(status: ExitStatus) -> u8 {
    status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(70)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_and_the_fifth_death_within_a_minute_is_the_last() {
        let mut restarts = Restarts::default();
        let pauses: Vec<_> = (0..5).map(|death| restarts.after_death(Duration::from_secs(death * 10))).collect();
        let seconds = |pause: u64| Some(Duration::from_secs(pause));
        assert_eq!(pauses, [seconds(1), seconds(2), seconds(4), seconds(8), None]);
    }

    #[test]
    fn deaths_long_ago_are_forgotten() {
        let mut restarts = Restarts::default();
        for death in 0..20 {
            assert_eq!(restarts.after_death(Duration::from_secs(61 * death)), Some(Duration::from_secs(1)));
        }
    }

    #[test]
    fn a_process_that_ends_well_is_finished_and_one_with_a_bad_configuration_given_up() {
        let wait = |mut supervised: Supervised| loop {
            match supervised.watch().expect("watched") {
                Watched::Alive => std::thread::sleep(Duration::from_millis(2)),
                ended => break ended,
            }
        };
        let exits = |code: &'static str| {
            Supervised::start("shell", move |_| {
                let mut command = Command::new("sh");
                command.args(["-c", code]);
                command
            })
            .expect("started")
        };
        assert_eq!(wait(exits("exit 0")), Watched::Finished);
        assert_eq!(wait(exits("exit 78")), Watched::GivenUp(78));
    }
}
