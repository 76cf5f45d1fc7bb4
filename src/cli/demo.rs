//! `noctule demo`: daemon with simulator and controller as two processes, watched and summed up by this one, and the live
//! page as a third.
//!
//! The parent is what systemd is on a robot: it starts both, starts again what dies, and ends both. It only listens
//! to the topics; what it prints is what any other process could print.

#[cfg(feature = "view")]
mod page;

use super::args::DemoArguments;
use super::output::print_line;
use super::run::{ipc_failure, load_world, prefer_pcm, stop_flag};
use super::{Failure, exit};
use crate::config::Config;
use crate::io::wire::message::VelocityCommand;
use crate::io::wire::telemetry::{Health, PlatformVelocity};
use crate::io::{Ipc, StatusTopics};
use crate::service::supervisor::{CONTROLLER_TERMS, DAEMON_TERMS, Supervised, Watched};
use crate::service::wiring;
use crate::signal::{DaemonState, GateState, LayerName};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::{Map, Value, json};
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

#[cfg(feature = "view")]
use page::Page;

/// The program was built without the page.
#[cfg(not(feature = "view"))]
struct Page;

#[cfg(not(feature = "view"))]
impl Page {
    fn address(&self) -> Option<String> {
        None
    }
}

/// Pause between two looks at the topics: commands come every 100 ms, what the platform is told every 20 ms.
const LOOK_PAUSE: Duration = Duration::from_millis(10);
/// Longest wait for the first ping set.
const START_LIMIT: Duration = Duration::from_secs(15);

/// Runs the demo.
///
/// # Errors
/// 65 for a bad world, 69 when nothing starts, 78, and the code of a process that had to be given up.
pub fn demo(arguments: &DemoArguments) -> Result<(), Failure> {
    let mut config = super::config::load(&arguments.choice)?;
    prefer_pcm(&mut config);
    load_world(arguments.world.as_deref())?;
    let recording = config.recording().map_err(|error| Failure::new(exit::CONFIG, error))?;
    let recording_ns = (config.set_duration_s(&recording) * 1e9) as u64;
    wiring::sensing(&config).map_err(|error| Failure::new(exit::CONFIG, error))?;
    let stop = stop_flag()?;
    let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
    let mut topics = Some(StatusTopics::open(&ipc).map_err(|error| ipc_failure(&error))?);
    let mut tally = Tally::new(&config, recording_ns);
    let line = status_line(arguments);
    let ended = {
        // Declared first and so ended last: nothing waits for it while the robot is to stop.
        let mut page;
        let mut daemon = start_daemon(arguments)?;
        let mut controller = start_controller(arguments)?;
        page = start_page(arguments)?;
        let begin = Instant::now();
        let mut first_set_at = None;
        loop {
            if stop.load(Ordering::Relaxed) {
                break Ok(());
            }
            if let Some(topics) = &topics {
                tally.look(topics);
            }
            beat(&mut tally, &mut daemon, &mut controller);
            if tally.heard_command && first_set_at.is_none() {
                first_set_at = Some(Instant::now());
            }
            let limit = arguments.duration.map(Duration::from_secs_f64);
            if first_set_at.zip(limit).is_some_and(|(first, limit)| first.elapsed() >= limit) {
                break Ok(());
            }
            if first_set_at.is_none() && begin.elapsed() > START_LIMIT {
                break Err(Failure::new(exit::UNAVAILABLE, "no ping set within 15 s of the start"));
            }
            match (daemon.watch()?, controller.watch()?) {
                (Watched::GivenUp(code), _) | (_, Watched::GivenUp(code)) => {
                    break Err(Failure::new(code, "the demo ends: a process had to be given up"));
                }
                (Watched::Finished, _) => break Ok(()),
                (Watched::Stuck, _) | (_, Watched::Stuck) => {
                    // Ours go first: what is wiped must not be in use.
                    drop((topics.take(), page.take()));
                    wipe_and_start_again(&config, &mut daemon, &mut controller)?;
                    topics = Some(open_status(&config)?);
                    page = start_page(arguments)?;
                }
                _ => {}
            }
            show(line.as_ref(), page.as_ref().and_then(Page::address), &tally);
            std::thread::sleep(LOOK_PAUSE);
        }
        // Counted up to here; then the controller ends first: it says zero while the daemon still speaks.
    };
    if let Some(line) = line {
        line.finish_and_clear();
    }
    tally.print(arguments.json)?;
    ended
}

