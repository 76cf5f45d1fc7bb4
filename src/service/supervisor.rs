//! Child processes kept alive: killed when they give no beat, restarted with growing pauses, given up after too many deaths.
//!
//! The supervisor of the safe-state contract where no systemd is: `demo` is the parent of daemon and controller. In: beats, which its
//! owner gives for something that the process *did*. Out: what became of it. Never looks at a topic itself.

use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

/// Longest pause before a restart.
const PAUSE_MAX: Duration = Duration::from_secs(30);
/// Deaths within [`DEATHS_WINDOW`] after which a process stays down.
const DEATHS_MAX: usize = 5;
const DEATHS_WINDOW: Duration = Duration::from_secs(60);
/// Exit code of a process whose communication is stuck.
const EXIT_STUCK: u8 = 75;
/// Time that a process has to end after SIGTERM before it is killed.
const END_LIMIT: Duration = Duration::from_millis(1_500);

/// A supervisor that did not run for longer than this has missed beats that were given.
const ABSENCE_MAX: Duration = Duration::from_millis(250);

/// What is expected of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Terms {
    /// Pause before the first restart; doubled each time up to half a minute.
    pub first_pause: Duration,
    /// Longest time from a start to the first beat.
    pub start_limit: Duration,
    /// Longest time between two beats.
    pub beat_limit: Duration,
}

/// The daemon beats with every ping set that it processed; one that does not is killed within two seconds.
pub const DAEMON_TERMS: Terms = Terms {
    first_pause: Duration::from_secs(1),
    start_limit: Duration::from_secs(15),
    beat_limit: Duration::from_millis(1_800),
};

/// The controller beats with every tick, and is back within a second of its death.
pub const CONTROLLER_TERMS: Terms = Terms {
    first_pause: Duration::from_millis(500),
    start_limit: Duration::from_secs(6),
    beat_limit: Duration::from_secs(1),
};

/// For processes that somebody looks at himself: no beat is expected.
pub const UNWATCHED: Terms = Terms {
    first_pause: Duration::from_secs(1),
    start_limit: Duration::from_secs(365 * 86_400),
    beat_limit: Duration::from_secs(365 * 86_400),
};

/// When a process that died is to be started again.
#[derive(Debug, Clone)]
pub struct Restarts {
    first_pause: Duration,
    deaths: Vec<Duration>,
}

impl Restarts {
    /// With `first_pause` before the first restart.
    #[must_use]
    pub fn new(first_pause: Duration) -> Self {
        Self { first_pause, deaths: Vec::new() }
    }

    /// Notes a death at `now` (time since any fixed moment) and gives the pause before the next start, `None` for never.
    pub fn after_death(&mut self, now: Duration) -> Option<Duration> {
        self.deaths.retain(|death| now.saturating_sub(*death) < DEATHS_WINDOW);
        self.deaths.push(now);
        if self.deaths.len() >= DEATHS_MAX {
            return None;
        }
        Some((self.first_pause * (1 << (self.deaths.len() - 1))).min(PAUSE_MAX))
    }
}

/// One child process.
pub struct Supervised {
    name: &'static str,
    terms: Terms,
    make: Box<dyn Fn(u64) -> Command + Send>,
    child: Option<Child>,
    starts: u64,
    restarts: Restarts,
    begun: Instant,
    start_again_at: Option<Instant>,
    beat_until: Instant,
    looked_at: Instant,
}

/// What [`Supervised::watch`] saw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Watched {
    /// It runs, or waits for its next start.
    Alive,
    /// It ended with code 0.
    Finished,
    /// It ended with 75: communication is stuck. Stop everything, wipe, then [`Supervised::start_again`].
    Stuck,
    /// It died too often, or with a code that a restart cannot cure; the code it ended with.
    GivenUp(u8),
}

impl Supervised {
    /// Starts a process; `make` is given the number of earlier starts.
    ///
    /// # Errors
    /// When it cannot be started at all.
    pub fn start(
        name: &'static str,
        terms: Terms,
        make: impl Fn(u64) -> Command + Send + 'static,
    ) -> std::io::Result<Self> {
        let child = make(0).spawn()?;
        let now = Instant::now();
        Ok(Self {
            name,
            terms,
            make: Box::new(make),
            child: Some(child),
            starts: 1,
            restarts: Restarts::new(terms.first_pause),
            begun: now,
            start_again_at: None,
            beat_until: now + terms.start_limit,
            looked_at: now,
        })
    }

    /// The process did what it is there for.
    pub fn beat(&mut self) {
        self.beat_until = Instant::now() + self.terms.beat_limit;
    }

