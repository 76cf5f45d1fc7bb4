//! Checks 14 and 32 on the real daemon: whatever adapters there are or are not, it is READY in 2 s and says in one line what it images on;
//! it ends within 1 s of SIGTERM whatever the GPU does. Skipped without any adapter, unless `NOCTULE_REQUIRE_GPU=1`.
#![cfg(all(feature = "gpu", target_os = "linux"))]

mod checks;
mod common;
mod ipc_rig;

use checks::{figure, trials};
use common::Random;
use common::gpu::gpu;
use ipc_rig::{Place, wait_for};
use noctule::imaging::gpu::{AdapterKind, adapters};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A driver list that leads nowhere.
const NO_DRIVER: [(&str, &str); 2] = [("VK_DRIVER_FILES", "/nonexistent"), ("VK_ICD_FILENAMES", "/nonexistent")];

/// The real daemon on the simulator, and what it says.
struct Daemon {
    child: Child,
    lines: Receiver<(Instant, String)>,
    heard: Vec<String>,
    started: Instant,
    _place: Place,
    /// One daemon at a time: two would measure each other.
    _turn: MutexGuard<'static, ()>,
}

static TURN: Mutex<()> = Mutex::new(());

impl Daemon {
    fn start(arguments: &[&str], environment: &[(&str, &str)]) -> Self {
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let place = Place::new();
        let started = Instant::now();
        let mut child = Command::new(env!("CARGO_BIN_EXE_noctule"))
            .args(["run", "--config"])
            .arg(place.config_file())
            .args(arguments)
            .envs(environment.iter().copied())
            .current_dir(place.directory.path())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the daemon starts");
        let stderr = BufReader::new(child.stderr.take().expect("piped"));
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in stderr.lines().map_while(Result::ok) {
                if sender.send((Instant::now(), line)).is_err() {
                    break;
                }
            }
        });
        Self { child, lines, heard: Vec::new(), started, _place: place, _turn: turn }
    }

    /// Time from the start to a line that contains `text`, if it comes within `limit`.
    fn hears(&mut self, text: &str, limit: Duration) -> Option<Duration> {
        let deadline = Instant::now() + limit;
        while let Ok((at, line)) = self.lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            let found = line.contains(text);
            self.heard.push(line);
            if found {
                return Some(at - self.started);
            }
        }
        None
    }

    fn terminate(&self) {
        kill_process(Pid::from_child(&self.child), Signal::TERM).expect("signalled");
    }

    /// Ends it, and gives how long that took and its exit code.
    fn end(&mut self) -> (Duration, Option<i32>) {
        let begin = Instant::now();
        self.terminate();
        let status = wait_for(&mut self.child, Duration::from_secs(10));
        (begin.elapsed(), status.code())
    }

    fn imaging_lines(&self) -> Vec<&String> {
        self.heard.iter().filter(|line| line.contains("imaging on ")).collect()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn without_a_driver_the_cpu_images_in_one_line_and_the_daemon_is_ready_in_2_s() {
    let count = trials(30, 3);
    let mut starts = Vec::new();
    for _ in 0..count {
        let mut daemon = Daemon::start(&["--backend", "auto"], &NO_DRIVER);
        let ready = daemon.hears("SELFTEST -> READY", Duration::from_secs(20)).expect("ready");
        starts.push(ready);
        let lines = daemon.imaging_lines();
        assert_eq!(lines.len(), 1, "{:?}", daemon.heard);
        assert!(lines[0].contains("imaging on cpu") && lines[0].contains("there is no Vulkan"), "{}", lines[0]);
        // OpenGL on a software rasteriser is what some libraries would take here without a word.
        assert!(
            !daemon.heard.iter().any(|line| line.contains("llvmpipe") || line.contains("panicked")),
            "{:?}",
            daemon.heard
        );
        assert_eq!(daemon.end().1, Some(0));
    }
    tell_start("without a driver", &starts);
}

/// Other programs on this machine may hold up a start, none can speed it up: the quickest is what the daemon takes.
fn tell_start(what: &str, starts: &[Duration]) {
    let (Some(least), Some(most)) = (starts.iter().min(), starts.iter().max()) else { panic!("no start") };
    let found = format!("{:.2} to {:.2}", least.as_secs_f64(), most.as_secs_f64());
    figure(32, &format!("start to READY {what}, s"), found, "<= 2 on an idle machine", starts.len());
    assert!(*least <= Duration::from_secs(2), "{starts:?}");
}

#[test]
fn with_a_software_adapter_only_auto_takes_the_cpu_and_says_why_in_one_line() {
    if !gpu() || adapters().iter().any(|adapter| adapter.kind != AdapterKind::Software) {
        return;
    }
    let mut starts = Vec::new();
    for _ in 0..trials(30, 3) {
        let mut daemon = Daemon::start(&["--backend", "auto"], &[]);
        starts.push(daemon.hears("SELFTEST -> READY", Duration::from_secs(20)).expect("ready"));
        let lines = daemon.imaging_lines();
        assert_eq!(lines.len(), 1, "{:?}", daemon.heard);
        let line = lines[0];
        assert!(line.contains("imaging on cpu") && line.contains("a software adapter is not a GPU"), "{line}");
        assert_eq!(daemon.end().1, Some(0));
    }
    tell_start("with a software adapter", &starts);
}

#[test]
fn a_gpu_asked_for_by_name_is_named_and_without_any_the_daemon_exits_69() {
    let mut daemon = Daemon::start(&["--backend", "gpu"], &NO_DRIVER);
    let status = wait_for(&mut daemon.child, Duration::from_secs(10));
    assert_eq!(status.code(), Some(69));
    assert!(daemon.hears("no GPU to use", Duration::from_secs(1)).is_some(), "{:?}", daemon.heard);
    figure(32, "exit code of --backend gpu without an adapter", 69, "69", 1);
    drop(daemon);
    if !gpu() {
        return;
    }
    let name = adapters()[0].name.clone();
    let mut daemon = Daemon::start(&["--backend", "gpu"], &[]);
    daemon.hears("imaging on gpu", Duration::from_secs(20)).expect("a GPU");
    assert!(daemon.imaging_lines()[0].contains(&name), "{:?}", daemon.heard);
    assert_eq!(daemon.end().1, Some(0));
}

/// On a software adapter the default robot is far too much for the deadline: the GPU fails, rests and is opened anew all the time.
#[test]
fn sigterm_ends_the_daemon_within_1_s_whatever_the_gpu_is_at() {
    if !gpu() {
        return;
    }
    let count = trials(60, 4);
    let (mut slowest, mut random) = (Duration::ZERO, Random(14));
    for trial in 0..count {
        let mut daemon = Daemon::start(&["--backend", "gpu"], &[]);
        daemon.hears("imaging on gpu", Duration::from_secs(20)).expect("a GPU");
        std::thread::sleep(Duration::from_millis(random.index(3500) as u64));
        let (took, code) = daemon.end();
        slowest = slowest.max(took);
        assert_eq!(code, Some(0), "{trial}: {:?}", daemon.heard);
    }
    figure(14, "SIGTERM to exit with a GPU at work, ms", slowest.as_millis(), "<= 1000", count);
    assert!(slowest <= Duration::from_secs(1), "{slowest:?}");
}
