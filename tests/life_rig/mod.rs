//! The real daemon and the real controller in a place of their own, the judge beside them, an operator, and ways to break them.
#![allow(dead_code, reason = "every test file uses another part")]

pub mod stand_in;

use super::ipc_rig::{Place, wait_for};
use super::judge::{Judge, Record, TRACK, Z2_NS, now_ns};
use noctule::io::OperatorClient;
use noctule::io::wire::message::Request;
use rustix::process::Signal;
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

pub const SOON: Duration = Duration::from_secs(20);
/// The daemon's number of READY on the wire.
pub const READY: u32 = 2;

/// A process that is killed when it is dropped.
pub struct Process {
    pub child: Child,
}

impl Process {
    pub fn spawn(command: &mut Command) -> Self {
        Self { child: command.stdin(Stdio::null()).spawn().expect("started") }
    }

    pub fn signal(&self, signal: Signal) {
        // It may just have ended by itself.
        let _ = rustix::process::kill_process(rustix::process::Pid::from_child(&self.child), signal);
    }

    /// Kills it; returns when.
    pub fn kill(&mut self) -> u64 {
        self.signal(Signal::KILL);
        let killed_ns = now_ns();
        self.child.wait().expect("gone");
        killed_ns
    }

    pub fn wait(&mut self, limit: Duration) -> ExitStatus {
        wait_for(&mut self.child, limit)
    }

    /// Waits for the end and returns when it was, with the status.
    pub fn ended_at(&mut self, limit: Duration) -> (u64, ExitStatus) {
        let deadline = Instant::now() + limit;
        loop {
            if let Some(status) = self.child.try_wait().expect("waited") {
                return (now_ns(), status);
            }
            assert!(Instant::now() < deadline, "still running after {limit:?}");
            std::thread::sleep(Duration::from_micros(500));
        }
    }

    pub fn is_alive(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// `noctule run` on the simulated robot of the built-in office.
pub fn daemon_command(place: &Place, seed: u64) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_noctule"));
    command.args(["run", "--source", "sim", "--backend", "cpu", "--seed", &seed.to_string(), "--config"]);
    command.arg(place.config_file()).stderr(Stdio::null());
    command
}

pub fn controller_command(place: &Place) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_noctule-controller"));
    command.arg("--config").arg(place.config_file()).stderr(Stdio::null());
    command
}

/// Fields are dropped in the order of their declaration; the place goes last.
pub struct Life {
    pub daemon: Process,
    pub controller: Process,
    pub operator: OperatorClient,
    pub judge: Judge,
    pub place: Place,
    seed: u64,
}

impl Life {
    pub fn new() -> Self {
        Self::with(|command| command, |command| command)
    }

    /// With commands changed: an environment, another standard error.
    pub fn with(
        change_daemon: impl FnOnce(&mut Command) -> &mut Command,
        change_controller: impl FnOnce(&mut Command) -> &mut Command,
    ) -> Self {
        let place = Place::new();
        let controller = Process::spawn(change_controller(&mut controller_command(&place)));
        let judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
        let daemon = Process::spawn(change_daemon(&mut daemon_command(&place, 1)));
        let operator = OperatorClient::open(&place.ipc).expect("operator");
        Self { daemon, controller, operator, judge, place, seed: 1 }
    }

    /// With a stand-in for the daemon, which fails on demand.
    pub fn with_stand_in(fault: stand_in::Fault) -> Self {
        let place = Place::new();
        let controller = Process::spawn(&mut controller_command(&place));
        let judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
        let daemon = Process::spawn(&mut stand_in::command(&place, fault));
        let operator = OperatorClient::open(&place.ipc).expect("operator");
        Self { daemon, controller, operator, judge, place, seed: 1 }
    }

    /// Another daemon in the place of the last, another start and other noise.
    pub fn start_daemon(&mut self) {
        self.seed += 1;
        self.daemon = Process::spawn(&mut daemon_command(&self.place, self.seed));
    }

    pub fn wait_ready(&mut self) {
        self.judge.watch_until(SOON, "READY", |heard| heard.daemon_state == READY);
    }

    pub fn arm(&mut self) {
        let deadline = Instant::now() + SOON;
        while let Err(error) = self.operator.request(Request::Arm, Duration::from_millis(500)) {
            assert!(Instant::now() < deadline, "not armed: {error}");
        }
    }

    pub fn ask(&self, request: Request, epoch: u64) {
        self.operator.send(request, epoch).expect("asked");
    }

    /// Arms, and returns when the robot moves, at a phase of the ping period that differs from trial to trial.
    pub fn drive(&mut self, trial: usize) {
        self.arm();
        self.wait_moving();
        self.judge.watch_for(Duration::from_millis((trial * 37 % 100) as u64));
        self.judge.watch_until(SOON, "motion", |heard| heard.state == TRACK && heard.moves());
    }

    pub fn wait_moving(&mut self) {
        self.judge.watch_until(SOON, "motion", |heard| heard.state == TRACK && heard.moves());
    }
}

/// Times of a stop in nanoseconds, after the fault and after the last good capture.
#[derive(Debug, Clone, Copy)]
pub struct Stopped {
    pub zero_ns: u64,
    pub after_fault_ns: u64,
    pub after_capture_ns: u64,
}

