//! Contract (checks 18 and 37): where shared memory, descriptors or disk do not suffice, a program says what it needs and what
//! there is, and ends at once; once started, nobody who fills the memory can end it.

mod checks;
mod crash_rig;
mod ipc_rig;
mod namespace;

use crash_rig::{Killed, appears, this_program, wait_at_most};
use iceoryx2::prelude::ZeroCopySend;
use ipc_rig::{Place, foreign_node};
use namespace::isolated;
use noctule::io::wire::message::{EnergyscapeHeader, VelocityCommand};
use noctule::io::wire::telemetry::{Cues, Health, PlatformVelocity};
use noctule::io::{ControllerTopics, DaemonTopics, Ipc, IpcParams, PlatformSubscriber};
use noctule::signal::{DaemonState, Reason};
use noctule::time::{Clock, SystemClock};
use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

const LIMIT: Duration = Duration::from_secs(1);
const DAEMON: &str = env!("CARGO_BIN_EXE_noctule");
const CONTROLLER: &str = env!("CARGO_BIN_EXE_noctule-controller");
/// Cells of a test's energyscape: several megabytes over a publisher's whole pool.
const CELLS: usize = 60_000;
/// Exit code of the shell for a process that a bus error ended.
const BUS_ERROR: i32 = 7;

/// Fills a file system to the last byte.
fn fill(folder: &str) {
    let mut file = File::create(Path::new(folder).join("filler")).expect("made");
    for size in [1 << 16, 1 << 12, 1] {
        let block = vec![0_u8; size];
        while file.write_all(&block).is_ok() {}
    }
}

fn free_up(folder: &str) {
    fs::remove_file(Path::new(folder).join("filler")).expect("removed");
}

/// Runs a program that is expected to refuse; its output and how long it took.
fn run(command: &mut Command) -> (Output, Duration) {
    let begun = Instant::now();
    let output = command.output().expect("started");
    (output, begun.elapsed())
}

/// The error lines of a program, without the other lines of its log.
fn complaints(output: &Output) -> Vec<String> {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    text.lines().filter(|line| !line.contains("INFO") && !line.contains("WARN")).map(str::to_owned).collect()
}

fn programs(place: &Place) -> [Command; 2] {
    let mut daemon = Command::new(DAEMON);
    daemon.args(["run", "--backend", "cpu", "--duration", "2"]).arg("--config").arg(place.config_file());
    let mut controller = Command::new(CONTROLLER);
    controller.arg("--config").arg(place.config_file());
    [daemon, controller]
}

#[test]
fn too_little_shared_memory_is_refused_with_73_naming_needed_and_free_bytes_within_a_second() {
    isolated("too_little_shared_memory_is_refused_with_73_naming_needed_and_free_bytes_within_a_second", "1m", || {
        let mut worst_ms = 0;
        let mut trials = 0;
        for full in [false, true] {
            if full {
                fill("/dev/shm");
            }
            let place = Place::new();
            for (index, mut program) in programs(&place).into_iter().enumerate() {
                // A mebibyte suffices for the controller.
                if index == 1 && !full {
                    continue;
                }
                let (output, took) = run(&mut program);
                let complaints = complaints(&output);
                assert_eq!(output.status.code(), Some(73), "{complaints:?}");
                assert_eq!(complaints.len(), 1, "{complaints:?}");
                let numbers: Vec<u64> = complaints[0].split(' ').filter_map(|word| word.parse().ok()).collect();
                assert!(
                    complaints[0].contains("/dev/shm") && numbers.len() == 2 && numbers[0] < numbers[1],
                    "{complaints:?}"
                );
                assert_eq!(place.left_behind(), Vec::<String>::new());
                worst_ms = worst_ms.max(took.as_millis());
                trials += 1;
            }
        }
        checks::figure(18, "start refused for too little shared memory", format!("{worst_ms} ms"), "73 <= 1 s", trials);
        assert!(worst_ms <= LIMIT.as_millis());
    });
}

