//! Contract (check 20): where root or shared memory is deleted under a living daemon and controller, the robot stands within
//! 1.4 s, both end with 75, and no second daemon starts beside the first.

mod checks;
mod ipc_rig;
mod namespace;

use ipc_rig::{Base, Controller, FakeDaemon, MS, Place, is, moves, shared_memory_files, wait_for};
use namespace::isolated;
use noctule::io::{DaemonTopics, Ipc};
use noctule::signal::GateState;
use noctule::time::{Clock, SystemClock};
use std::fs;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// The self-probe's second, a period of the robot's commands, and the controller's limit for a detected fault.
const STAND_LIMIT_NS: u64 = 1_400 * MS;
const SOON: Duration = Duration::from_secs(10);

/// What is deleted.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Deleted {
    Root,
    SharedMemory,
    Both,
}

fn delete(place: &Place, what: Deleted) {
    if what != Deleted::SharedMemory {
        fs::remove_dir_all(place.root()).expect("deleted");
    }
    if what != Deleted::Root {
        for name in shared_memory_files(&place.params.prefix) {
            fs::remove_file(format!("/dev/shm/{name}")).expect("deleted");
        }
    }
}

fn daemon(place: &Place) -> Child {
    Command::new(env!("CARGO_BIN_EXE_noctule"))
        .args(["--quiet", "run", "--source", "sim", "--backend", "cpu", "--config"])
        .arg(place.config_file())
        .stderr(Stdio::null())
        .spawn()
        .expect("daemon")
}

/// Deletes files under a driving pair; from the deletion to standing still, in ns.
fn trial(what: Deleted, phase: Duration) -> u64 {
    let place = Place::new();
    let mut first = daemon(&place);
    let mut controller = Controller::start(&place, &["--arm"]);
    let mut base = Base::new(&place);
    base.listen_until(SOON, || (), |sample| is(sample, GateState::Track) && moves(sample));
    base.listen_for(phase, || ());
    let deleted_ns = SystemClock.now().boottime_ns;
    delete(&place, what);
    // In this process: a program of its own might be so slow to start that the first has gone by then.
    let second = || Ipc::open(&place.params).and_then(|ipc| DaemonTopics::open(&ipc, &["front".to_owned()], &[35]));
    let refused = second().map(drop).expect_err("a second daemon beside the first");
    assert!(first.try_wait().expect("waited").is_none(), "the first still lived");
    assert_eq!(refused.exit_code(), 69, "{what:?}: {refused}");
    base.listen_for(Duration::from_millis(1_700), || ());
    let standing_ns = base.standing_since(deleted_ns).expect("stands");
    assert_eq!(wait_for(&mut first, SOON).code(), Some(75), "{what:?}: the daemon");
    assert_eq!(controller.wait(SOON).code(), Some(75), "{what:?}: the controller");
    // In the order that a supervisor does it: the old ones are gone, all is wiped, new ones start.
    drop(base);
    noctule::io::wipe(&place.params).expect("wiped");
    standing_ns - deleted_ns
}

#[test]
fn files_deleted_under_a_driving_pair_stop_the_robot_in_time_and_never_make_two_commanders() {
    isolated("files_deleted_under_a_driving_pair_stop_the_robot_in_time_and_never_make_two_commanders", "256m", || {
        let trials = checks::trials(30, 3);
        let kinds = [Deleted::Root, Deleted::SharedMemory, Deleted::Both];
        let waits = (0..trials).map(|trial| (kinds[trial % 3], Duration::from_millis(trial as u64 * 137 % 1_000)));
        let worst_ns = waits.map(|(what, phase)| trial(what, phase)).max().unwrap_or(u64::MAX);
        checks::figure(20, "files deleted, to zero at the output", format!("{} ms", worst_ns / MS), "<= 1.4 s", trials);
        checks::figure(20, "second daemons beside the first", 0, "0 split brain", trials);
        assert!(worst_ns <= STAND_LIMIT_NS, "{worst_ns} ns");
    });
}

/// Negative control: what the transport alone does, without lock and probe.
#[test]
fn without_our_lock_the_transport_lets_two_sole_commanders_live() {
    isolated("without_our_lock_the_transport_lets_two_sole_commanders_live", "64m", || {
        let place = Place::new();
        let mut first = FakeDaemon::new(&place.root(), &place.params.prefix, 1);
        delete(&place, Deleted::Both);
        fs::create_dir(place.root()).expect("made");
        let mut second = FakeDaemon::new(&place.root(), &place.params.prefix, 2);
        first.send(|_| {});
        second.send(|_| {});
        checks::figure(20, "negative control: sole commanders alive after the deletion, transport alone", 2, "two", 1);
    });
}