    /// Number of the running process.
    #[must_use]
    pub fn process_id(&self) -> Option<u32> {
        self.child.as_ref().map(Child::id)
    }

    /// Starts it anew after [`Supervised::end`], or after [`Watched::Stuck`].
    pub fn start_again(&mut self) {
        self.start_again_at = Some(Instant::now());
    }

    /// Looks after the process without waiting; starts it again when its pause is over.
    ///
    /// # Errors
    /// When the system refuses to look or to start.
    pub fn watch(&mut self) -> std::io::Result<Watched> {
        self.kill_if_silent();
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
                Some(_) if code == EXIT_STUCK => return Ok(Watched::Stuck),
                Some(pause) => self.start_again_at = Some(Instant::now() + pause),
                None => return Ok(Watched::GivenUp(code)),
            }
        }
        if self.start_again_at.is_some_and(|at| Instant::now() >= at) {
            self.start_again_at = None;
            log::warn!("{} starts again", self.name);
            self.child = Some((self.make)(self.starts).spawn()?);
            self.starts += 1;
            self.beat_until = Instant::now() + self.terms.start_limit;
        }
        Ok(Watched::Alive)
    }

    /// A process that is stopped, deadlocked or starved cannot end itself.
    fn kill_if_silent(&mut self) {
        let now = Instant::now();
        let absence = now - std::mem::replace(&mut self.looked_at, now);
        if absence > ABSENCE_MAX {
            self.beat_until += absence;
        }
        if now <= self.beat_until {
            return;
        }
        if let Some(child) = &mut self.child {
            log::error!("{} gives no beat and is killed", self.name);
            // It may have ended by itself meanwhile: then there is nobody to kill.
            let _ = child.kill();
        }
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
                self.child = None;
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        log::error!("{} did not end and is killed", self.name);
        let _ = child.kill();
        let _ = child.wait();
        self.child = None;
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
        let mut restarts = Restarts::new(Duration::from_secs(1));
        let pauses: Vec<_> = (0..5).map(|death| restarts.after_death(Duration::from_secs(death * 10))).collect();
        let seconds = |pause: u64| Some(Duration::from_secs(pause));
        assert_eq!(pauses, [seconds(1), seconds(2), seconds(4), seconds(8), None]);
    }

    #[test]
    fn deaths_long_ago_are_forgotten() {
        let mut restarts = Restarts::new(Duration::from_secs(1));
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
            Supervised::start("shell", DAEMON_TERMS, move |_| {
                let mut command = Command::new("sh");
                command.args(["-c", code]);
                command
            })
            .expect("started")
        };
        assert_eq!(wait(exits("exit 0")), Watched::Finished);
        assert_eq!(wait(exits("exit 78")), Watched::GivenUp(78));
        assert_eq!(wait(exits("exit 75")), Watched::Stuck);
    }

    #[test]
    fn a_stopped_process_is_killed_for_want_of_a_beat_and_one_that_beats_is_not() {
        let terms =
            Terms { start_limit: Duration::from_millis(100), beat_limit: Duration::from_millis(100), ..DAEMON_TERMS };
        let sleeper = |_| {
            let mut command = Command::new("sleep");
            command.arg("60");
            command
        };
        let mut supervised = Supervised::start("sleeper", terms, sleeper).expect("started");
        let mut beaten = Instant::now();
        for _ in 0..30 {
            beaten = Instant::now();
            supervised.beat();
            std::thread::sleep(Duration::from_millis(10));
            assert_eq!(supervised.watch().expect("watched"), Watched::Alive);
        }
        let first = supervised.process_id().expect("runs");
        while supervised.process_id() == Some(first) {
            std::thread::sleep(Duration::from_millis(10));
            assert_eq!(supervised.watch().expect("watched"), Watched::Alive);
            assert!(beaten.elapsed() < Duration::from_secs(2), "it is not killed");
        }
        assert!(beaten.elapsed() >= Duration::from_millis(100));
    }

    #[test]
    fn a_supervisor_that_was_absent_itself_kills_nobody_for_it() {
        let terms = Terms { beat_limit: Duration::from_millis(300), ..DAEMON_TERMS };
        let mut supervised = Supervised::start("sleeper", terms, |_| {
            let mut command = Command::new("sleep");
            command.arg("60");
            command
        })
        .expect("started");
        supervised.beat();
        std::thread::sleep(Duration::from_millis(600));
        let first = supervised.process_id();
        for _ in 0..10 {
            supervised.watch().expect("watched");
            std::thread::sleep(Duration::from_millis(10));
        }
        assert_eq!(supervised.process_id(), first);
        assert!(first.is_some());
    }
}
