//! Contract: under a service manager daemon and controller say when they are ready, feed its watchdog with what they did and with nothing
//! else, and say that they end. The units name what these programs need, and systemd understands them.

mod ipc_rig;
mod judge;
mod life_rig;

use ipc_rig::{Place, shared_memory_files};
use life_rig::stand_in::{self, Fault};
use life_rig::{Process, SOON, child_with, controller_command, daemon_command};
use rustix::process::{Pid, Signal};
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[test]
fn stand_in_process() {
    stand_in::serve_if_asked();
}

/// A service manager that listens.
struct Manager {
    socket: UnixDatagram,
    told: Vec<(Instant, String)>,
}

impl Manager {
    fn new(place: &Place) -> Self {
        let socket = UnixDatagram::bind(place.directory.path().join("notify")).expect("bound");
        socket.set_read_timeout(Some(Duration::from_millis(5))).expect("timeout");
        Self { socket, told: Vec::new() }
    }

    fn address(place: &Place) -> std::path::PathBuf {
        place.directory.path().join("notify")
    }

    fn listen_for(&mut self, duration: Duration) {
        let deadline = Instant::now() + duration;
        while Instant::now() < deadline {
            let mut buffer = [0; 256];
            if let Ok(length) = self.socket.recv(&mut buffer) {
                self.told.push((Instant::now(), String::from_utf8_lossy(&buffer[..length]).into_owned()));
            }
        }
    }

    fn listen_until(&mut self, message: &str) {
        let deadline = Instant::now() + SOON;
        while !self.has(message) {
            assert!(Instant::now() < deadline, "never told {message}: {:?}", self.told);
            self.listen_for(Duration::from_millis(10));
        }
    }

    fn has(&self, message: &str) -> bool {
        self.told.iter().any(|(_, told)| told == message)
    }

    fn count(&self, message: &str, since: Instant) -> usize {
        self.told.iter().filter(|(at, told)| *at >= since && told == message).count()
    }
}

#[test]
fn the_daemon_is_ready_after_its_self_test_beats_with_every_ping_set_and_says_that_it_ends() {
    let place = Place::new();
    let mut manager = Manager::new(&place);
    let mut daemon = Process::spawn(daemon_command(&place, 1).env("NOTIFY_SOCKET", Manager::address(&place)));
    manager.listen_until("READY=1");
    let since = Instant::now();
    manager.listen_for(Duration::from_secs(2));
    let beats = manager.count("WATCHDOG=1", since);
    assert!((15..=22).contains(&beats), "{beats} beats in 2 s of ten ping sets a second");
    assert!(manager.told.iter().any(|(_, told)| told.starts_with("STATUS=READY")), "{:?}", manager.told);
    let first = |message: &str| manager.told.iter().position(|(_, told)| told.starts_with(message));
    assert!(first("READY=1") > first("STATUS=SELFTEST"), "not ready before the self-test is over");
    daemon.signal(Signal::TERM);
    manager.listen_until("STOPPING=1");
    assert_eq!(daemon.wait(SOON).code(), Some(0));
}

/// The negative control of a heartbeat from a timer: the process lives, its loops turn, but nothing is processed.
#[test]
fn the_watchdog_starves_when_the_source_hangs_although_the_process_lives() {
    let place = Place::new();
    let mut manager = Manager::new(&place);
    let mut daemon =
        Process::spawn(stand_in::command(&place, Fault::ParkedSource).env("NOTIFY_SOCKET", Manager::address(&place)));
    manager.listen_until("READY=1");
    std::fs::write(stand_in::trigger(&place), "").expect("triggered");
    manager.listen_for(Duration::from_millis(300));
    let since = Instant::now();
    manager.listen_for(Duration::from_millis(1_200));
    assert!(daemon.is_alive(), "the deciding thread turns on meanwhile");
    assert_eq!(manager.count("WATCHDOG=1", since), 0, "a beat with nothing processed");
}

#[test]
fn the_controller_is_ready_with_its_topics_beats_twice_a_second_and_says_that_it_ends() {
    let place = Place::new();
    let mut manager = Manager::new(&place);
    let mut controller = Process::spawn(controller_command(&place).env("NOTIFY_SOCKET", Manager::address(&place)));
    manager.listen_until("READY=1");
    let since = Instant::now();
    manager.listen_for(Duration::from_secs(3));
    let beats = manager.count("WATCHDOG=1", since);
    assert!((5..=7).contains(&beats), "{beats} beats in 3 s");
    controller.signal(Signal::STOP);
    manager.listen_for(Duration::from_millis(100));
    let since = Instant::now();
    manager.listen_for(Duration::from_secs(1));
    assert_eq!(manager.count("WATCHDOG=1", since), 0, "a stopped controller beats");
    controller.signal(Signal::CONT);
    controller.signal(Signal::TERM);
    manager.listen_until("STOPPING=1");
    assert_eq!(controller.wait(SOON).code(), Some(0));
}

