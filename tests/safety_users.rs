//! Contract (check 34): no other user can lead, read or disturb the processes: a root or file that is not ours alone ends them with
//! 77, nothing of ours has a bit for others, and a planted configuration of the transport is ignored.

mod checks;
mod ipc_rig;
mod namespace;

use ipc_rig::{Base, Controller, Place, files_below, foreign_node, shared_memory_files};
use namespace::isolated;
use noctule::io::{ControllerTopics, DaemonTopics, InputPublisher, StatusTopics};
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;

/// A user that owns nothing.
const NOBODY: u32 = 65_534;
const SOON: Duration = Duration::from_secs(5);

/// A configuration that everybody can read.
fn readable_config(root: &Path, prefix: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("{prefix}robot.toml"));
    fs::write(&path, format!("[ipc]\nroot = {root:?}\nprefix = {prefix:?}\n")).expect("written");
    fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).expect("readable");
    path
}

/// Both programs with a configuration, to be run by this user or another.
fn programs(config: &Path, uid: Option<u32>) -> [Command; 2] {
    let make = |program: &str, arguments: &[&str]| {
        let mut command = match uid {
            None => Command::new(program),
            Some(uid) => {
                let mut command = Command::new("setpriv");
                command.args([&format!("--reuid={uid}"), &format!("--regid={uid}"), "--clear-groups", "--", program]);
                command
            }
        };
        command.args(arguments).arg("--config").arg(config);
        command
    };
    [
        make(env!("CARGO_BIN_EXE_noctule"), &["run", "--backend", "cpu", "--duration", "1"]),
        make(env!("CARGO_BIN_EXE_noctule-controller"), &[]),
    ]
}

/// Both programs must refuse with 77 and one line that names `path`.
fn assert_refused(config: &Path, uid: Option<u32>, path: &Path) {
    for mut program in programs(config, uid) {
        let Output { status, stderr, .. } = program.output().expect("started");
        let text = String::from_utf8_lossy(&stderr).into_owned();
        assert_eq!(status.code(), Some(77), "{program:?}: {text}");
        let complaints: Vec<&str> =
            text.lines().filter(|line| !line.contains("INFO") && !line.contains("WARN")).collect();
        assert!(complaints.len() == 1 && complaints[0].contains(&*path.to_string_lossy()), "{complaints:?}");
    }
}

/// Whether processes of other users can be had here: not in a user namespace, which has one user.
fn other_users() -> bool {
    let tried = Command::new("setpriv").args([&format!("--reuid={NOBODY}"), "--clear-groups", "true"]).output();
    let possible = tried.is_ok_and(|output| output.status.success());
    if !possible {
        let required = std::env::var("NOCTULE_REQUIRE_NAMESPACES").as_deref() == Ok("1");
        assert!(!required || !rustix::process::geteuid().is_root(), "setpriv is missing");
        println!("!! LEFT OUT: only root can start processes of another user");
    }
    possible
}

#[test]
fn a_root_that_is_not_ours_alone_ends_both_programs_with_77_naming_it() {
    isolated("a_root_that_is_not_ours_alone_ends_both_programs_with_77_naming_it", "256m", || {
        let place = Place::new();
        let directory = place.directory.path();
        let mode = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("changed");
        let mut refused = 0;
        let mut check = |root: &Path, uid: Option<u32>| {
            assert_refused(&readable_config(root, &place.params.prefix), uid, root);
            refused += 2;
        };
        for (name, bits) in [("everybody", 0o777), ("group", 0o770), ("sticky", 0o1777)] {
            let root = directory.join(name);
            fs::create_dir(&root).expect("made");
            mode(&root, bits);
            check(&root, None);
        }
        let target = directory.join("target");
        fs::create_dir(&target).expect("made");
        mode(&target, 0o700);
        let link = directory.join("link");
        symlink(&target, &link).expect("linked");
        check(&link, None);
        let replaceable = directory.join("replaceable");
        fs::create_dir(&replaceable).expect("made");
        mode(&replaceable, 0o777);
        check(&replaceable.join("root"), None);
        if other_users() {
            let foreign = directory.join("foreign");
            fs::create_dir(&foreign).expect("made");
            mode(&foreign, 0o700);
            chown(&foreign, Some(NOBODY), Some(NOBODY)).expect("given away");
            check(&foreign, None);
            // The same from the other side: another user and a root of ours.
            check(&place.root(), Some(NOBODY));
        }
        checks::figure(34, "roots that are not ours alone", format!("{refused} starts, all 77"), "exit 77", refused);
    });
}

