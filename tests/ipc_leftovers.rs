//! Contract: whatever a killed daemon left behind, whole or with a file of any kind emptied, cut or overwritten, the next
//! start heals it, or ends with 75 naming root and prefix; it never hangs and never half succeeds.

mod ipc_rig;

use ipc_rig::{Place, files_below, shared_memory_files};
use noctule::io::wire::message::VelocityCommand;
use noctule::io::{ControllerTopics, DaemonTopics, Ipc, IpcError, IpcParams};
use noctule::signal::{DaemonState, Reason};
use noctule::time::{Clock, SystemClock};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// The safe-state contract's limit for a start on crash left-overs.
const LIMIT: Duration = Duration::from_secs(5);

fn sensors() -> Vec<String> {
    vec!["front".to_owned()]
}

fn open(ipc: &Ipc) -> Result<DaemonTopics, IpcError> {
    DaemonTopics::open(ipc, &sensors(), &[35])
}

/// Not a test of its own: the daemon that the tests below kill; they start this very program with these variables set.
#[test]
fn daemon_process() {
    let (Some(root), Ok(prefix)) =
        (std::env::var_os("NOCTULE_TEST_ROOT").map(PathBuf::from), std::env::var("NOCTULE_TEST_PREFIX"))
    else {
        return;
    };
    let ipc = Ipc::open(&IpcParams { root: Some(root.clone()), prefix }).expect("opened");
    let _topics = open(&ipc).expect("daemon");
    fs::write(root.with_extension("ready"), "").expect("told");
    std::thread::sleep(Duration::from_secs(60));
}

/// A place where a daemon was just killed.
fn place_of_a_killed_daemon() -> Place {
    let place = Place::new();
    let mut daemon = Command::new(std::env::current_exe().expect("this program"))
        .args(["--exact", "daemon_process", "--test-threads", "1", "--quiet"])
        .env("NOCTULE_TEST_ROOT", place.root())
        .env("NOCTULE_TEST_PREFIX", &place.params.prefix)
        .stdout(Stdio::null())
        .spawn()
        .expect("daemon process");
    let deadline = Instant::now() + LIMIT;
    while !place.root().with_extension("ready").exists() {
        assert!(Instant::now() < deadline, "the daemon does not start");
        std::thread::sleep(Duration::from_millis(2));
    }
    daemon.kill().expect("killed");
    daemon.wait().expect("gone");
    place
}

fn kind(path: &Path) -> String {
    path.extension().map_or_else(String::new, |extension| extension.to_string_lossy().into_owned())
}

/// The files of the dead daemon, without our own lock and the management segment that all users of a prefix share.
fn left_by_the_dead(place: &Place) -> Vec<PathBuf> {
    let mut paths = Vec::new();
    files_below(&place.root(), &mut paths);
    let mut paths: Vec<PathBuf> = paths.into_iter().map(PathBuf::from).collect();
    paths.extend(shared_memory_files(&place.params.prefix).into_iter().map(|name| Path::new("/dev/shm").join(name)));
    paths.retain(|path| !["lock", "global_mgmt"].contains(&kind(path).as_str()));
    paths
}

/// A command gets through.
fn works(place: &Place, daemon: &mut DaemonTopics) {
    let controller = ControllerTopics::open(&place.ipc).expect("controller");
    let now = SystemClock.now();
    let command = VelocityCommand::standstill(now, DaemonState::Ready, Reason::NotArmed);
    daemon.publish_command(command, now).expect("published");
    assert!(controller.next_command().is_some());
}

/// Starts on what is there; says how that went.
fn start(place: &Place, what: &str) -> String {
    let begun = Instant::now();
    let opened = open(&place.ipc);
    let took = begun.elapsed();
    assert!(took <= LIMIT, "{what}: {took:?}");
    match opened {
        Ok(mut daemon) => {
            works(place, &mut daemon);
            format!("{what}: healed in {} ms", took.as_millis())
        }
        Err(error) => {
            assert_eq!(error.exit_code(), 75, "{what}: {error}");
            assert!(error.to_string().contains(&place.params.prefix), "{error}");
            format!("{what}: 75 after {} ms", took.as_millis())
        }
    }
}

#[test]
fn what_a_killed_daemon_left_is_healed() {
    let place = place_of_a_killed_daemon();
    assert!(left_by_the_dead(&place).len() > 10);
    let told = start(&place, "killed");
    assert!(told.contains("healed"), "{told}");
    assert_eq!(place.left_behind(), Vec::<String>::new());
}

#[test]
fn a_spoilt_file_of_any_kind_is_healed_or_ends_with_75_in_time() {
    let kinds: std::collections::BTreeSet<String> =
        left_by_the_dead(&place_of_a_killed_daemon()).iter().map(|path| kind(path)).collect();
    assert!(kinds.len() >= 5, "{kinds:?}");
    let told: Vec<String> = kinds.iter().flat_map(|kind| spoil_every_way(kind)).collect();
    eprintln!("{}", told.join("\n"));
}

fn spoil_every_way(spoilt: &str) -> Vec<String> {
    let ways: [(&str, fn(&[u8]) -> Vec<u8>); 3] = [
        ("emptied", |_| Vec::new()),
        ("cut", |content| content[..content.len() / 2].to_vec()),
        ("overwritten", |content| vec![0xa5; content.len()]),
    ];
    ways.iter()
        .map(|(way, spoil)| {
            let place = place_of_a_killed_daemon();
            for path in left_by_the_dead(&place).iter().filter(|path| kind(path) == spoilt) {
                let content = fs::read(path).expect("readable");
                fs::write(path, spoil(&content)).expect("spoilt");
            }
            start(&place, &format!("{spoilt} {way}"))
        })
        .collect()
}

#[test]
fn after_the_supervisors_wipe_the_next_start_works() {
    let place = Place::new();
    let daemon = open(&place.ipc).expect("daemon");
    fs::remove_dir_all(place.root()).expect("wiped");
    for name in shared_memory_files(&place.params.prefix) {
        fs::remove_file(Path::new("/dev/shm").join(name)).expect("wiped");
    }
    assert!(!daemon.is_intact(), "a daemon whose root went notices");
    let again = Ipc::open(&place.params).expect("made again");
    let second = open(&again);
    assert!(second.is_ok(), "{:?}", second.map(drop));
}