fn open_status(config: &Config) -> Result<StatusTopics, Failure> {
    let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
    StatusTopics::open(&ipc).map_err(|error| ipc_failure(&error))
}

/// Hands on what the processes did since the last look.
fn beat(tally: &mut Tally, daemon: &mut Supervised, controller: &mut Supervised) {
    let sets = tally.health.map(|health| (health.epoch, health.ping_set_count)).filter(|(_, count)| *count > 0);
    if sets.is_some() && sets != tally.beaten.0 {
        tally.beaten.0 = sets;
        daemon.beat();
    }
    let ticks = tally.platform.map(|platform| platform.t_monotonic_ns);
    if ticks.is_some() && ticks != tally.beaten.1 {
        tally.beaten.1 = ticks;
        controller.beat();
    }
}

/// After exit code 75: both down, every file of theirs away, both up. Nobody arms for the second time but a person.
fn wipe_and_start_again(config: &Config, daemon: &mut Supervised, controller: &mut Supervised) -> Result<(), Failure> {
    controller.end();
    daemon.end();
    let count = crate::io::wipe(&config.ipc).map_err(|error| ipc_failure(&error))?;
    log::warn!("communication was stuck: {count} files were wiped, daemon and controller start again");
    daemon.start_again();
    controller.start_again();
    Ok(())
}

/// A line that is drawn over and over on a terminal; elsewhere nothing.
fn status_line(arguments: &DemoArguments) -> Option<ProgressBar> {
    if arguments.headless {
        return None;
    }
    let line = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(10));
    if line.is_hidden() {
        return None;
    }
    if let Ok(style) = ProgressStyle::with_template("{wide_msg}") {
        line.set_style(style);
    }
    Some(line)
}

/// The status, and the page's address when it is told.
fn show(line: Option<&ProgressBar>, address: Option<String>, tally: &Tally) {
    if let Some(address) = address {
        match line {
            Some(line) => line.println(format!("live page: {address}")),
            None => log::info!("live page: {address}"),
        }
    }
    if let Some(line) = line {
        line.set_message(tally.status());
    }
}

/// The live page, unless nobody is to look.
#[cfg(feature = "view")]
fn start_page(arguments: &DemoArguments) -> Result<Option<Page>, Failure> {
    let program = this_program()?;
    Ok(if arguments.headless { None } else { Page::start(&program, arguments) })
}

#[cfg(not(feature = "view"))]
fn start_page(_: &DemoArguments) -> Result<Option<Page>, Failure> {
    Ok(None)
}

fn this_program() -> Result<std::path::PathBuf, Failure> {
    std::env::current_exe().map_err(|error| Failure::new(exit::INTERNAL, format!("where is this program? {error}")))
}

fn start_daemon(arguments: &DemoArguments) -> Result<Supervised, Failure> {
    let program = this_program()?;
    let mut given: Vec<std::ffi::OsString> = vec!["--quiet".into(), "run".into(), "--seed".into()];
    given.push(arguments.seed.to_string().into());
    if let Some(path) = &arguments.choice.config {
        given.extend(["--config".into(), path.into()]);
    }
    let mut source = std::ffi::OsString::from("sim");
    if let Some(world) = &arguments.world {
        source.push(":");
        source.push(world);
    }
    given.extend(["--source".into(), source]);
    if let Some(backend) = arguments.backend.and_then(|backend| clap::ValueEnum::to_possible_value(&backend)) {
        given.extend(["--backend".into(), backend.get_name().into()]);
    }
    if let Some(path) = &arguments.record {
        given.extend(["--record".into(), path.into()]);
    }
    Ok(Supervised::start("daemon", DAEMON_TERMS, move |_| child(&program, &given))?)
}

