//! `noctule status`: one look at a running system: who lives, whether the robot moves and why, and what is not well.
//!
//! In: the topics that daemon and controller publish, for at most [`LISTEN_LIMIT`]. Out: lines with ages, or one JSON object,
//! and findings with a remedy each. Listens only; where nobody lives it makes nothing either.

use super::args::StatusArguments;
use super::output::{is_printed, print_line};
use super::run::{ipc_failure, prefer_pcm, stop_flag};
use super::{Failure, exit};
use crate::config::Config;
use crate::io::survey::Survey;
use crate::io::topics::Topic;
use crate::io::wire::message::VelocityCommand;
use crate::io::wire::telemetry::{Health, PlatformVelocity};
use crate::io::{Ipc, StatusTopics};
use crate::signal::{DaemonState, GateState, Reason};
use crate::time::{Clock as _, Stamp, SystemClock};
use serde_json::{Value, json};
use std::io::IsTerminal as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

mod advice;
mod lines;

/// Shortest listening: ten commands and fifty ticks of the controller.
const LISTEN: Duration = Duration::from_millis(1_000);
/// Longest listening, for those that were not heard yet: health comes once a second at least.
const LISTEN_LIMIT: Duration = Duration::from_millis(2_500);
/// Pause between two looks at the topics.
const LOOK_PAUSE: Duration = Duration::from_millis(5);
/// Who only listens to raw pings.
const LISTENERS: [&str; 4] = ["noctule-daemon", "noctule-live", "noctule-echo", "noctule-status"];
/// Pause between two reports of `--watch`.
const WATCH_PAUSE: Duration = Duration::from_millis(500);

/// What was heard within one look.
#[derive(Default)]
struct Heard {
    health: Option<Health>,
    first_health: Option<Health>,
    command: Option<VelocityCommand>,
    platform: Option<PlatformVelocity>,
    first_platform: Option<PlatformVelocity>,
}

/// A look: what was heard, who lives, and when it ended.
struct Look<'a> {
    config: &'a Config,
    survey: Survey,
    publishers: Vec<(String, Vec<u32>)>,
    heard: Heard,
    now: Stamp,
}

/// Looks once, or again and again.
///
/// # Errors
/// Exit 1 with a finding, 69 where nobody lives, 78, and the codes of the transport.
pub fn status(arguments: &StatusArguments) -> Result<(), Failure> {
    let mut config = super::config::load(&arguments.choice)?;
    prefer_pcm(&mut config);
    let stop = stop_flag()?;
    loop {
        let look = take_look(&config, &stop)?;
        let findings = advice::findings(&look);
        if arguments.json {
            let found: Vec<Value> =
                findings.iter().map(|one| json!({"found": one.found, "remedy": one.remedy})).collect();
            let mut object = look.json();
            object["findings"] = json!(found);
            print_line(&object.to_string())?;
        } else {
            let text = look.text(&findings);
            // A page that is drawn anew on a terminal; elsewhere one after the other.
            let start = if arguments.watch && std::io::stdout().is_terminal() { "\x1b[H\x1b[2J" } else { "" };
            if !is_printed(&format!("{start}{}", text.trim_end()))? {
                return Ok(());
            }
        }
        if !arguments.watch || stop.load(Ordering::Relaxed) {
            return if findings.is_empty() { Ok(()) } else { Err(Failure::new(exit::FINDING, "")) };
        }
        std::thread::sleep(WATCH_PAUSE);
    }
}

fn take_look<'a>(config: &'a Config, stop: &AtomicBool) -> Result<Look<'a>, Failure> {
    let sensors: Vec<String> = config.sensor.iter().map(|sensor| sensor.name.clone()).collect();
    let take_survey = || Survey::take(&config.ipc, Topic::all(&sensors, config.recording.format));
    let survey = take_survey();
    if !survey.is_inhabited() {
        let message = format!(
            "nobody runs under {} with prefix {}: start `noctule demo`, or `noctule run` and `noctule controller`, with the same \
             --config; `noctule doctor` looks for what prevents a start",
            survey.root_path.display(),
            survey.prefix
        );
        return Err(Failure::new(exit::UNAVAILABLE, message));
    }
    let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
    let open = || StatusTopics::open(&ipc).map_err(|error| ipc_failure(&error));
    let topics = open()?;
    let heard = listen(&topics, stop);
    let now = SystemClock.now();
    drop(topics);
    // Who lives is asked last: somebody may have started while we listened. Our own ports are gone by then.
    let publishers = open()?.publishers().to_vec();
    let survey = take_survey();
    Ok(Look { config, survey, publishers, heard, now })
}

