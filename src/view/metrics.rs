//! `/metrics`, the numbers of daemon, controller and page in Prometheus' text format, and `/healthz`, one word on them.
//!
//! Goes in: the newest moment. Comes out: text, version 0.0.4 of the format. What a daemon or controller that is not heard any more
//! once said is left out and not repeated: what remains is how long ago it spoke. Counts begin with the process that counts.

use super::board::{LATENCY_BOUNDS_S, Moment};
use super::server::Shared;
use crate::io::wire::message::{backend_name, layer_name};
use crate::io::wire::telemetry::Health;
use crate::signal::{DaemonState, GateState};
use crate::time::{Clock, SystemClock};
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::fmt::Write as _;
use std::sync::Arc;

/// A daemon that said nothing for so long is not heard: it speaks once a second at least.
pub const DAEMON_SILENCE_NS: u64 = 3_000_000_000;
/// The same for the controller, which speaks 50 times a second.
pub const CONTROLLER_SILENCE_NS: u64 = 1_000_000_000;

/// Writes families of samples.
#[derive(Default)]
struct Page(String);

impl Page {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        let quoted = |(name, value): &(&str, &str)| {
            let value = value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
            format!("{name}=\"{value}\"")
        };
        let labels = labels.iter().map(quoted).collect::<Vec<_>>().join(",");
        let braces = if labels.is_empty() { String::new() } else { format!("{{{labels}}}") };
        let value = match value {
            value if value.is_nan() => "NaN".to_owned(),
            value if value.is_infinite() => if value > 0.0 { "+Inf" } else { "-Inf" }.to_owned(),
            value => value.to_string(),
        };
        let _ = writeln!(self.0, "{name}{braces} {value}");
    }

    fn one(&mut self, name: &str, kind: &str, help: &str, value: f64) {
        self.family(name, kind, help);
        self.sample(name, &[], value);
    }
}

fn is_heard(t_ns: Option<u64>, now_ns: u64, limit_ns: u64) -> bool {
    t_ns.is_some_and(|t_ns| Moment::age_ns(t_ns, now_ns) <= limit_ns)
}

/// All numbers of a moment at `now_ns`; `viewers` are open pages and players.
#[must_use]
pub fn exposition(moment: &Moment, sensors: &[String], viewers: [usize; 2], now_ns: u64) -> String {
    let mut page = Page::default();
    let daemon = is_heard(moment.daemon_heard_ns(), now_ns, DAEMON_SILENCE_NS);
    let controller = is_heard(moment.controller_heard_ns(), now_ns, CONTROLLER_SILENCE_NS);
    page.one("noctule_daemon_up", "gauge", "1 while the daemon is heard.", f64::from(u8::from(daemon)));
    page.one("noctule_controller_up", "gauge", "1 while the controller is heard.", f64::from(u8::from(controller)));
    ages(&mut page, moment, sensors, now_ns);
    counted_here(&mut page, moment, sensors, viewers);
    if let Some(health) =
        moment.health.filter(|health| is_heard(Some(health.t_monotonic_ns), now_ns, DAEMON_SILENCE_NS))
    {
        daemon_counts(&mut page, &health);
        sensor_health(&mut page, &health, sensors);
        latencies(&mut page, &health);
        let labels =
            [("backend", backend_name(health.backend).unwrap_or("unknown")), ("adapter", &health.adapter_name())];
        page.family("noctule_backend_info", "gauge", "What images, as labels; always 1.");
        page.sample("noctule_backend_info", &labels, 1.0);
    }
    if daemon {
        commanded(&mut page, moment);
    }
    if controller {
        driven(&mut page, moment);
    }
    page.0
}

fn ages(page: &mut Page, moment: &Moment, sensors: &[String], now_ns: u64) {
    page.family(
        "noctule_message_age_seconds",
        "gauge",
        "Age of the newest message of a topic; absent if none was heard.",
    );
    let mut age = |topic: &str, t_ns: Option<u64>| {
        if let Some(t_ns) = t_ns {
            let age_s = Moment::age_ns(t_ns, now_ns) as f64 * 1e-9;
            page.sample("noctule_message_age_seconds", &[("topic", topic)], age_s);
        }
    };
    age("noctule/command", moment.command.map(|command| command.t_published_ns));
    age("noctule/platform", moment.platform.map(|platform| platform.t_monotonic_ns));
    age("noctule/cues", moment.cues.map(|cues| cues.t_monotonic_ns));
    age("noctule/health", moment.health.map(|health| health.t_monotonic_ns));
    for (sensor, image) in sensors.iter().zip(&moment.images) {
        let topic = crate::io::topics::energyscape(sensor);
        age(&topic, image.as_ref().map(|image| image.header.t_monotonic_ns));
    }
}