fn start_controller(arguments: &DemoArguments) -> Result<Supervised, Failure> {
    let program = this_program()?;
    let mut given: Vec<std::ffi::OsString> = vec!["--quiet".into(), "controller".into()];
    if let Some(path) = &arguments.choice.config {
        given.extend(["--config".into(), path.into()]);
    }
    // The demo arms itself at its start; a controller that died may only be armed by a person.
    Ok(Supervised::start("controller", CONTROLLER_TERMS, move |earlier| {
        let mut command = child(&program, &given);
        if earlier == 0 {
            command.arg("--arm");
        }
        command
    })?)
}

/// A child whose talk goes to our standard error: standard output is for the summary.
fn child(program: &std::path::Path, given: &[std::ffi::OsString]) -> Command {
    let mut command = Command::new(program);
    // Whoever supervises the demo hears of the demo, not of its children.
    command.args(given).stdin(Stdio::null()).stdout(Stdio::null()).env_remove("NOTIFY_SOCKET");
    // Ctrl-C on the terminal reaches the demo alone, which then ends both in order.
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
}

/// What the demo has seen.
struct Tally {
    sensors: Vec<String>,
    recording_ns: u64,
    heard_command: bool,
    health: Option<Health>,
    command: Option<VelocityCommand>,
    platform: Option<PlatformVelocity>,
    /// Counters at the controller's first TRACK: everything is counted from there.
    base: Option<(Health, PlatformVelocity, u64)>,
    latencies_ms: Vec<f64>,
    layers: [u64; LAYERS.len()],
    last_sequence: u64,
    /// The last beat of the daemon (epoch and ping sets) and of the controller (its newest stamp).
    beaten: (Option<(u64, u64)>, Option<u64>),
}

const LAYERS: [LayerName; 6] = LayerName::ALL;

impl Tally {
    fn new(config: &Config, recording_ns: u64) -> Self {
        Self {
            sensors: config.sensor.iter().map(|sensor| sensor.name.clone()).collect(),
            recording_ns,
            heard_command: false,
            health: None,
            command: None,
            platform: None,
            base: None,
            latencies_ms: Vec::new(),
            layers: [0; LAYERS.len()],
            last_sequence: 0,
            beaten: (None, None),
        }
    }

    fn look(&mut self, topics: &StatusTopics) {
        self.health = topics.health().or(self.health);
        if let Some(command) = topics.command() {
            self.heard_command |= command.t_monotonic_ns > 0;
            self.command = Some(command);
            if self.base.is_some()
                && let Some(count) = self.layers.get_mut(command.layer as usize)
            {
                *count += 1;
            }
        }
        while let Some(platform) = topics.next_platform() {
            self.platform = Some(platform);
            let tracks = platform.state == GateState::Track.number();
            if self.base.is_none()
                && tracks
                && let (Some(health), Some(command)) = (self.health, self.command)
            {
                self.base = Some((health, platform, command.sequence));
                self.last_sequence = platform.command_sequence;
            }
            if self.base.is_some() && platform.command_sequence > self.last_sequence {
                self.last_sequence = platform.command_sequence;
                let end_ns = platform.command_t_monotonic_ns + self.recording_ns;
                let latency_ns = platform.command_received_ns.wrapping_sub(end_ns).cast_signed();
                self.latencies_ms.push(latency_ns as f64 * 1e-6);
            }
        }
    }