#[test]
fn too_few_descriptors_are_refused_with_73_and_raised_where_the_system_allows_more() {
    let place = Place::new();
    let mut worst_ms = 0;
    for program in programs(&place) {
        let limited = |limits: &str| {
            let mut shell = Command::new("sh");
            shell
                .args(["-c", &format!("{limits} && exec \"$0\" \"$@\"")])
                .arg(program.get_program())
                .args(program.get_args());
            shell
        };
        let (output, took) = run(&mut limited("ulimit -n 32"));
        let complaints = complaints(&output);
        assert_eq!(output.status.code(), Some(73), "{complaints:?}");
        assert!(complaints.len() == 1 && complaints[0].contains("32 files open"), "{complaints:?}");
        worst_ms = worst_ms.max(took.as_millis());
    }
    checks::figure(18, "start refused for too few descriptors", format!("{worst_ms} ms"), "73 <= 1 s", 2);
    assert!(worst_ms <= LIMIT.as_millis());
    let [daemon, _] = programs(&place);
    let mut shell = Command::new("sh");
    shell.args(["-c", "ulimit -S -n 32 && exec \"$0\" \"$@\""]).arg(daemon.get_program()).args(daemon.get_args());
    let (output, _) = run(&mut shell);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

// ------------------------------------------------------------------------------------- memory that others fill later

fn place_of_a_child() -> Option<(PathBuf, IpcParams)> {
    let root = PathBuf::from(std::env::var_os("NOCTULE_TEST_ROOT")?);
    let prefix = std::env::var("NOCTULE_TEST_PREFIX").ok()?;
    Some((root.clone(), IpcParams { root: Some(root), prefix }))
}

/// Not a test of its own: a daemon that publishes its largest topics, every sample of its pools in turn, from when it is told that
/// the memory is full.
#[test]
fn publishing_daemon() {
    let Some((root, params)) = place_of_a_child() else { return };
    let ipc = Ipc::open(&params).expect("opened");
    let mut daemon = DaemonTopics::open(&ipc, &["front".to_owned()], &[CELLS]).expect("daemon");
    let controller = ControllerTopics::open(&ipc).expect("controller");
    let platform = PlatformSubscriber::open(&ipc).expect("platform");
    fs::write(root.with_extension("ready"), "").expect("told");
    assert!(appears(&root.with_extension("full"), Duration::from_secs(10)));
    let values: Vec<f32> = (0..CELLS).map(|cell| cell as f32).collect();
    for sequence in 0..100 {
        let now = SystemClock.now();
        let command = VelocityCommand::standstill(now, DaemonState::Ready, Reason::NotArmed);
        daemon.publish_command(command, now).expect("published");
        daemon
            .publish_energyscape(0, &EnergyscapeHeader { sequence, ..EnergyscapeHeader::blank() }, &values)
            .expect("published");
        daemon.publish_cues(Cues::blank()).expect("published");
        daemon.publish_health(Health::blank()).expect("published");
        controller.publish_platform(PlatformVelocity::blank()).expect("published");
        assert!(controller.next_command().is_some() && platform.newest().is_some(), "{sequence}");
    }
}

/// Not a test of its own: the negative control, the transport alone with the same load and no page reserved.
#[test]
fn publishing_library() {
    let Some((root, params)) = place_of_a_child() else { return };
    let node = foreign_node(&root, &params.prefix);
    let service =
        node.service_builder(&"bare".try_into().expect("name")).publish_subscribe::<Large>().create().expect("made");
    let publisher = service.publisher_builder().create().expect("publisher");
    let subscriber = service.subscriber_builder().create().expect("subscriber");
    fs::write(root.with_extension("ready"), "").expect("told");
    assert!(appears(&root.with_extension("full"), Duration::from_secs(10)));
    for _ in 0..100 {
        publisher.send_copy(Large([1; 60_000])).expect("sent");
        assert!(subscriber.receive().expect("received").is_some());
    }
}

#[repr(C)]
#[derive(Debug, Clone, Copy, ZeroCopySend)]
struct Large([u32; 60_000]);

/// Starts a publisher, fills the memory when it is ready, and gives what became of it.
fn publish_in_full_memory(publisher: &str) -> std::process::ExitStatus {
    let place = Place::new();
    let mut child = Killed(this_program(&place, publisher).spawn().expect("started"));
    assert!(appears(&place.root().with_extension("ready"), Duration::from_secs(5)), "{publisher} does not start");
    fill("/dev/shm");
    fs::write(place.root().with_extension("full"), "").expect("told");
    let status = wait_at_most(&mut child, Duration::from_secs(20));
    free_up("/dev/shm");
    status.expect("ends")
}

#[test]
fn who_fills_shared_memory_after_the_start_ends_no_publisher() {
    isolated("who_fills_shared_memory_after_the_start_ends_no_publisher", "32m", || {
        use std::os::unix::process::ExitStatusExt;
        let trials = checks::trials(30, 3);
        let failed = (0..trials).filter(|_| !publish_in_full_memory("publishing_daemon").success()).count();
        let control = publish_in_full_memory("publishing_library");
        checks::figure(18, "publishers ended by memory filled after their start", failed, "0 bus errors", trials);
        checks::figure(18, "negative control: the transport without reserved pages", control, "a bus error", 1);
        assert_eq!(failed, 0);
        assert_eq!(control.signal(), Some(BUS_ERROR));
    });
}

/// A client that comes when the memory is full is refused; it neither dies by a bus error nor takes the daemon with it.
#[test]
fn a_client_that_comes_when_memory_is_full_is_refused_and_the_daemon_goes_on() {
    isolated("a_client_that_comes_when_memory_is_full_is_refused_and_the_daemon_goes_on", "32m", || {
        let place = Place::new();
        let mut child = Killed(this_program(&place, "publishing_daemon").spawn().expect("started"));
        assert!(appears(&place.root().with_extension("ready"), Duration::from_secs(5)));
        fill("/dev/shm");
        let error = PlatformSubscriber::open(&place.ipc).map(drop).expect_err("refused");
        assert_eq!(error.exit_code(), 73, "{error}");
        fs::write(place.root().with_extension("full"), "").expect("told");
        assert!(wait_at_most(&mut child, Duration::from_secs(20)).is_some_and(|status| status.success()));
    });
}
