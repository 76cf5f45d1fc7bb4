//! A page in this process beside a daemon that says what a test wants, and clients that share no code with the page: HTTP by
//! hand, sockets by tungstenite.
#![allow(dead_code, reason = "every test file uses another part")]

use crate::ipc_rig::Place;
use noctule::config::Config;
use noctule::io::wire::message::{EnergyscapeHeader, VelocityCommand};
use noctule::io::wire::telemetry::{Cues, Health, PlatformVelocity};
use noctule::io::{ControllerTopics, DaemonTopics};
use noctule::signal::{DaemonState, GateState, LayerName, PolarGrid, Reason};
use noctule::time::{Clock, SystemClock};
use noctule::view::{ViewOptions, ViewServer};
use serde_json::Value;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

pub const RANGES: usize = 320;
pub const LIMIT: Duration = Duration::from_secs(10);
pub type Socket = WebSocket<TcpStream>;

/// A served page. The place goes last: its directory must outlive everything in it.
pub struct Served {
    pub address: SocketAddr,
    pub url: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    pub place: Place,
}

impl Served {
    pub fn new() -> Self {
        Self::with("127.0.0.1:0", None, &[])
    }

    pub fn with(listen: &str, token: Option<&str>, origins: &[&str]) -> Self {
        let place = Place::new();
        let config = Config { ipc: place.params.clone(), ..Config::default() };
        let options = ViewOptions {
            listen: listen.parse().expect("address"),
            or_any_port: false,
            token: token.map(str::to_owned),
            origins: origins.iter().map(|origin| (*origin).to_owned()).collect(),
        };
        let server = ViewServer::open(&config, &options).expect("page");
        let (address, url) = (server.address(), server.url());
        let address = SocketAddr::new("127.0.0.1".parse().expect("loopback"), address.port());
        let stop = Arc::new(AtomicBool::new(false));
        let asked = Arc::clone(&stop);
        let thread = std::thread::spawn(move || server.serve(&asked).expect("served"));
        Self { address, url, stop, thread: Some(thread), place }
    }

    /// Status, head and body of a GET.
    pub fn get(&self, path: &str, headers: &[(&str, &str)]) -> (u16, String, String) {
        let host = format!("localhost:{}", self.address.port());
        let mut request = format!("GET {path} HTTP/1.1\r\nConnection: close\r\n");
        if !headers.iter().any(|(name, _)| *name == "Host") {
            request.push_str(&format!("Host: {host}\r\n"));
        }
        headers.iter().for_each(|(name, value)| request.push_str(&format!("{name}: {value}\r\n")));
        exchange(self.address, &format!("{request}\r\n"))
    }

