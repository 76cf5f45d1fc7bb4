//! A private root and prefix, a daemon that does what a test wants, and the real controller process.
#![allow(dead_code, reason = "every test file uses another part")]

use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::{
    AttributeVerifier, BackpressureStrategy, Config, FileName, Node, NodeBuilder, Path as TransportPath,
    SemanticString, ipc,
};
use noctule::io::wire::message::{OperatorRequest, Request, VelocityCommand};
use noctule::io::wire::telemetry::PlatformVelocity;
use noctule::io::wire::{Checked, WireType};
use noctule::io::{Ipc, IpcParams, OperatorClient, PlatformSubscriber};
use noctule::signal::{DaemonState, GateState, Reason};
use noctule::time::{Clock, SystemClock};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tempfile::TempDir;

pub const MS: u64 = 1_000_000;

/// Where a test's topics are; nothing of it is left when it is dropped.
///
/// Fields are dropped in the order of their declaration: a node that ends makes its directories again, so the directory
/// goes last, here as in whatever holds a place.
pub struct Place {
    pub ipc: Ipc,
    pub params: IpcParams,
    pub directory: TempDir,
}

impl Place {
    pub fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let directory = TempDir::new().expect("directory");
        let prefix = format!("nt{}_{}_", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let params = IpcParams { root: Some(directory.path().join("root")), prefix };
        let ipc = Ipc::open(&params).expect("opened");
        Self { ipc, params, directory }
    }

    pub fn root(&self) -> PathBuf {
        self.directory.path().join("root")
    }

    /// A configuration file that leads to this place.
    pub fn config_file(&self) -> PathBuf {
        let path = self.directory.path().join("robot.toml");
        let text = format!("[ipc]\nroot = {:?}\nprefix = {:?}\n", self.root(), self.params.prefix);
        std::fs::write(&path, text).expect("written");
        path
    }

    /// Files left in the root and in shared memory, but for the transport's own management file.
    pub fn left_behind(&self) -> Vec<String> {
        let mut found = Vec::new();
        files_below(&self.root(), &mut found);
        found.extend(shared_memory_files(&self.params.prefix).into_iter().filter(|name| !name.contains("global_mgmt")));
        found
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        for name in shared_memory_files(&self.params.prefix) {
            let _ = std::fs::remove_file(Path::new("/dev/shm").join(name));
        }
    }
}

pub fn shared_memory_files(prefix: &str) -> Vec<String> {
    let entries = std::fs::read_dir("/dev/shm").into_iter().flatten().flatten();
    entries
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.starts_with(prefix))
        .collect()
}

pub fn files_below(path: &Path, found: &mut Vec<String>) {
    for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
        if entry.path().is_dir() {
            files_below(&entry.path(), found);
        } else {
            found.push(entry.path().display().to_string());
        }
    }
}

/// A node as another build or language would open it.
pub fn foreign_node(root: &Path, prefix: &str) -> Node<ipc::Service> {
    let mut config = Config::default();
    config.global.set_root_path(&TransportPath::new(root.to_str().expect("UTF-8").as_bytes()).expect("path"));
    config.global.prefix = FileName::new(prefix.as_bytes()).expect("prefix");
    NodeBuilder::new().config(&config).create::<ipc::Service>().expect("node")
}

/// Publishes any command, sound or not: the transport alone, none of the program's own publishing.
pub struct FakeDaemon {
    publisher: Publisher<ipc::Service, VelocityCommand, ()>,
    pub epoch: u64,
    pub sequence: u64,
    _node: Node<ipc::Service>,
}

impl FakeDaemon {
    pub fn new(root: &Path, prefix: &str, epoch: u64) -> Self {
        let node = foreign_node(root, prefix);
        let hash = format!("{:016x}", VelocityCommand::SCHEMA_HASH);
        let attributes = AttributeVerifier::new()
            .require(&"noctule.schema".try_into().expect("key"), &hash.as_str().try_into().expect("value"))
            .expect("attribute");
        let service = node
            .service_builder(&"noctule/command".try_into().expect("name"))
            .publish_subscribe::<VelocityCommand>()
            .max_publishers(1)
            .max_nodes(32)
            .max_subscribers(8)
            .subscriber_max_buffer_size(1)
            .subscriber_max_borrowed_samples(1)
            .history_size(0)
            .open_or_create_with_attributes(&attributes)
            .expect("service");
        // A dead predecessor's place is free as soon as its node is cleaned up.
        let _ = node.try_cleanup_dead_nodes();
        let publisher = service
            .publisher_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .expect("publisher");
        Self { publisher, epoch, sequence: 0, _node: node }
    }

    /// The next command of an ACTIVE daemon, captured 30 ms ago.
    pub fn next(&mut self) -> VelocityCommand {
        self.sequence += 1;
        let now = SystemClock.now();
        VelocityCommand {
            epoch: self.epoch,
            publisher_id: 77,
            sequence: self.sequence,
            t_monotonic_ns: now.boottime_ns - 30 * MS,
            valid_until_ns: now.boottime_ns + 270 * MS,
            linear_m_s: 0.2,
            angular_rad_s: 0.3,
            state: DaemonState::Active.number(),
            reason: Reason::None.number(),
            ..VelocityCommand::blank()
        }
    }