#[test]
fn the_units_are_understood_by_systemd_and_carry_what_the_contract_asks() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging/systemd");
    let text = |name: &str| std::fs::read_to_string(folder.join(name)).expect("unit");
    for (name, lines) in [
        ("noctule.service", ["Type=notify", "WatchdogSec=2", "RestartSec=1", "ExecStart=/usr/bin/noctule run"]),
        (
            "noctule-controller.service",
            ["Type=notify", "WatchdogSec=1", "RestartSec=500ms", "ExecStart=/usr/bin/noctule-controller"],
        ),
    ] {
        let unit = text(name);
        let common = [
            "Restart=on-failure",
            "RestartSteps=",
            "RestartMaxDelaySec=30",
            "StartLimitBurst=5",
            "StartLimitIntervalSec=60",
            "RestartPreventExitStatus=2 65 75 78",
            "RuntimeDirectory=noctule",
            "RuntimeDirectoryMode=0700",
            "RuntimeDirectoryPreserve=yes",
            "RemoveIPC=no",
        ];
        for line in lines.iter().chain(&common) {
            assert!(unit.lines().any(|found| found.starts_with(line)), "{name} lacks {line}");
        }
    }
    // Verified with the paths of this build, since the installed ones are not there.
    let place = Place::new();
    let verified = place.directory.path().join("units");
    std::fs::create_dir(&verified).expect("folder");
    let mut paths = Vec::new();
    for name in ["noctule.service", "noctule-controller.service", "noctule-wipe.service"] {
        let unit = text(name)
            .replace("/usr/bin/noctule-controller", env!("CARGO_BIN_EXE_noctule-controller"))
            .replace("/usr/bin/noctule ", concat!(env!("CARGO_BIN_EXE_noctule"), " "));
        std::fs::write(verified.join(name), unit).expect("written");
        paths.push(verified.join(name));
    }
    let Ok(output) = Command::new("systemd-analyze").arg("verify").args(&paths).output() else {
        eprintln!("SKIPPED: systemd-analyze is not installed, the units are not verified");
        return;
    };
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    // Pauses that grow came with systemd 254; an older one ignores the two keys and says so.
    let wrong: Vec<&str> = told
        .lines()
        .filter(|line| verified.to_str().is_some_and(|folder| line.contains(folder)) || line.contains("noctule"))
        .filter(|line| !line.contains("RestartSteps") && !line.contains("RestartMaxDelaySec"))
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    // That it looks at all: a unit with a mistake is told of.
    std::fs::write(verified.join("planted.service"), "[Service]\nType=notifi\nExecStart=/bin/true\n").expect("written");
    let planted = Command::new("systemd-analyze").arg("verify").arg(verified.join("planted.service")).output();
    assert!(String::from_utf8_lossy(&planted.expect("ran").stderr).contains("notifi"));
}

#[test]
fn wipe_removes_everything_of_dead_processes_and_is_refused_with_69_while_a_daemon_runs() {
    let place = Place::new();
    let mut controller = Process::spawn(&mut controller_command(&place));
    let mut daemon = Process::spawn(&mut daemon_command(&place, 1));
    let deadline = Instant::now() + SOON;
    while shared_memory_files(&place.params.prefix).len() < 10 {
        assert!(Instant::now() < deadline);
        std::thread::sleep(Duration::from_millis(10));
    }
    std::thread::sleep(Duration::from_millis(300));
    let wipe = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_noctule"));
        command.arg("wipe").arg("--config").arg(place.config_file()).output().expect("ran")
    };
    assert_eq!(wipe().status.code(), Some(69));
    daemon.kill();
    controller.kill();
    let output = wipe();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(
        place.left_behind().iter().filter(|name| !name.ends_with("daemon.lock")).count(),
        0,
        "{:?}",
        place.left_behind()
    );
    assert!(shared_memory_files(&place.params.prefix).is_empty());
}

/// Exit code 75 of the daemon: `demo` stops both, wipes, starts both, and nobody is armed.
#[test]
fn demo_wipes_and_starts_both_again_when_communication_is_stuck() {
    let place = Place::new();
    let mut command = Command::new(env!("CARGO_BIN_EXE_noctule"));
    command.args(["--quiet", "demo", "--headless", "--backend", "cpu", "--config"]).arg(place.config_file());
    let mut demo = Process::spawn(command.stdout(Stdio::null()).stderr(Stdio::null()));
    let both = || (child_with(demo.id(), "run"), child_with(demo.id(), "controller"));
    let deadline = Instant::now() + SOON;
    let lock = place.root().join(format!("{}daemon.lock", place.params.prefix));
    while !(lock.exists() && both().0.is_some() && both().1.is_some()) {
        assert!(Instant::now() < deadline);
        std::thread::sleep(Duration::from_millis(10));
    }
    std::thread::sleep(Duration::from_secs(1));
    let before = both();
    // The daemon finds its lock gone, as when somebody deletes the root, and ends with 75.
    std::fs::remove_file(&lock).expect("removed");
    let deadline = Instant::now() + SOON;
    loop {
        let after = both();
        let anew = |old: Option<u32>, new: Option<u32>| new.is_some() && new != old;
        if anew(before.0, after.0) && anew(before.1, after.1) {
            break;
        }
        assert!(Instant::now() < deadline, "before {before:?}, now {after:?}");
        std::thread::sleep(Duration::from_millis(10));
    }
    let controller = both().1.expect("controller");
    let words = std::fs::read(format!("/proc/{controller}/cmdline")).expect("command line");
    assert!(!words.split(|byte| *byte == 0).any(|word| word == b"--arm"), "armed by itself a second time");
    rustix::process::kill_process(Pid::from_raw(demo.id().cast_signed()).expect("number"), Signal::TERM)
        .expect("asked");
    assert_eq!(demo.wait(SOON).code(), Some(0));
}