fn listen(topics: &StatusTopics, stop: &AtomicBool) -> Heard {
    let begun = Instant::now();
    let mut heard = Heard::default();
    loop {
        if let Some(health) = topics.health() {
            heard.first_health.get_or_insert(health);
            heard.health = Some(health);
        }
        heard.command = topics.command().or(heard.command);
        while let Some(platform) = topics.next_platform() {
            heard.first_platform.get_or_insert(platform);
            heard.platform = Some(platform);
        }
        // A rate needs two reports of the daemon, some time apart.
        let spaced = heard.first_health.zip(heard.health).is_some_and(|(a, b)| b.t_monotonic_ns > a.t_monotonic_ns);
        let all = spaced && heard.command.is_some() && heard.platform.is_some();
        let elapsed = begun.elapsed();
        if elapsed >= LISTEN_LIMIT || all && elapsed >= LISTEN || stop.load(Ordering::Relaxed) {
            return heard;
        }
        std::thread::sleep(LOOK_PAUSE);
    }
}

impl Look<'_> {
    fn age_s(&self, t_monotonic_ns: u64) -> f64 {
        self.now.since_ns(Stamp { boottime_ns: t_monotonic_ns, wall_ns: 0 }) as f64 * 1e-9
    }

    fn daemon(&self) -> Option<(DaemonState, Reason)> {
        let health = self.heard.health.map(|health| (health.state, health.reason));
        let (state, reason) = self.heard.command.map(|command| (command.state, command.reason)).or(health)?;
        Some((DaemonState::from_number(state)?, Reason::from_number(reason)?))
    }

    fn controller(&self) -> Option<(GateState, Reason)> {
        let platform = self.heard.platform?;
        Some((GateState::from_number(platform.state)?, Reason::from_number(platform.reason)?))
    }

    /// Ping sets a second within the look.
    fn ping_rate_hz(&self) -> Option<f64> {
        let (first, last) = self.heard.first_health.zip(self.heard.health)?;
        let time_s = last.t_monotonic_ns.checked_sub(first.t_monotonic_ns)? as f64 * 1e-9;
        let sets = last.ping_set_count.checked_sub(first.ping_set_count)? as f64;
        (time_s > 0.2).then(|| sets / time_s)
    }

    fn sensor_name(&self, index: u32) -> Option<&str> {
        self.config.sensor.get(index as usize).map(|sensor| sensor.name.as_str())
    }

    /// Who published on each topic that leads to motion; on raw pings whoever is neither daemon nor listener.
    fn publishers(&self) -> Vec<(String, String)> {
        let services = || self.survey.services.iter().flatten();
        let named = |process: &u32| {
            let all = self.survey.participants.iter().flatten();
            // A process may have several registrations; the shortest name is its own.
            let name = all
                .filter(|one| one.process == Some(*process))
                .map(|one| one.name.as_str())
                .min_by_key(|name| name.len());
            format!("{} {process}", name.unwrap_or("process"))
        };
        let known = self.publishers.iter().map(|(service, processes)| {
            let told: Vec<String> = processes.iter().map(named).collect();
            (service.clone(), if told.is_empty() { "nobody".to_owned() } else { told.join(", ") })
        });
        let raw =
            services().filter(|one| one.name.starts_with("noctule/sonar/") && !one.name.ends_with("/energyscape"));
        let drivers = raw.map(|service| {
            let others = service.participants.iter().filter(|one| one.alive && !LISTENERS.contains(&one.name.as_str()));
            let told: Vec<String> = others.filter_map(|one| Some(format!("{} {}", one.name, one.process?))).collect();
            (service.name.clone(), if told.is_empty() { "no driver".to_owned() } else { told.join(", ") })
        });
        known.chain(drivers).collect()
    }
}
