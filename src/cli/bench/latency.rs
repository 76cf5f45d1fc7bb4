//! `noctule bench --latency`: last sample of a ping to its command at the controller process, by the real processes.
//!
//! This process is the driver: it publishes simulated pings of all sensors on the raw topics, stamped so that their last sample
//! is now. Daemon and controller are started as on a robot, in a [`Place`] of their own; what is read are the times that the
//! controller itself publishes. The transport by itself is measured in [`super::hop`].

use super::super::args::{BackendArgument, BenchArguments};
use super::super::output::{print_line, progress};
use super::super::run::{ipc_failure, stop_flag};
use super::super::{Failure, exit};
use super::hop;
use super::place::{Place, not_measured};
use super::quantiles::Quantiles;
use crate::cli::series::cores;
use crate::config::Config;
use crate::io::wire::message::VelocityCommand;
use crate::io::wire::telemetry::{Health, PlatformVelocity};
use crate::io::{InputPublisher, Ipc, RawPublisher, RawShape, StatusTopics};
use crate::service::supervisor::{Supervised, UNWATCHED, Watched};
use crate::service::wiring::{self, SensingSetup};
use crate::signal::{GateState, PingSet, Velocity};
use crate::time::{Clock, Stamp, SystemClock};
use serde_json::{Value, json};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Pings come at twice the default rate: commands are told to the platform 50 times a second, so that none is overlooked, and
/// emissions less than 20 ms apart would count as one.
const PERIOD: Duration = Duration::from_millis(50);
/// Pause between two looks at the topics.
const LOOK_PAUSE: Duration = Duration::from_millis(2);
/// Longest start of both processes, self-test and arming included.
const START_LIMIT: Duration = Duration::from_secs(15);
/// Sets that still count as answered after the last was sent.
const LAST_LIMIT: Duration = Duration::from_secs(1);

/// What was measured under one load.
struct Measured {
    load: &'static str,
    total: Quantiles,
    decided: Quantiles,
    sent: u64,
    health: Health,
    platform: PlatformVelocity,
}

