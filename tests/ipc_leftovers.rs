//! Contract: whatever a killed daemon left behind, whole or with a file of any kind emptied, cut or overwritten, the next
//! start heals it, or ends with 75 naming root and prefix; it never hangs and never half succeeds.

mod ipc_rig;

use ipc_rig::{Place, files_below, foreign_node, shared_memory_files, wait_for};
use noctule::io::wire::message::VelocityCommand;
use noctule::io::{ControllerTopics, DaemonTopics, Ipc, IpcError, IpcParams, wipe};
use noctule::signal::{DaemonState, Reason};
use noctule::time::{Clock, SystemClock};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The safe-state contract's limit for a start on crash left-overs.
const LIMIT: Duration = Duration::from_secs(5);

fn sensors() -> Vec<String> {
    vec!["front".to_owned()]
}

fn open(ipc: &Ipc) -> Result<DaemonTopics, IpcError> {
    DaemonTopics::open(ipc, &sensors(), &[35])
}

/// Where a child of this program has its topics; none in the program that the test runner started.
fn place_of_a_child() -> Option<(PathBuf, IpcParams)> {
    let root = PathBuf::from(std::env::var_os("NOCTULE_TEST_ROOT")?);
    let prefix = std::env::var("NOCTULE_TEST_PREFIX").ok()?;
    Some((root.clone(), IpcParams { root: Some(root), prefix }))
}

/// Starts this very program for one of the two tests that are none of their own.
fn child(place: &Place, test: &str) -> Child {
    Command::new(std::env::current_exe().expect("this program"))
        .args(["--exact", test, "--test-threads", "1", "--quiet"])
        .env("NOCTULE_TEST_ROOT", place.root())
        .env("NOCTULE_TEST_PREFIX", &place.params.prefix)
        .stdout(Stdio::null())
        .spawn()
        .expect("child")
}

/// Not a test of its own: the daemon that the tests below kill.
#[test]
fn daemon_process() {
    let Some((root, params)) = place_of_a_child() else { return };
    let ipc = Ipc::open(&params).expect("opened");
    let _topics = open(&ipc).expect("daemon");
    fs::write(root.with_extension("ready"), "").expect("told");
    std::thread::sleep(Duration::from_secs(60));
}

/// Not a test of its own: a start on what is there. In a process of its own, because a start that is given up leaves a thread
/// behind that waits in the transport, and would make files again in a directory that has gone.
#[test]
fn starting_process() {
    let Some((root, params)) = place_of_a_child() else { return };
    fs::write(root.with_extension("told"), start(&params)).expect("told");
}

/// A place where a daemon was just killed.
fn place_of_a_killed_daemon() -> Place {
    let place = Place::new();
    let mut daemon = child(&place, "daemon_process");
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
fn works(ipc: &Ipc, daemon: &mut DaemonTopics) {
    let controller = ControllerTopics::open(ipc).expect("controller");
    let now = SystemClock.now();
    let command = VelocityCommand::standstill(now, DaemonState::Ready, Reason::NotArmed);
    daemon.publish_command(command, now).expect("published");
    assert!(controller.next_command().is_some());
}

/// Starts on what is there; says how that went.
fn start(params: &IpcParams) -> String {
    let ipc = Ipc::open(params).expect("opened");
    let begun = Instant::now();
    let opened = open(&ipc);
    let took = begun.elapsed();
    assert!(took <= LIMIT, "{took:?}");
    match opened {
        Ok(mut daemon) => {
            works(&ipc, &mut daemon);
            format!("healed in {} ms", took.as_millis())
        }
        Err(error) => {
            assert_eq!(error.exit_code(), 75, "{error}");
            assert!(error.to_string().contains(&params.prefix), "{error}");
            format!("75 after {} ms", took.as_millis())
        }
    }
}

/// The same in a child; panics unless it ends well.
fn start_in_a_child(place: &Place, what: &str) -> String {
    let status = wait_for(&mut child(place, "starting_process"), 3 * LIMIT);
    assert!(status.success(), "{what}: {status}");
    let told = fs::read_to_string(place.root().with_extension("told")).expect("told");
    format!("{what}: {told}")
}

#[test]
fn what_a_killed_daemon_left_is_healed() {
    let place = place_of_a_killed_daemon();
    assert!(left_by_the_dead(&place).len() > 10);
    let told = start_in_a_child(&place, "killed");
    assert!(told.contains("healed"), "{told}");
    assert_eq!(place.left_behind(), Vec::<String>::new());
}

/// A client of another language is registered in several steps; a start of ours in between must not take its files for those of
/// the dead. Its first file is planted here and the rest follows while our start looks.
#[test]
fn files_of_a_client_that_is_just_starting_are_left_alone() {
    let place = Place::new();
    let folder = place.root().join("nodes/77");
    let first = folder.join(format!("{}details", place.params.prefix));
    fs::create_dir_all(&folder).expect("made");
    fs::write(&first, "half a registration").expect("written");
    let (root, prefix) = (place.root(), place.params.prefix.clone());
    let rest = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(30));
        foreign_node(&root, &prefix)
    });
    let mut daemon = open(&place.ipc).expect("daemon");
    let client = rest.join().expect("the client is registered");
    assert!(first.exists(), "a living client's file was removed");
    works(&place.ipc, &mut daemon);
    drop((daemon, client));

    // The negative control: with nobody coming to life the same file goes.
    let _daemon = open(&place.ipc).expect("daemon");
    assert!(!first.exists(), "what the dead left was kept");
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
            start_in_a_child(&place, &format!("{spoilt} {way}"))
        })
        .collect()
}

#[test]
fn after_the_supervisors_wipe_the_next_start_works() {
    let place = Place::new();
    let daemon = open(&place.ipc).expect("daemon");
    assert_eq!(wipe(&place.params).expect_err("a daemon lives").exit_code(), 69);
    fs::remove_dir_all(place.root()).expect("deleted");
    for name in shared_memory_files(&place.params.prefix) {
        fs::remove_file(Path::new("/dev/shm").join(name)).expect("deleted");
    }
    assert!(!daemon.is_intact(), "a daemon whose root went notices");
    let refused = Ipc::open(&place.params).and_then(|ipc| open(&ipc)).map(drop).expect_err("two daemons");
    assert_eq!(refused.exit_code(), 69, "{refused}");
    drop(daemon);
    wipe(&place.params).expect("wiped");
    let again = Ipc::open(&place.params).expect("made again");
    let second = open(&again);
    assert!(second.is_ok(), "{:?}", second.map(drop));
}