    fn status(&self) -> String {
        let command = self.command.as_ref();
        let daemon = command.and_then(VelocityCommand::daemon_state).map_or("starting", DaemonState::as_str);
        let platform = self.platform.as_ref();
        let gate = platform.and_then(|platform| GateState::from_number(platform.state)).map_or("-", GateState::as_str);
        let (v, omega) = platform.map_or((0.0, 0.0), |platform| (platform.linear_m_s, platform.angular_rad_s));
        let layer = command.and_then(|command| LAYERS.get(command.layer as usize)).map_or("-", |layer| layer.as_str());
        let cause = command.and_then(|command| {
            let sensor = self.sensors.get(command.cause_sensor as usize)?;
            let bearing_deg = command.cause_bearing_rad.to_degrees();
            Some(format!(" by {sensor} {:.2} m {bearing_deg:+.0} deg", command.cause_range_m))
        });
        let latency = self.latencies_ms.last().map_or(String::new(), |latency| format!("  {latency:.1} ms"));
        format!("{daemon}/{gate}  {v:+.2} m/s {omega:+.2} rad/s  {layer}{}{latency}", cause.unwrap_or_default())
    }

    fn summary(&self) -> Value {
        let mut sorted = self.latencies_ms.clone();
        sorted.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let index = (share * sorted.len() as f64).ceil() as usize;
            sorted.get(index.max(1) - 1).copied()
        };
        let since = |now: fn(&Health) -> u64| {
            let base = self.base.as_ref().map_or(0, |(health, ..)| now(health));
            self.health.as_ref().map_or(0, now).saturating_sub(base)
        };
        let accepted = |platform: &PlatformVelocity| platform.accepted_count;
        let applied = match (&self.platform, &self.base) {
            (Some(now), Some((_, base, _))) => accepted(now).saturating_sub(accepted(base)),
            _ => 0,
        };
        let published = match (&self.command, &self.base) {
            (Some(command), Some((_, _, base))) => command.sequence.saturating_sub(*base),
            _ => 0,
        };
        let total: u64 = self.layers.iter().sum();
        let share = |count: u64| if total == 0 { 0.0 } else { count as f64 / total as f64 };
        let layers: Map<String, Value> = LAYERS
            .iter()
            .zip(self.layers)
            .map(|(layer, count)| (layer.as_str().to_owned(), json!(share(count))))
            .collect();
        json!({
            "ping_sets": since(|health| health.ping_set_count),
            "commands_published": published,
            "commands_applied": applied,
            "drops": since(|health| health.dropped_count),
            "latency_ms": {
                "p50": rank(0.50), "p99": rank(0.99), "p99_9": rank(0.999), "max": sorted.last(), "count": sorted.len()
            },
            "backend": self.health.as_ref().map_or("none", backend_of),
            "adapter": self.health.as_ref().map_or(String::new(), Health::adapter_name),
            "sensors": self.sensors,
            "layer_share": layers,
        })
    }

    fn print(&self, as_json: bool) -> Result<(), Failure> {
        let summary = self.summary();
        if as_json {
            return print_line(&summary.to_string());
        }
        let number = |value: &Value| value.as_f64().map_or("-".to_owned(), |number| format!("{number:.1}"));
        let latency = &summary["latency_ms"];
        print_line(&format!("sensors             {}", self.sensors.join(", ")))?;
        print_line(&format!("ping sets           {}", summary["ping_sets"]))?;
        print_line(&format!("commands published  {}", summary["commands_published"]))?;
        print_line(&format!("commands applied    {}", summary["commands_applied"]))?;
        print_line(&format!("drops               {}", summary["drops"]))?;
        print_line(&format!(
            "latency             p50 {} ms, p99 {} ms, max {} ms (last sample to command at the controller)",
            number(&latency["p50"]),
            number(&latency["p99"]),
            number(&latency["max"])
        ))?;
        let text = |value: &Value| value.as_str().unwrap_or("-").to_owned();
        print_line(&format!("backend             {}, {}", text(&summary["backend"]), text(&summary["adapter"])))?;
        for (layer, share) in summary["layer_share"].as_object().into_iter().flatten() {
            let share = share.as_f64().unwrap_or(0.0);
            if share > 0.0 {
                print_line(&format!("layer               {layer} {:.0} %", share * 100.0))?;
            }
        }
        Ok(())
    }
}

fn backend_of(health: &Health) -> &'static str {
    if health.backend == 1 { "gpu" } else { "cpu" }
}
