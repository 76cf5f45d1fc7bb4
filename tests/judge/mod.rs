//! The judge: a fake platform in a process of its own that records what the controller really commands, and the figures made of it.
//!
//! It shares no code with the program under test: `examples/base_driver.rs` reads the topic by byte offsets with a subscriber and
//! a watchdog of its own, and CLOCK_BOOTTIME by itself. Everything here is arithmetic on its record.
#![allow(dead_code, reason = "every test file uses another part")]

#[path = "../../examples/base_driver.rs"]
pub mod base_driver;

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

pub use base_driver::now_ns;

pub const MS: u64 = 1_000_000;
/// Detected fault: its arrival to zero at the controller's output.
pub const Z1_NS: u64 = 150 * MS;
/// Silent fault: last good capture to zero at the output.
pub const Z2_NS: u64 = 350 * MS;
/// Numbers of the controller's states on the wire.
pub const WAIT: u32 = 0;
pub const TRACK: u32 = 1;
pub const HOLD: u32 = 2;
pub const LATCHED: u32 = 3;
/// Braking of the base.
const BRAKING_M_S2: f64 = 3.0;

/// A sample as the base received it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heard {
    /// When, by the judge's own clock.
    pub at_ns: u64,
    pub sent_ns: u64,
    pub sequence: u64,
    pub linear_m_s: f64,
    pub angular_rad_s: f64,
    pub epoch: u64,
    pub command_sequence: u64,
    pub captured_ns: u64,
    pub state: u32,
    pub reason: u32,
    pub daemon_state: u32,
}

impl Heard {
    /// Written so that NaN moves.
    pub fn moves(&self) -> bool {
        !(self.linear_m_s == 0.0 && self.angular_rad_s == 0.0)
    }
}

/// A change of what the motors are told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motors {
    pub at_ns: u64,
    pub linear_m_s: f64,
    pub angular_rad_s: f64,
}

impl Motors {
    pub fn moves(&self) -> bool {
        !(self.linear_m_s == 0.0 && self.angular_rad_s == 0.0)
    }
}

/// Limits to hold the output to.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    pub linear_m_s: f64,
    pub angular_rad_s: f64,
    pub linear_m_s2: f64,
    pub angular_rad_s2: f64,
}

/// Everything that the base received and did.
#[derive(Debug, Clone, Default)]
pub struct Record {
    pub heard: Vec<Heard>,
    pub motors: Vec<Motors>,
}

impl Record {
    /// Takes a line of the base driver; anything else is ignored.
    pub fn take(&mut self, line: &str) {
        let mut words = line.split_whitespace();
        let kind = words.next();
        let rest: Vec<&str> = words.collect();
        match (kind, rest.as_slice()) {
            (Some("S"), [at, sent, sequence, v, w, epoch, command, captured, state, reason, daemon]) => {
                self.heard.push(Heard {
                    at_ns: at.parse().expect("stamp"),
                    sent_ns: sent.parse().expect("stamp"),
                    sequence: sequence.parse().expect("number"),
                    linear_m_s: v.parse().expect("speed"),
                    angular_rad_s: w.parse().expect("rate"),
                    epoch: epoch.parse().expect("epoch"),
                    command_sequence: command.parse().expect("number"),
                    captured_ns: captured.parse().expect("stamp"),
                    state: state.parse().expect("state"),
                    reason: reason.parse().expect("reason"),
                    daemon_state: daemon.parse().expect("state"),
                });
            }
            (Some("M"), [at, v, w]) => self.motors.push(Motors {
                at_ns: at.parse().expect("stamp"),
                linear_m_s: v.parse().expect("speed"),
                angular_rad_s: w.parse().expect("rate"),
            }),
            _ => {}
        }
    }

    pub fn since(&self, from_ns: u64) -> impl Iterator<Item = &Heard> {
        self.heard.iter().filter(move |heard| heard.at_ns > from_ns)
    }

    /// When the output became zero for good after `from_ns`: the first zero after the last motion. `None` while it moves, or where
    /// nothing was heard since.
    pub fn zero_at(&self, from_ns: u64) -> Option<u64> {
        let last_motion = self.since(from_ns).filter(|heard| heard.moves()).last().map_or(from_ns, |heard| heard.at_ns);
        self.heard.iter().find(|heard| heard.at_ns > last_motion && !heard.moves()).map(|heard| heard.at_ns)
    }

    /// When the motors stood for good after `from_ns`, whoever told them, the base's own watchdog included.
    pub fn motors_stand_at(&self, from_ns: u64) -> Option<u64> {
        let before = self.motors.iter().rfind(|motors| motors.at_ns <= from_ns);
        let after: Vec<&Motors> = self.motors.iter().filter(|motors| motors.at_ns > from_ns).collect();
        match after.last() {
            None => before.filter(|motors| !motors.moves()).map(|_| from_ns),
            Some(last) if last.moves() => None,
            // Several zeros in a row cannot be: only changes are recorded.
            Some(last) => Some(last.at_ns),
        }
    }

    /// Motion after `from_ns`: what must not be before the next arming.
    pub fn motion_after(&self, from_ns: u64) -> Option<Heard> {
        self.since(from_ns).find(|heard| heard.moves()).copied()
    }

    /// Longest time between two samples, with both ends of the span counted.
    pub fn longest_silence_ns(&self, from_ns: u64, to_ns: u64) -> u64 {
        let inside = self.heard.iter().map(|heard| heard.at_ns).filter(|at| (from_ns..=to_ns).contains(at));
        let stamps: Vec<u64> = std::iter::once(from_ns).chain(inside).chain([to_ns]).collect();
        stamps.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(0)
    }

