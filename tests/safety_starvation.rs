//! Check 25: with two busy processes a core and a storm of writes beside them, daemon and controller use nothing older than MAX_AGE, the
//! controller stays alive, and every ping set is either processed or told to be missed. Judged by a base that shares no code with them.
#![cfg(target_os = "linux")]

mod checks;
mod ipc_rig;
mod judge;

use checks::{figure, trials};
use ipc_rig::{Controller, Place, wait_for};
use judge::{Heard, Judge, MS, Record};
use noctule::io::StatusTopics;
use noctule::io::wire::message::Request;
use noctule::io::wire::telemetry::Health;
use rustix::process::{Pid, Signal, kill_process};
use std::io::Write as _;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// MAX_AGE of the safe-state contract.
const MAX_AGE_NS: u64 = 300 * MS;
/// A controller that is silent for longer is taken for dead and started anew; after 250 ms the base has stopped by itself.
const DEAD_NS: u64 = 1_000 * MS;
/// Names what a child process is to do.
const STRESS: &str = "NOCTULE_TEST_STRESS";
const STORM_BYTES: usize = 64 << 20;

#[test]
fn judge_process() {
    judge::serve_if_asked();
}

/// Not a test of its own: the busy child processes of the test below.
#[test]
fn stress_process() {
    let Some(what) = std::env::var_os(STRESS) else { return };
    let parent = std::os::unix::process::parent_id();
    let orphaned = || std::os::unix::process::parent_id() != parent;
    if what == "burn" {
        let mut value = 1.0_f64;
        while !orphaned() {
            (0..1_000_000).for_each(|_| value = std::hint::black_box(value * 1.000_000_1));
        }
        return;
    }
    let path = std::path::PathBuf::from(what);
    let block = vec![0x5a_u8; 1 << 20];
    while !orphaned() && path.parent().is_some_and(std::path::Path::exists) {
        let mut file = std::fs::File::create(&path).expect("a file to write");
        (0..STORM_BYTES / block.len()).for_each(|_| file.write_all(&block).expect("written"));
        file.sync_all().expect("synced");
    }
}

/// Child processes that end with this.
struct Stress(Vec<Child>);

impl Stress {
    fn start(place: &Place) -> Self {
        let cores = std::thread::available_parallelism().map_or(2, std::num::NonZero::get);
        let storm = place.directory.path().join("storm").display().to_string();
        let tasks = std::iter::repeat_n("burn".to_owned(), 2 * cores).chain([storm]);
        let start = |task: String| {
            Command::new(std::env::current_exe().expect("this program"))
                .args(["--exact", "stress_process", "--test-threads", "1", "--quiet"])
                .env(STRESS, task)
                .stdout(Stdio::null())
                .spawn()
                .expect("stress")
        };
        Self(tasks.map(start).collect())
    }
}

impl Drop for Stress {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// The real daemon, killed if the test fails.
struct Daemon(Child);

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Samples in which the platform was moved by data that were too old, and the oldest data that moved it.
fn stale_uses(record: &Record) -> (usize, u64) {
    let ages =
        record.heard.iter().filter(|heard| heard.moves()).map(|heard| heard.sent_ns.saturating_sub(heard.captured_ns));
    ages.fold((0, 0), |(count, oldest), age| (count + usize::from(age > MAX_AGE_NS), oldest.max(age)))
}

/// Ping sets made, as the last one's number says, less those that the daemon says it processed or missed.
fn unaccounted(last_number: u64, health: &Health) -> i64 {
    (last_number + 1) as i64 - (health.ping_set_count + health.dropped_count) as i64
}

#[test]
fn starved_of_processor_and_disk_nothing_old_is_used_and_every_miss_is_told() {
    let seconds = trials(600, 12);
    let place = Place::new();
    let _controller = Controller::start(&place, &[]);
    let mut judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
    let daemon = Command::new(env!("CARGO_BIN_EXE_noctule"))
        .args(["--quiet", "run", "--config"])
        .arg(place.config_file())
        .current_dir(place.directory.path())
        .spawn()
        .expect("daemon");
    let mut daemon = Daemon(daemon);
    let status = StatusTopics::open(&place.ipc).expect("status");
    let operator = noctule::io::OperatorClient::open(&place.ipc).expect("operator");
    let limit = Instant::now() + Duration::from_secs(30);
    while operator.request(Request::Arm, Duration::from_secs(3)).is_err() {
        assert!(Instant::now() < limit, "the robot could not be armed");
    }
    judge.watch_until(Duration::from_secs(10), "moves", Heard::moves);
    judge.forget();
    let begin_ns = judge::now_ns();
    let stress = Stress::start(&place);
    let (mut last_number, mut health) = (0, Health::blank());
    let mut look = |wait: Duration| {
        let end = Instant::now() + wait;
        while Instant::now() < end {
            while let Some(cues) = status.cues() {
                last_number = last_number.max(cues.sequence);
            }
            while let Some(newest) = status.health() {
                health = newest;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    look(Duration::from_secs(seconds as u64));
    let end_ns = judge::now_ns();
    drop(stress);
    kill_process(Pid::from_child(&daemon.0), Signal::TERM).expect("signalled");
    look(Duration::from_millis(500));
    assert!(wait_for(&mut daemon.0, Duration::from_secs(5)).success());
    judge.look();
    let record = &judge.record;

    let (stale, oldest_ns) = stale_uses(record);
    let moving = record.heard.iter().filter(|heard| heard.moves()).count();
    let silence_ns = record.longest_silence_ns(begin_ns, end_ns);
    let missed = unaccounted(last_number, &health);
    let trials = record.heard.len();
    figure(25, "uses of data older than MAX_AGE", stale, "0", trials);
    figure(25, "oldest data used, ms", oldest_ns / MS, "<= 300", trials);
    figure(25, "longest silence of the controller, ms", silence_ns / MS, "<= 1000", trials);
    figure(25, "ping sets neither processed nor told as missed", missed, "0", last_number as usize + 1);
    figure(
        25,
        "ping sets late, and dropped for newer ones",
        format!("{}, {}", health.late_count, health.dropped_count),
        "told",
        last_number as usize + 1,
    );
    assert_eq!(stale, 0, "oldest {} ms", oldest_ns / MS);
    assert!(silence_ns <= DEAD_NS, "{} ms", silence_ns / MS);
    assert_eq!(missed, 0, "{last_number}: {} processed, {} dropped", health.ping_set_count, health.dropped_count);
    assert!(moving > 10, "{moving} of {trials}: a robot that never moves uses nothing");
}

#[test]
fn one_old_use_and_one_forgotten_ping_set_turn_the_judgement_red() {
    let fresh = Heard {
        at_ns: 1_000 * MS,
        sent_ns: 1_000 * MS,
        sequence: 1,
        linear_m_s: 0.2,
        angular_rad_s: 0.0,
        epoch: 1,
        command_sequence: 1,
        captured_ns: 700 * MS,
        state: judge::TRACK,
        reason: 0,
        daemon_state: 3,
    };
    let old = Heard { captured_ns: 700 * MS - 1, ..fresh };
    let standing = Heard { linear_m_s: 0.0, ..old };
    let count = |heard: &[Heard]| stale_uses(&Record { heard: heard.to_vec(), motors: Vec::new() }).0;
    assert_eq!((count(&[fresh]), count(&[fresh, old]), count(&[standing])), (0, 1, 0));
    let health = Health { ping_set_count: 90, dropped_count: 10, ..Health::blank() };
    assert_eq!((unaccounted(99, &health), unaccounted(100, &health), unaccounted(98, &health)), (0, 1, -1));
}