/// Runs the command.
///
/// # Errors
/// Exit 69 when the processes do not start, 73, 74, 77, 78.
pub fn latency(config: &Config, arguments: &BenchArguments) -> Result<(), Failure> {
    let loads: &[(&'static str, bool)] =
        if arguments.busy { &[("idle", false), ("busy", true)] } else { &[("idle", false)] };
    let (mut measured, mut hops) = (Vec::new(), Vec::new());
    for &(load, busy) in loads {
        let _work = busy.then(Busy::start);
        hops.extend(hop::measure(config, load)?);
        measured.push(measure(config, arguments, load)?);
    }
    if arguments.json {
        let paths: Vec<Value> = measured.iter().map(Measured::json).collect();
        let hops: Vec<Value> = hops.iter().map(hop::Hop::json).collect();
        let machine = super::machine(config);
        return print_line(&json!({"machine": machine, "latency": paths, "transport": hops}).to_string());
    }
    let cores = cores();
    print_line(&format!("times in ms; busy: {cores} other threads that never wait"))?;
    let head = ["p50", "p99", "p99.9", "max"];
    print_line(&format!(
        "{:44} {:>6} {:>8} {:>8} {:>8} {:>8} {:>8}",
        "from, to", "load", "count", head[0], head[1], head[2], head[3]
    ))?;
    for row in &measured {
        print_row("last sample, command published", row.load, &row.decided)?;
        print_row("last sample, command at the controller", row.load, &row.total)?;
    }
    hops.iter().try_for_each(|hop| print_row(hop.what, hop.load, &hop.times))?;
    for row in &measured {
        let (answered, applied) = (row.total.count(), row.platform.accepted_count);
        print_line(&format!(
            "{}: {} ping sets sent, {answered} commands seen, {applied} applied, {} sets dropped, on {}",
            row.load,
            row.sent,
            row.health.dropped_count,
            row.health.adapter_name()
        ))?;
    }
    Ok(())
}

fn print_row(what: &str, load: &str, times: &Quantiles) -> Result<(), Failure> {
    let [p50, p99, p999, max] = [0.5, 0.99, 0.999, 1.0].map(|share| times.at(share));
    let count = times.count();
    print_line(&format!("{what:44} {load:>6} {count:>8} {p50:>8.3} {p99:>8.3} {p999:>8.3} {max:>8.3}"))
}

impl Measured {
    fn json(&self) -> Value {
        json!({
            "source": "live",
            "load": self.load,
            "to_controller": self.total.json(),
            "to_published": self.decided.json(),
            "ping_sets_sent": self.sent,
            "commands_applied": self.platform.accepted_count,
            "drops": self.health.dropped_count,
            "backend": if self.health.backend == 1 { "gpu" } else { "cpu" },
            "adapter": self.health.adapter_name(),
        })
    }
}

/// Threads that keep every core at work.
struct Busy(Arc<AtomicBool>);

impl Busy {
    fn start() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        for _ in 0..cores() {
            let stop = Arc::clone(&stop);
            std::thread::spawn(move || {
                let mut value = 1.0_f64;
                while !stop.load(Ordering::Relaxed) {
                    value = std::hint::black_box(value.sqrt() + 1.0);
                }
            });
        }
        Self(stop)
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The driver's side of all sensors.
struct Driver {
    publishers: Vec<RawPublisher>,
    input: InputPublisher,
    sets: Vec<PingSet>,
    recording_ns: u64,
    slot_ns: u64,
    sent: u64,
}

impl Driver {
    fn open(ipc: &Ipc, config: &Config, setup: &SensingSetup, sets: Vec<PingSet>) -> Result<Self, Failure> {
        let publisher = |(sensor, shape): (String, RawShape)| {
            RawPublisher::open(ipc, &sensor, shape).map_err(|error| ipc_failure(&error))
        };
        Ok(Self {
            publishers: setup.raw_shapes().into_iter().map(publisher).collect::<Result<_, _>>()?,
            input: InputPublisher::open(ipc, false).map_err(|error| ipc_failure(&error))?,
            sets,
            recording_ns: (config.set_duration_s(&setup.recording) * 1e9) as u64,
            slot_ns: config.slot_ns(),
            sent: 0,
        })
    }

    /// Publishes the next ping of every sensor, whose last sample is now, and wants to drive on.
    fn send(&mut self) -> Result<(), Failure> {
        let count = self.sets.len() as u64;
        let set = &mut self.sets[(self.sent % count) as usize];
        let now = SystemClock.now();
        let emitted_at = Stamp {
            boottime_ns: now.boottime_ns.saturating_sub(self.recording_ns),
            wall_ns: now.wall_ns.saturating_sub(self.recording_ns),
        };
        self.sent += 1;
        for (publisher, ping) in self.publishers.iter().zip(&mut set.pings) {
            let turn_ns = self.slot_ns * ping.sensor_index as u64;
            (ping.emitted_at, ping.sequence) = (emitted_at.plus_ns(turn_ns), self.sent);
            publisher.publish(ping).map_err(|error| ipc_failure(&error))?;
        }
        self.input.want(Velocity::forward_m_s(0.1), now).map_err(|error| ipc_failure(&error))
    }
}

fn measure(config: &Config, arguments: &BenchArguments, load: &'static str) -> Result<Measured, Failure> {
    let place = Place::new(config)?;
    let setup = wiring::sensing(&place.config).map_err(|error| Failure::new(exit::CONFIG, error))?;
    let sets = super::simulated_pings(&place.config, &setup)?;
    let stop = stop_flag()?;
    let ipc = Ipc::open(&place.config.ipc).map_err(|error| ipc_failure(&error))?;
    let mut driver = Driver::open(&ipc, &place.config, &setup, sets)?;
    let topics = StatusTopics::open(&ipc).map_err(|error| ipc_failure(&error))?;
    let period = PERIOD.max(Duration::from_nanos(driver.recording_ns));
    let mut daemon = Supervised::start("daemon", UNWATCHED, run_daemon(&place, arguments.backend)?)?;
    let mut controller = Supervised::start("controller", UNWATCHED, run_controller(&place)?)?;
    let mut heard = Heard::new(driver.recording_ns);
    let bar = progress(u64::from(arguments.sets), load);
    let (begin, mut next) = (Instant::now(), Instant::now());
    let mut base = None;
    let mut ended_at: Option<Instant> = None;
    while ended_at.is_none_or(|at| at.elapsed() < LAST_LIMIT) && heard.total_ms.len() < arguments.sets as usize {
        if stop.load(Ordering::Relaxed) {
            return Err(not_measured("stopped before the end"));
        }
        heard.look(&topics);
        bar.set_position(heard.total_ms.len() as u64);
        for process in [&mut daemon, &mut controller] {
            if !matches!(process.watch()?, Watched::Alive) {
                return Err(not_measured("a process of the measurement ended"));
            }
        }
        if heard.tracks && base.is_none() {
            base = Some(driver.sent);
        }
        let sent = base.map_or(0, |base| driver.sent - base);
        if base.is_none() && begin.elapsed() > START_LIMIT {
            return Err(not_measured(&heard.why_not()));
        }
        if sent >= u64::from(arguments.sets) {
            ended_at.get_or_insert_with(Instant::now);
        } else if Instant::now() >= next {
            driver.send()?;
            next = (next + period).max(Instant::now());
        }
        std::thread::sleep(LOOK_PAUSE.min(next.saturating_duration_since(Instant::now())));
    }
    bar.finish_and_clear();
    Ok(Measured {
        load,
        sent: base.map_or(0, |base| driver.sent - base),
        total: Quantiles::of(heard.total_ms),
        decided: Quantiles::of(heard.decided_ms),
        health: heard.health,
        platform: heard.platform,
    })
}

type Make = Box<dyn Fn(u64) -> Command + Send>;

fn child(place: &Place, given: &[&str]) -> Result<Make, Failure> {
    let program = std::env::current_exe()
        .map_err(|error| Failure::new(exit::INTERNAL, format!("where is this program? {error}")))?;
    let given: Vec<String> = given.iter().map(|text| (*text).to_owned()).collect();
    let file = place.file();
    Ok(Box::new(move |_| {
        let mut command = Command::new(&program);
        command.arg("--quiet").args(&given).arg("--config").arg(&file).stdin(Stdio::null()).stdout(Stdio::null());
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        command
    }))
}

fn run_daemon(place: &Place, backend: Option<BackendArgument>) -> Result<Make, Failure> {
    let backend = backend.and_then(|backend| clap::ValueEnum::to_possible_value(&backend));
    let mut given = vec!["run", "--source", "live"];
    if let Some(value) = &backend {
        given.extend(["--backend", value.get_name()]);
    }
    child(place, &given)
}

fn run_controller(place: &Place) -> Result<Make, Failure> {
    child(place, &["controller", "--arm"])
}

/// What was heard of both processes.
struct Heard {
    recording_ns: u64,
    tracks: bool,
    last_command: u64,
    last_published: u64,
    total_ms: Vec<f64>,
    decided_ms: Vec<f64>,
    command: Option<VelocityCommand>,
    health: Health,
    platform: PlatformVelocity,
}

impl Heard {
    fn new(recording_ns: u64) -> Self {
        Self {
            recording_ns,
            tracks: false,
            last_command: 0,
            last_published: 0,
            total_ms: Vec::new(),
            decided_ms: Vec::new(),
            command: None,
            health: Health::blank(),
            platform: PlatformVelocity::blank(),
        }
    }

    fn look(&mut self, topics: &StatusTopics) {
        self.health = topics.health().unwrap_or(self.health);
        let since = |captured_ns: u64, then_ns: u64| {
            then_ns.wrapping_sub(captured_ns + self.recording_ns).cast_signed() as f64 * 1e-6
        };
        while let Some(platform) = topics.next_platform() {
            self.platform = platform;
            let begins = !self.tracks && platform.state == GateState::Track.number();
            if begins {
                self.tracks = true;
            } else if self.tracks && platform.command_sequence > self.last_command {
                self.total_ms.push(since(platform.command_t_monotonic_ns, platform.command_received_ns));
            }
            self.last_command = platform.command_sequence;
        }
        if let Some(command) = topics.command() {
            if self.tracks && command.sequence > self.last_published {
                self.decided_ms.push(since(command.t_monotonic_ns, command.t_published_ns));
            }
            self.last_published = command.sequence;
            self.command = Some(command);
        }
    }

    /// Why the controller does not move the robot, in words.
    fn why_not(&self) -> String {
        let daemon = self.command.and_then(|command| Some((command.daemon_state()?, command.reason)));
        let reason = |number| crate::signal::Reason::from_number(number).map_or("-", |reason| reason.as_str());
        match daemon {
            None => "no command within 15 s of the start".to_owned(),
            Some((state, why)) => {
                format!(
                    "not moving within 15 s: daemon {} ({}), controller {}",
                    state.as_str(),
                    reason(why),
                    reason(self.platform.reason)
                )
            }
        }
    }
}