    /// Way of the base in metres between two moments, with the braking after the last motion.
    pub fn travel_m(&self, from_ns: u64, to_ns: u64) -> f64 {
        let mut way_m = 0.0;
        let mut speed =
            self.motors.iter().rfind(|motors| motors.at_ns <= from_ns).map_or(0.0, |motors| motors.linear_m_s.abs());
        let mut at_ns = from_ns;
        let mut fastest = speed;
        for motors in self.motors.iter().filter(|motors| motors.at_ns > from_ns && motors.at_ns <= to_ns) {
            way_m += speed * (motors.at_ns - at_ns) as f64 * 1e-9;
            (at_ns, speed) = (motors.at_ns, motors.linear_m_s.abs());
            fastest = fastest.max(speed);
        }
        way_m += speed * to_ns.saturating_sub(at_ns) as f64 * 1e-9;
        way_m + fastest * fastest / (2.0 * BRAKING_M_S2)
    }

    /// Samples outside the limits, or changed faster than allowed; a fall to exactly zero may be immediate.
    pub fn limit_violations(&self, limits: &Limits) -> usize {
        let outside = |heard: &Heard| {
            !(heard.linear_m_s.abs() <= limits.linear_m_s) || !(heard.angular_rad_s.abs() <= limits.angular_rad_s)
        };
        let too_fast = |pair: &[Heard]| {
            // The tick's clock is read a little before the sample is stamped: half a millisecond of it.
            let elapsed_s = pair[1].sent_ns.saturating_sub(pair[0].sent_ns) as f64 * 1e-9 + 0.5e-3;
            pair[1].moves()
                && (!((pair[1].linear_m_s - pair[0].linear_m_s).abs() <= limits.linear_m_s2 * elapsed_s)
                    || !((pair[1].angular_rad_s - pair[0].angular_rad_s).abs() <= limits.angular_rad_s2 * elapsed_s))
        };
        self.heard.iter().filter(|heard| outside(heard)).count()
            + self.heard.windows(2).filter(|pair| too_fast(pair)).count()
    }
}

/// The running judge.
pub struct Judge {
    child: Child,
    file: File,
    path: PathBuf,
    partial: String,
    pub record: Record,
}

const ROOT: &str = "NOCTULE_JUDGE_ROOT";
const PREFIX: &str = "NOCTULE_JUDGE_PREFIX";
const RECORD: &str = "NOCTULE_JUDGE_RECORD";

/// To be called by a test named `judge_process` of every file that uses the judge: it is the child process.
pub fn serve_if_asked() {
    let (Ok(root), Ok(prefix), Some(path)) = (std::env::var(ROOT), std::env::var(PREFIX), std::env::var_os(RECORD))
    else {
        return;
    };
    let record = File::options().append(true).open(&path).expect("record");
    // A judge whose record was taken away, or whose parent died, has nobody left to judge for.
    let parent = std::os::unix::process::parent_id();
    base_driver::drive(&root, &prefix, record, || {
        !Path::new(&path).exists() || std::os::unix::process::parent_id() != parent
    });
}

impl Judge {
    /// Starts a judge of the controller under `root` and `prefix`; its record is a file in `directory`.
    pub fn start(root: &Path, prefix: &str, directory: &Path) -> Self {
        let path = directory.join(format!("judge-{}.txt", now_ns()));
        File::create(&path).expect("record");
        let child = Command::new(std::env::current_exe().expect("this program"))
            .args(["--exact", "judge_process", "--test-threads", "1", "--quiet", "--nocapture"])
            .env(ROOT, root)
            .env(PREFIX, prefix)
            .env(RECORD, &path)
            .stdout(Stdio::null())
            .spawn()
            .expect("judge");
        let file = File::open(&path).expect("record");
        Self { child, file, path, partial: String::new(), record: Record::default() }
    }

    /// Reads what was recorded since the last look.
    pub fn look(&mut self) {
        assert!(matches!(self.child.try_wait(), Ok(None)), "the judge died");
        let mut text = String::new();
        self.file.read_to_string(&mut text).expect("record");
        self.partial.push_str(&text);
        let complete = self.partial.rfind('\n').map_or(0, |end| end + 1);
        for line in self.partial[..complete].lines() {
            self.record.take(line);
        }
        self.partial.drain(..complete);
    }

    /// Looks for a while.
    pub fn watch_for(&mut self, duration: Duration) {
        let deadline = Instant::now() + duration;
        while Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2).min(deadline - Instant::now()));
        }
        self.look();
    }

    /// Looks until the newest sample satisfies `condition`; panics after `limit`.
    pub fn watch_until(&mut self, limit: Duration, what: &str, condition: impl Fn(&Heard) -> bool) -> Heard {
        let deadline = Instant::now() + limit;
        loop {
            self.look();
            if let Some(newest) = self.newest().filter(|newest| condition(newest)) {
                return newest;
            }
            assert!(Instant::now() < deadline, "{what}: not within {limit:?}; newest {:?}", self.newest());
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    pub fn newest(&self) -> Option<Heard> {
        self.record.heard.last().copied()
    }

    /// Forgets all but the newest sample and what the motors do.
    pub fn forget(&mut self) {
        let (heard, motors) = (&mut self.record.heard, &mut self.record.motors);
        heard.drain(..heard.len().saturating_sub(1));
        motors.drain(..motors.len().saturating_sub(1));
    }
}

impl Drop for Judge {
    fn drop(&mut self) {
        // Ended in order, it leaves nothing in the root that a test looks through afterwards.
        let _ = std::fs::remove_file(&self.path);
        let deadline = Instant::now() + Duration::from_secs(2);
        while matches!(self.child.try_wait(), Ok(None)) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