    /// Sends the next command after `change`, sealed; returns it.
    pub fn send(&mut self, change: impl FnOnce(&mut VelocityCommand)) -> VelocityCommand {
        let mut command = self.next();
        change(&mut command);
        self.send_as_it_is(command.sealed())
    }

    /// Sends a command whatever its checksum.
    pub fn send_as_it_is(&mut self, command: VelocityCommand) -> VelocityCommand {
        self.publisher.send_copy(command).expect("sent");
        command
    }
}

/// The real controller process.
pub struct Controller {
    child: Child,
}

impl Controller {
    pub fn start(place: &Place, arguments: &[&str]) -> Self {
        Self::start_in(place, arguments, place.directory.path())
    }

    pub fn start_in(place: &Place, arguments: &[&str], working_directory: &Path) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_noctule-controller"))
            .arg("--config")
            .arg(place.config_file())
            .args(arguments)
            .current_dir(working_directory)
            .stderr(Stdio::inherit())
            .spawn()
            .expect("controller");
        Self { child }
    }

    pub fn signal(&self, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(pid, signal).expect("signalled");
    }

    /// Waits for the end; panics after `limit`.
    pub fn wait(&mut self, limit: Duration) -> ExitStatus {
        wait_for(&mut self.child, limit)
    }
}

impl Drop for Controller {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits for a process to end; panics after `limit`.
pub fn wait_for(child: &mut Child, limit: Duration) -> ExitStatus {
    let deadline = Instant::now() + limit;
    loop {
        if let Some(status) = child.try_wait().expect("waited") {
            return status;
        }
        assert!(Instant::now() < deadline, "still running after {limit:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The platform's end: everything that the controller told it, and the operator's buttons.
pub struct Base {
    platform: PlatformSubscriber,
    operator: OperatorClient,
    pub heard: Vec<PlatformVelocity>,
}

impl Base {
    pub fn new(place: &Place) -> Self {
        Self {
            platform: PlatformSubscriber::open(&place.ipc).expect("platform"),
            operator: OperatorClient::open(&place.ipc).expect("operator"),
            heard: Vec::new(),
        }
    }

    /// Hears what arrived.
    pub fn listen(&mut self) {
        while let Some(velocity) = self.platform.next_velocity() {
            self.heard.push(velocity);
        }
    }

    /// Listens for a while; `every` is called every 2 ms.
    pub fn listen_for(&mut self, duration: Duration, mut every: impl FnMut()) {
        let deadline = Instant::now() + duration;
        while Instant::now() < deadline {
            every();
            self.listen();
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Listens until the newest sample satisfies `condition`; panics after `limit`.
    pub fn listen_until(
        &mut self,
        limit: Duration,
        mut every: impl FnMut(),
        condition: impl Fn(&PlatformVelocity) -> bool,
    ) -> PlatformVelocity {
        let deadline = Instant::now() + limit;
        loop {
            every();
            self.listen();
            if let Some(newest) = self.heard.last().filter(|newest| condition(newest)) {
                return *newest;
            }
            assert!(Instant::now() < deadline, "not within {limit:?}; newest {:?}", self.heard.last());
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    pub fn ask(&self, request: Request, epoch: u64) {
        self.operator.send(request, epoch).expect("asked");
    }

    pub fn operator(&self) -> &OperatorClient {
        &self.operator
    }

    /// Samples that were sent later than `t_ns`.
    pub fn since(&self, t_ns: u64) -> impl Iterator<Item = &PlatformVelocity> {
        self.heard.iter().filter(move |sample| sample.t_monotonic_ns > t_ns)
    }

    /// When the platform was first told to stand still after `t_ns` and told nothing else since.
    pub fn standing_since(&self, t_ns: u64) -> Option<u64> {
        let last_move = self.since(t_ns).filter(|sample| moves(sample)).last().map_or(t_ns, |s| s.t_monotonic_ns);
        self.since(last_move).find(|sample| !moves(sample)).map(|sample| sample.t_monotonic_ns)
    }
}

pub fn moves(sample: &PlatformVelocity) -> bool {
    !(sample.linear_m_s == 0.0 && sample.angular_rad_s == 0.0)
}

pub fn is(sample: &PlatformVelocity, state: GateState) -> bool {
    sample.state == state.number()
}

/// Calls back every `period`, for driving a fake daemon from a listening loop.
pub struct Metronome {
    next: Instant,
    period: Duration,
}

impl Metronome {
    pub fn new(period: Duration) -> Self {
        Self { next: Instant::now(), period }
    }

    pub fn due(&mut self) -> bool {
        let due = Instant::now() >= self.next;
        if due {
            self.next += self.period;
        }
        due
    }
}

pub fn spoilt(command: VelocityCommand) -> VelocityCommand {
    let sealed = command.sealed();
    VelocityCommand { checksum: sealed.checksum ^ 1, ..sealed }
}

pub fn sound_request(request: Request, epoch: u64) -> OperatorRequest {
    let made = OperatorRequest::new(request, epoch, 1, SystemClock.now());
    assert!(made.checksum_matches());
    made
}