#[test]
fn shared_memory_that_another_user_put_in_our_place_ends_both_programs_with_77_naming_it() {
    isolated("shared_memory_that_another_user_put_in_our_place_ends_both_programs_with_77_naming_it", "256m", || {
        if !other_users() {
            return;
        }
        let place = Place::new();
        drop(foreign_node(&place.root(), &place.params.prefix));
        let names = shared_memory_files(&place.params.prefix);
        let planted = Path::new("/dev/shm").join(names.first().expect("the management segment"));
        chown(&planted, Some(NOBODY), Some(NOBODY)).expect("given away");
        assert_refused(&readable_config(&place.root(), &place.params.prefix), None, &planted);
        assert!(planted.exists(), "it is not ours to remove");
        checks::figure(34, "management segment of another user", "2 starts, both 77", "exit 77", 2);
    });
}

/// Files and folders of this place on which others have a right.
fn open_to_others(place: &Place) -> Vec<String> {
    let mut paths = Vec::new();
    files_below(&place.root(), &mut paths);
    let mut paths: Vec<PathBuf> = paths.into_iter().map(PathBuf::from).collect();
    let folders: Vec<PathBuf> = paths.iter().filter_map(|path| path.parent().map(Path::to_owned)).collect();
    paths.extend(folders);
    paths.extend(shared_memory_files(&place.params.prefix).into_iter().map(|name| Path::new("/dev/shm").join(name)));
    paths.push(place.root());
    paths.sort();
    paths.dedup();
    let mode = |path: &Path| fs::symlink_metadata(path).map_or(0, |metadata| metadata.mode() & 0o777);
    let open = paths.into_iter().filter(|path| mode(path) & 0o077 != 0);
    open.map(|path| format!("{:04o} {}", mode(&path), path.display())).collect()
}

#[test]
fn no_file_of_a_running_robot_has_a_bit_for_others_and_the_transport_alone_leaves_some() {
    isolated("no_file_of_a_running_robot_has_a_bit_for_others_and_the_transport_alone_leaves_some", "256m", || {
        let place = Place::new();
        let _daemon = DaemonTopics::open(&place.ipc, &["front".to_owned()], &[35]).expect("daemon");
        let _controller = ControllerTopics::open(&place.ipc).expect("controller");
        let _planner = InputPublisher::open(&place.ipc, true).expect("planner");
        let _status = StatusTopics::open(&place.ipc).expect("status");
        let open = open_to_others(&place);
        let bare = Place::new();
        let _node = foreign_node(&bare.root(), &bare.params.prefix);
        let control = open_to_others(&bare);
        checks::figure(34, "files with a bit for others", open.len(), "0", 1);
        checks::figure(34, "negative control: the transport alone", control.len(), "some", 1);
        assert_eq!(open, Vec::<String>::new());
        assert!(control.iter().any(|path| path.starts_with("0666") && path.contains("global_mgmt")), "{control:?}");
    });
}

#[test]
fn a_planted_configuration_of_the_transport_is_ignored_by_both_programs() {
    isolated("a_planted_configuration_of_the_transport_is_ignored_by_both_programs", "256m", || {
        let place = Place::new();
        let working = place.directory.path().join("working");
        let planted = place.directory.path().join("planted");
        fs::create_dir_all(working.join("config")).expect("directory");
        let text = format!("[global]\nroot-path = {planted:?}\nprefix = \"planted_\"\n");
        fs::write(working.join("config/iceoryx2.toml"), text).expect("planted");
        let [mut daemon, _] = programs(&place.config_file(), None);
        let mut daemon = daemon.current_dir(&working).spawn().expect("daemon");
        let _controller = Controller::start_in(&place, &[], &working);
        let mut base = Base::new(&place);
        base.listen_until(SOON, || (), |sample| sample.daemon_state == noctule::signal::DaemonState::Ready.number());
        assert!(!planted.exists() && shared_memory_files("planted_").is_empty());
        assert!(ipc_rig::wait_for(&mut daemon, SOON).success());
        checks::figure(34, "planted configuration of the transport", "ignored", "ignored", 2);
    });
}