/// How the robot came to stand after a fault at `fault_ns`; panics where it did not. The capture is that of the newest command that the
/// controller had when it stood.
pub fn stopped(record: &Record, fault_ns: u64) -> Stopped {
    let zero_ns = record
        .zero_at(fault_ns.saturating_sub(1))
        .unwrap_or_else(|| panic!("it never stood: {:?}", record.heard.last()));
    let captured_ns = record.captured_before(zero_ns).expect("heard");
    Stopped {
        zero_ns,
        after_fault_ns: zero_ns.saturating_sub(fault_ns),
        after_capture_ns: zero_ns.saturating_sub(captured_ns.min(fault_ns)),
    }
}

/// Asserts that a silent fault was answered in time; the figure is the later one, from capture.
pub fn assert_z2(stopped: &Stopped, trial: usize) {
    let ms = |ns: u64| ns as f64 * 1e-6;
    assert!(
        stopped.after_capture_ns <= Z2_NS && stopped.after_fault_ns <= Z2_NS,
        "trial {trial}: {:.1} ms after the last capture, {:.1} ms after the fault",
        ms(stopped.after_capture_ns),
        ms(stopped.after_fault_ns)
    );
}

pub fn in_ms(ns: u64) -> String {
    format!("{:.1} ms", ns as f64 * 1e-6)
}

/// Names of a process's threads, sorted.
pub fn threads(process_id: u32) -> Vec<String> {
    let tasks = std::fs::read_dir(format!("/proc/{process_id}/task")).into_iter().flatten().flatten();
    let mut names: Vec<String> = tasks
        .filter_map(|task| std::fs::read_to_string(task.path().join("comm")).ok())
        .map(|name| name.trim_end().to_owned())
        .collect();
    names.sort();
    names
}

/// Children of a process whose command line holds `word`.
pub fn child_with(parent: u32, word: &str) -> Option<u32> {
    let processes = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).find(|process: &u32| {
        let status = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
        let after_name = status.rsplit(')').next().unwrap_or_default().to_owned();
        let is_child = after_name.split_whitespace().nth(1) == Some(parent.to_string().as_str());
        let words = std::fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
        is_child && words.split(|byte| *byte == 0).any(|argument| argument == word.as_bytes())
    })
}

/// What a thread of a real process is to do at its next look at a clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// Panic, in the standard library.
    Panic = 0,
    /// End without a word: no unwinding, nobody is told.
    Vanish = 1,
    /// Never come back.
    Hang = 2,
}

/// The library that lets a thread of the real processes meet its [`Fate`], or shifts their wall clock.
pub struct Shim {
    library: PathBuf,
    shared: PathBuf,
    file: File,
}

impl Shim {
    /// Compiled with the system's C compiler, which whoever links Rust has.
    pub fn new(directory: &Path) -> Self {
        let library = directory.join("shim.so");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/life_rig/shim.c");
        let compiled = Command::new("cc").args(["-shared", "-fPIC", "-O2", "-o"]).arg(&library).arg(source).status();
        assert!(compiled.is_ok_and(|status| status.success()), "cc cannot compile the shim");
        let shared = directory.join("shim");
        std::fs::write(&shared, [0; 40]).expect("written");
        let file = File::options().read(true).write(true).open(&shared).expect("opened");
        Self { library, shared, file }
    }

    pub fn load<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        command.env("LD_PRELOAD", &self.library).env("NOCTULE_SHIM", &self.shared)
    }

    /// Strikes the thread of this name at its next look at a clock.
    pub fn strike(&self, thread: &str, fate: Fate) {
        let mut name = [0; 16];
        let bytes = &thread.as_bytes()[..thread.len().min(15)];
        name[..bytes.len()].copy_from_slice(bytes);
        self.file.write_all_at(&(fate as i64).to_ne_bytes(), 32).expect("written");
        self.file.write_all_at(&0_u64.to_ne_bytes(), 16).expect("written");
        // The first byte last: it is what the thread looks at.
        self.file.write_all_at(&name[1..], 1).expect("written");
        self.file.write_all_at(&name[..1], 0).expect("written");
    }

    /// When it struck.
    pub fn struck_at(&self, limit: Duration) -> u64 {
        let deadline = Instant::now() + limit;
        loop {
            let mut bytes = [0; 8];
            self.file.read_exact_at(&mut bytes, 16).expect("read");
            match u64::from_ne_bytes(bytes) {
                0 => assert!(Instant::now() < deadline, "the thread never looked at a clock"),
                at_ns => return at_ns,
            }
            std::thread::sleep(Duration::from_micros(200));
        }
    }

    pub fn shift_wall_s(&self, seconds: i64) {
        self.file.write_all_at(&seconds.to_ne_bytes(), 24).expect("written");
    }
}

/// A pipe that is full and that nobody reads.
pub fn blocked_pipe() -> (std::io::PipeReader, std::io::PipeWriter) {
    let (reader, mut writer) = std::io::pipe().expect("pipe");
    rustix::fs::fcntl_setfl(&writer, rustix::fs::OFlags::NONBLOCK).expect("made non-blocking");
    while writer.write(&[b'.'; 1024]).is_ok() {}
    while writer.write(b".").is_ok() {}
    rustix::fs::fcntl_setfl(&writer, rustix::fs::OFlags::empty()).expect("made blocking");
    (reader, writer)
}

/// What a process said on standard error.
pub fn said(child: &mut Child) -> String {
    let mut text = String::new();
    if let Some(pipe) = &mut child.stderr {
        let _ = pipe.read_to_string(&mut text);
    }
    text
}