    /// Opens a socket; the status of the refusal otherwise.
    pub fn socket(&self, path: &str, headers: &[(&str, &str)]) -> Result<Socket, u16> {
        let mut request =
            format!("ws://localhost:{}{path}", self.address.port()).into_client_request().expect("request");
        for (name, value) in headers {
            let name: tungstenite::http::HeaderName = name.parse().expect("name");
            request.headers_mut().insert(name, HeaderValue::from_str(value).expect("value"));
        }
        let stream = TcpStream::connect(self.address).expect("connected");
        stream.set_read_timeout(Some(LIMIT)).expect("limited");
        match tungstenite::client::client(request, stream) {
            Ok((socket, _)) => Ok(socket),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) => {
                Err(response.status().as_u16())
            }
            Err(error) => panic!("{error:?}"),
        }
    }

    /// The value of a metric, by its name and labels as written; `None` without such a line.
    pub fn metric(&self, series: &str) -> Option<f64> {
        let (status, _, body) = self.get("/metrics", &[]);
        assert_eq!(status, 200);
        body.lines().find_map(|line| line.strip_prefix(series)?.strip_prefix(' ')?.parse().ok())
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Sends `request` and reads to the end.
pub fn exchange(address: SocketAddr, request: &str) -> (u16, String, String) {
    let mut stream = TcpStream::connect(address).expect("connected");
    stream.set_read_timeout(Some(LIMIT)).expect("limited");
    let _ = stream.write_all(request.as_bytes());
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let status = answer.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    (status, head.to_ascii_lowercase(), body.to_owned())
}

/// Daemon and controller of the built-in robot, on topics of their own.
pub struct Speakers {
    pub daemon: DaemonTopics,
    pub controller: ControllerTopics,
    pub grid: PolarGrid,
    pub sets: u64,
}

impl Speakers {
    pub fn new(place: &Place) -> Self {
        let names = ["front", "left", "right"].map(str::to_owned);
        let directions = Config::default().directions().expect("directions");
        let grid = PolarGrid::new(directions, 0.3, 0.0125, RANGES);
        let daemon = DaemonTopics::open(&place.ipc, &names, &[grid.cell_count(); 3]).expect("daemon");
        let controller = ControllerTopics::open(&place.ipc).expect("controller");
        Self { daemon, controller, grid, sets: 0 }
    }

    /// One ping set of an ACTIVE daemon: an echo of -20 dBFS at direction 120, bin 100 of every sensor; obstacle avoidance acts.
    pub fn ping_set(&mut self) {
        self.sets += 1;
        let now = SystemClock.now();
        let (t_monotonic_ns, t_wall_ns) = (now.boottime_ns - 60_000_000, now.wall_ns - 60_000_000);
        let command = VelocityCommand {
            t_monotonic_ns,
            t_wall_ns,
            valid_until_ns: u64::MAX,
            linear_m_s: 0.2,
            angular_rad_s: -0.4,
            speed_limit_m_s: 0.3,
            cause_range_m: 1.55,
            cause_bearing_rad: 30.5f64.to_radians(),
            cause_energy: 0.1,
            cause_threshold: 0.007,
            cause_sensor: 0,
            layer: LayerName::ObstacleAvoidance as u32,
            state: DaemonState::Active.number(),
            reason: Reason::Armed.number(),
            ..VelocityCommand::blank()
        };
        self.daemon.publish_command(command, now).expect("command");
        let mut values = vec![1e-5f32; self.grid.cell_count()];
        values[self.grid.cell(120, 100)] = 0.1;
        for sensor in 0..3 {
            let header = EnergyscapeHeader {
                sequence: self.sets,
                t_monotonic_ns,
                t_wall_ns,
                ..EnergyscapeHeader::for_grid(&self.grid, sensor, 343.0)
            };
            self.daemon.publish_energyscape(sensor, &header, &values).expect("energyscape");
        }
        self.daemon.publish_cues(Cues { t_monotonic_ns, t_wall_ns, ..Cues::blank() }).expect("cues");
        let health = Health {
            t_monotonic_ns: now.boottime_ns,
            t_wall_ns: now.wall_ns,
            ping_set_count: self.sets,
            dropped_count: 2,
            rejected_count: [0, 4, 0],
            latency_ms: 12.5,
            latency_p99_ms: 20.0,
            sensors_present: 0b101,
            state: DaemonState::Active.number(),
            ..Health::blank()
        };
        self.daemon.publish_health(health.with_adapter("a \"quoted\" adapter")).expect("health");
        let platform = PlatformVelocity {
            sequence: self.sets,
            t_monotonic_ns: now.boottime_ns,
            t_wall_ns: now.wall_ns,
            linear_m_s: 0.2,
            angular_rad_s: -0.4,
            state: GateState::Track.number(),
            accepted_count: self.sets,
            ..PlatformVelocity::blank()
        };
        self.controller.publish_platform(platform).expect("platform");
    }

    /// A ping set every 50 ms until `done`; panics after the limit.
    pub fn until(&mut self, mut done: impl FnMut() -> bool) {
        let begun = Instant::now();
        while !done() {
            assert!(begun.elapsed() < LIMIT, "nothing happened");
            self.ping_set();
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

/// The next message of a page's socket: a state as JSON, or an image as bytes; says `ok` to states.
pub enum Word {
    State(Value),
    Image(Vec<u8>),
}

pub fn next_word(socket: &mut Socket) -> Word {
    loop {
        match socket.read().expect("a message") {
            Message::Text(text) => {
                let value: Value = serde_json::from_str(text.as_str()).expect("JSON");
                if value["kind"] == "state" {
                    socket.send(Message::text("ok")).expect("said");
                }
                return Word::State(value);
            }
            Message::Binary(bytes) => return Word::Image(bytes.to_vec()),
            _ => {}
        }
    }
}

/// The next state for which `wanted` holds.
pub fn state_until(socket: &mut Socket, wanted: impl Fn(&Value) -> bool) -> Value {
    let begun = Instant::now();
    loop {
        assert!(begun.elapsed() < LIMIT, "no such state");
        if let Word::State(state) = next_word(socket)
            && state["kind"] == "state"
            && wanted(&state)
        {
            return state;
        }
    }
}
