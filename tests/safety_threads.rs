//! Contract (check 24): a panic or an early return in any thread of daemon or controller ends the whole process with 70 within 200 ms,
//! and the robot stands within Z2; a log that nobody reads changes nothing. The threads are those that the kernel lists.

mod checks;
mod ipc_rig;
mod judge;
mod life_rig;

use checks::{figure, trials};
use ipc_rig::MS;
use judge::now_ns;
use life_rig::stand_in::{self, Fault};
use life_rig::{Fate, Life, SOON, Shim, assert_z2, blocked_pipe, in_ms, stopped, threads};
use rustix::process::Signal;
use std::time::Duration;
use tempfile::TempDir;

/// Time after which every silent fault must have been answered.
const AFTERMATH: Duration = Duration::from_millis(450);

/// Which process a thread belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Of {
    Daemon,
    Controller,
}

/// How a panic of a thread is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Tried {
    /// Here, in the real process.
    Here,
    /// By a unit test in the file that starts the thread, in a process of its own.
    In(&'static str),
}

/// Every thread of the two processes, by its name in the kernel, and where its panic is tried. A new thread needs a new line.
const THREADS: [(Of, &str, Tried); 13] = [
    (Of::Daemon, "noctule", Tried::Here),
    (Of::Daemon, "noctule-acquire", Tried::Here),
    (Of::Daemon, "noctule-decide", Tried::Here),
    (Of::Daemon, "noctule-detect", Tried::Here),
    (Of::Daemon, "log", Tried::In("src/life/log_queue.rs")),
    (Of::Daemon, "imaging-", Tried::In("src/imaging/cpu/pool.rs")),
    // The watches over the transport's calls, one a set-up; the controller's has the name of its main thread.
    (Of::Daemon, "noctule-daemon", Tried::In("src/life/panic.rs")),
    (Of::Daemon, "noctule-detecto", Tried::In("src/life/panic.rs")),
    (Of::Daemon, "noctule-input w", Tried::In("src/life/panic.rs")),
    (Of::Daemon, "noctule-platfor", Tried::In("src/life/panic.rs")),
    (Of::Controller, "noctule-control", Tried::Here),
    (Of::Controller, "reporter", Tried::Here),
    (Of::Controller, "log", Tried::In("src/life/log_queue.rs")),
];

#[test]
fn judge_process() {
    judge::serve_if_asked();
}

#[test]
fn stand_in_process() {
    stand_in::serve_if_asked();
}

/// Names without the number that a thread of a pool has.
fn kinds(process_id: u32) -> Vec<String> {
    let mut kinds: Vec<String> = threads(process_id)
        .into_iter()
        .map(|name| if name.starts_with("imaging-") { "imaging-".to_owned() } else { name })
        .collect();
    kinds.dedup();
    kinds
}

fn expected(of: Of) -> Vec<String> {
    let mut names: Vec<String> =
        THREADS.iter().filter(|(owner, ..)| *owner == of).map(|(_, name, _)| (*name).to_owned()).collect();
    names.sort();
    names
}

#[test]
fn every_thread_that_the_kernel_lists_has_its_line_here_and_its_test() {
    let mut life = Life::new();
    life.drive(0);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut daemon = kinds(life.daemon.id());
    if cores == 1 {
        daemon.push("imaging-".to_owned());
        daemon.sort();
    }
    assert_eq!(daemon, expected(Of::Daemon), "a thread of the daemon without a test");
    assert_eq!(kinds(life.controller.id()), expected(Of::Controller), "a thread of the controller without a test");
    for (_, name, tried) in THREADS {
        if let Tried::In(file) = tried {
            let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
            let source = std::fs::read_to_string(path).expect("source");
            assert!(source.contains("ends_the_process_with_70"), "{name}: {file} has no test of its panic");
        }
    }
    figure(24, "threads with a test of their panic, of those that run", format!("{0} of {0}", THREADS.len()), "all", 1);
}

#[test]
fn a_panic_in_any_thread_ends_the_process_with_70_in_200_ms_and_the_robot_stands() {
    let here: Vec<(Of, &str)> =
        THREADS.iter().filter(|(_, _, tried)| *tried == Tried::Here).map(|(of, name, _)| (*of, *name)).collect();
    let count = trials(30, 1) * here.len();
    let (mut worst_zero_ns, mut worst_end_ns, mut worst_stand_ns) = (0, 0, 0);
    for trial in 0..count {
        let (of, name) = here[trial % here.len()];
        let directory = TempDir::new().expect("directory");
        let shim = Shim::new(directory.path());
        let mut life = match of {
            Of::Daemon => Life::with(|command| shim.load(command), |command| command),
            Of::Controller => Life::with(|command| command, |command| shim.load(command)),
        };
        life.drive(trial);
        shim.strike(name, Fate::Panic);
        let struck_ns = shim.struck_at(SOON);
        let process = if of == Of::Daemon { &mut life.daemon } else { &mut life.controller };
        let (ended_ns, status) = process.ended_at(SOON);
        assert_eq!(status.code(), Some(70), "{name}: {status}");
        worst_end_ns = worst_end_ns.max(ended_ns.saturating_sub(struck_ns));
        life.judge.watch_for(AFTERMATH);
        let stand_ns = life.judge.record.motors_stand_at(struck_ns).expect("the base stands");
        worst_stand_ns = worst_stand_ns.max(stand_ns.saturating_sub(struck_ns));
        if of == Of::Daemon {
            let stop = stopped(&life.judge.record, struck_ns);
            assert_z2(&stop, trial);
            worst_zero_ns = worst_zero_ns.max(stop.after_capture_ns);
        }
        assert!(ended_ns.saturating_sub(struck_ns) <= 200 * MS, "{name}: {}", in_ms(ended_ns - struck_ns));
        assert!(stand_ns.saturating_sub(struck_ns) <= 350 * MS, "{name}: the base drives on");
    }
    figure(24, "panic in a thread to the end of its process", in_ms(worst_end_ns), "<= 200 ms, exit 70", count);
    figure(24, "last capture to zero, panic in a thread of the daemon", in_ms(worst_zero_ns), "<= 350 ms", count);
    figure(24, "panic in any thread to standing motors", in_ms(worst_stand_ns), "<= 350 ms", count);
}