fn counted_here(page: &mut Page, moment: &Moment, sensors: &[String], [pages, players]: [usize; 2]) {
    let counts = &moment.counts;
    page.family(
        "noctule_commands_by_layer_total",
        "counter",
        "Commands heard by this page's process, by the layer that decided.",
    );
    for (number, count) in counts.layers.iter().enumerate() {
        let layer = layer_name(number as u32).unwrap_or("unknown");
        page.sample("noctule_commands_by_layer_total", &[("layer", layer)], *count as f64);
    }
    page.family("noctule_energyscapes_total", "counter", "Energyscapes heard by this page's process, by sensor.");
    for (sensor, count) in sensors.iter().zip(counts.images) {
        page.sample("noctule_energyscapes_total", &[("sensor", sensor)], count as f64);
    }
    page.one(
        "noctule_daemon_restarts_total",
        "counter",
        "Other starts of the daemon heard by this page's process.",
        counts.epochs as f64,
    );
    let name = "noctule_latency_seconds";
    page.family(name, "histogram", "Last sample to command published, of the ping sets heard by this page's process.");
    let mut sum = 0;
    for (bound, count) in LATENCY_BOUNDS_S.iter().zip(&counts.latency) {
        sum += count;
        page.sample("noctule_latency_seconds_bucket", &[("le", &bound.to_string())], sum as f64);
    }
    sum += counts.latency[LATENCY_BOUNDS_S.len()];
    page.sample("noctule_latency_seconds_bucket", &[("le", "+Inf")], sum as f64);
    page.sample("noctule_latency_seconds_sum", &[], counts.latency_sum_s);
    page.sample("noctule_latency_seconds_count", &[], sum as f64);
    page.family("noctule_view_clients", "gauge", "Who looks at this page's process.");
    page.sample("noctule_view_clients", &[("kind", "page")], pages as f64);
    page.sample("noctule_view_clients", &[("kind", "foxglove")], players as f64);
}

fn daemon_counts(page: &mut Page, health: &Health) {
    for (name, help, count) in [
        ("noctule_ping_sets_total", "Ping sets imaged.", health.ping_set_count),
        ("noctule_ping_sets_dropped_total", "Ping sets dropped because newer ones were there.", health.dropped_count),
        ("noctule_ping_sets_late_total", "Ping sets not ready in time.", health.late_count),
        ("noctule_commands_total", "Commands published.", health.command_count),
        ("noctule_stops_total", "Times that the daemon went to STOPPED.", health.stop_count),
        ("noctule_gpu_losses_total", "GPUs lost.", health.gpu_loss_count),
    ] {
        page.one(name, "counter", help, count as f64);
    }
    let spread_s = health.desync_ns as f64 * 1e-9;
    page.one("noctule_desync_seconds", "gauge", "Spread of the emission times of the newest ping set.", spread_s);
}

fn sensor_health(page: &mut Page, health: &Health, sensors: &[String]) {
    let present = |index: usize| f64::from(u8::from(health.delivers(index)));
    let families: [(&str, &str, &str, &dyn Fn(usize) -> f64); 6] = [
        ("noctule_sensor_present", "gauge", "1 when the sensor delivered in the newest ping set.", &present),
        ("noctule_bad_channels", "gauge", "Channels left out of the image.", &|index| {
            f64::from(health.bad_channel_count[index])
        }),
        ("noctule_pings_rejected_total", "counter", "Pings rejected.", &|index| health.rejected_count[index] as f64),
        ("noctule_ping_gaps_total", "counter", "Pings that came after missing ones.", &|index| {
            health.gap_count[index] as f64
        }),
        ("noctule_drift_alarms", "gauge", "What has drifted, as the bits of noctule/health; 0 is nothing.", &|index| {
            f64::from(health.drift[index])
        }),
        (
            "noctule_heard_speed_of_sound_m_s",
            "gauge",
            "Speed of sound that the direct path tells; 0 while it is not known.",
            &|index| health.heard_speed_m_s[index],
        ),
    ];
    for (name, kind, help, value) in families {
        page.family(name, kind, help);
        for (index, sensor) in sensors.iter().enumerate().take(health.bad_channel_count.len()) {
            page.sample(name, &[("sensor", sensor)], value(index));
        }
    }
}

fn latencies(page: &mut Page, health: &Health) {
    let name = "noctule_daemon_latency_seconds";
    page.family(
        name,
        "gauge",
        "Last sample to command published, as the daemon tells it, since its start but for the newest.",
    );
    for (statistic, latency_ms) in [
        ("newest", health.latency_ms),
        ("p50", health.latency_p50_ms),
        ("p99", health.latency_p99_ms),
        ("max", health.latency_max_ms),
    ] {
        page.sample(name, &[("statistic", statistic)], latency_ms * 1e-3);
    }
    page.family("noctule_stage_seconds", "gauge", "Time of a stage of imaging in the newest ping set.");
    let stages = ["demodulate", "matched_filter", "delay_and_sum", "envelope", "masked_energy"];
    for (stage, time_ms) in stages.into_iter().zip(health.stage_ms) {
        page.sample("noctule_stage_seconds", &[("stage", stage)], time_ms * 1e-3);
    }
}

/// One sample for every state there is, 1 for the one that holds.
fn states(page: &mut Page, name: &str, help: &str, names: &[(u32, &str)], number: u32) {
    page.family(name, "gauge", help);
    for (state, text) in names {
        page.sample(name, &[("state", text)], f64::from(u8::from(*state == number)));
    }
}

fn commanded(page: &mut Page, moment: &Moment) {
    let command = moment.command.map(|command| (command.t_published_ns, command.state));
    let health = moment.health.map(|health| (health.t_monotonic_ns, health.state));
    if let Some((_, state)) = command.max(health) {
        states(page, "noctule_daemon_state", "State of the daemon.", DaemonState::NAMES, state);
    }
    let Some(command) = moment.command else { return };
    let (linear, angular) = ("noctule_command_linear_meters_per_second", "noctule_command_angular_radians_per_second");
    page.one(linear, "gauge", "Forward speed of the newest command.", command.linear_m_s);
    page.one(angular, "gauge", "Turn rate of the newest command, counter-clockwise.", command.angular_rad_s);
    page.one(
        "noctule_stuck",
        "gauge",
        "1 when there is no progress although motion is asked for.",
        f64::from(command.stuck.min(1)),
    );
}

fn driven(page: &mut Page, moment: &Moment) {
    let Some(platform) = moment.platform else { return };
    states(page, "noctule_controller_state", "State of the controller.", GateState::NAMES, platform.state);
    for (name, help, count) in [
        (
            "noctule_controller_commands_received_total",
            "Commands that the controller received.",
            platform.received_count,
        ),
        ("noctule_controller_commands_accepted_total", "Commands that it followed.", platform.accepted_count),
        ("noctule_controller_commands_refused_total", "Commands that it refused.", platform.refused_count),
    ] {
        page.one(name, "counter", help, count as f64);
    }
    let (linear, angular) =
        ("noctule_platform_linear_meters_per_second", "noctule_platform_angular_radians_per_second");
    page.one(linear, "gauge", "Forward speed that the platform is told to drive.", platform.linear_m_s);
    page.one(
        angular,
        "gauge",
        "Turn rate that the platform is told to drive, counter-clockwise.",
        platform.angular_rad_s,
    );
}

pub(super) async fn metrics(State(shared): State<Arc<Shared>>) -> Response {
    let moment = Arc::clone(&shared.reader.moments.borrow());
    let viewers = [shared.audience.pages(), shared.audience.players()];
    let text = exposition(&moment, &shared.robot.sensor_names(), viewers, SystemClock.now().boottime_ns);
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response()
}

/// 200 while the daemon is heard and not in FAULT, else 503; with a line that says why. Asks for no token and tells nothing else.
pub(super) async fn healthz(State(shared): State<Arc<Shared>>) -> Response {
    let moment = Arc::clone(&shared.reader.moments.borrow());
    let (healthy, line) = verdict(&moment, SystemClock.now().boottime_ns);
    let status = if healthy { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (status, format!("{line}\n")).into_response()
}

/// Whether all is well, in a line.
#[must_use]
pub fn verdict(moment: &Moment, now_ns: u64) -> (bool, &'static str) {
    if !is_heard(moment.daemon_heard_ns(), now_ns, DAEMON_SILENCE_NS) {
        return (false, "no daemon is heard");
    }
    let command = moment.command.map(|command| (command.t_published_ns, command.state));
    let health = moment.health.map(|health| (health.t_monotonic_ns, health.state));
    match command.max(health).and_then(|(_, state)| DaemonState::from_number(state)) {
        Some(DaemonState::Fault) => (false, "the daemon is in FAULT"),
        Some(_) => (true, "ok"),
        None => (false, "the daemon's state is unknown"),
    }
}