/// A thread that is gone without a panic, as after a fault in a foreign library: nobody is told, the watching thread must miss it.
#[test]
fn a_thread_that_vanishes_ends_the_process_with_70_within_two_seconds_and_the_robot_stands() {
    let names = ["noctule-acquire", "noctule-decide"];
    let count = trials(30, 2);
    let (mut worst_zero_ns, mut worst_end_ns) = (0, 0);
    for trial in 0..count {
        let directory = TempDir::new().expect("directory");
        let shim = Shim::new(directory.path());
        let mut life = Life::with(|command| shim.load(command), |command| command);
        life.drive(trial);
        shim.strike(names[trial % 2], Fate::Vanish);
        let struck_ns = shim.struck_at(SOON);
        life.judge.watch_for(AFTERMATH);
        let stop = stopped(&life.judge.record, struck_ns);
        let (ended_ns, status) = life.daemon.ended_at(SOON);
        assert_eq!(status.code(), Some(70), "{}", names[trial % 2]);
        worst_zero_ns = worst_zero_ns.max(stop.after_capture_ns);
        worst_end_ns = worst_end_ns.max(ended_ns - struck_ns);
    }
    figure(24, "last capture to zero, a thread vanishes", in_ms(worst_zero_ns), "<= 350 ms", count);
    figure(24, "a thread vanishes to the end of the process", in_ms(worst_end_ns), "<= 2 s, exit 70", count);
    assert!(worst_zero_ns <= 350 * MS && worst_end_ns <= 2_000 * MS);
}

#[test]
fn a_source_that_fails_or_ends_ends_the_process_with_zero_first() {
    let count = trials(30, 2);
    let (mut worst_zero_ns, mut worst_end_ns) = (0, 0);
    for trial in 0..count {
        let (fault, code) = if trial.is_multiple_of(2) { (Fault::SourceFails, 65) } else { (Fault::SourceEnds, 0) };
        let mut life = Life::with_stand_in(fault);
        life.drive(trial);
        std::fs::write(stand_in::trigger(&life.place), "").expect("triggered");
        let struck_ns = now_ns();
        let (ended_ns, status) = life.daemon.ended_at(SOON);
        assert_eq!(status.code(), Some(code), "{fault:?}");
        life.judge.watch_for(AFTERMATH);
        let stop = stopped(&life.judge.record, struck_ns);
        worst_zero_ns = worst_zero_ns.max(stop.after_fault_ns);
        worst_end_ns = worst_end_ns.max(ended_ns - struck_ns);
    }
    // The source looks at the trigger once in 20 ms.
    figure(24, "early return of the acquiring thread to zero", in_ms(worst_zero_ns), "<= 150 ms", count);
    figure(
        24,
        "early return of the acquiring thread to the end of the process",
        in_ms(worst_end_ns),
        "<= 200 ms",
        count,
    );
    assert!(worst_zero_ns <= 150 * MS && worst_end_ns <= 200 * MS);
}

#[test]
fn a_log_that_nobody_reads_changes_nothing_for_daemon_or_controller() {
    let (reader, writer) = blocked_pipe();
    let (for_daemon, for_controller) = (writer.try_clone().expect("pipe"), writer);
    let mut life =
        Life::with(|command| command.arg("-vv").stderr(for_daemon), |command| command.stderr(for_controller));
    life.drive(0);
    life.judge.forget();
    let began_ns = now_ns();
    life.judge.watch_for(Duration::from_secs(3));
    let silence_ns = life.judge.record.longest_silence_ns(began_ns, now_ns());
    let held = life.judge.record.since(began_ns).filter(|heard| heard.state != judge::TRACK).count();
    figure(24, "longest silence of the controller while both logs are blocked", in_ms(silence_ns), "<= 100 ms", 1);
    assert!(silence_ns <= 100 * MS);
    assert_eq!(held, 0, "the robot stopped because of a log");
    for process in [&mut life.daemon, &mut life.controller] {
        let asked_ns = now_ns();
        process.signal(Signal::TERM);
        let (ended_ns, status) = process.ended_at(SOON);
        assert_eq!(status.code(), Some(0));
        assert!(ended_ns - asked_ns <= 1_000 * MS, "{}", in_ms(ended_ns - asked_ns));
    }
    drop(reader);
}

#[test]
fn a_panic_ends_a_process_whose_log_is_blocked_too() {
    let directory = TempDir::new().expect("directory");
    let shim = Shim::new(directory.path());
    let (reader, writer) = blocked_pipe();
    let mut life = Life::with(|command| shim.load(command).stderr(writer), |command| command);
    life.drive(0);
    shim.strike("noctule-decide", Fate::Panic);
    let struck_ns = shim.struck_at(SOON);
    let (ended_ns, status) = life.daemon.ended_at(SOON);
    assert_eq!(status.code(), Some(70));
    assert!(ended_ns - struck_ns <= 200 * MS, "{}", in_ms(ended_ns - struck_ns));
    drop(reader);
}
