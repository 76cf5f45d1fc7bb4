//! What a look finds wrong, and what to do about it; and why the robot moves or stands.
//!
//! In: a look. Out: sentences. A robot that nobody armed is well: that is told as the reason why it stands, not as a finding.

use super::Look;
use crate::calibration::Alarms;
use crate::signal::{DaemonState, GateState, Reason};

/// Commands and reports older than this are no longer those of a living process.
const SILENT_S: f64 = 0.5;
/// Share of the configured rate of ping sets below which they come too rarely.
const RATE_MIN: f64 = 0.8;

/// Something that is not well.
pub(super) struct Finding {
    pub(super) found: String,
    pub(super) remedy: String,
}

fn finding(found: impl Into<String>, remedy: impl Into<String>) -> Finding {
    Finding { found: found.into(), remedy: remedy.into() }
}

pub(super) fn findings(look: &Look) -> Vec<Finding> {
    let mut all = Vec::new();
    daemon(look, &mut all);
    controller(look, &mut all);
    pings(look, &mut all);
    for service in look.survey.other_builds() {
        all.push(finding(
            format!("{} was made by another build", service.name),
            "stop the processes of the other build; `noctule doctor` names them",
        ));
    }
    all
}

fn daemon(look: &Look, all: &mut Vec<Finding>) {
    let Some((state, reason)) = look.daemon() else {
        let what = match look.survey.daemon {
            Some(process) => format!("the daemon (process {process}) holds its lock and says nothing"),
            None => "no daemon runs".to_owned(),
        };
        all.push(finding(what, "start `noctule run` with the same --config, or read its log"));
        return;
    };
    let silent_s = look.heard.command.map_or(f64::INFINITY, |command| look.age_s(command.t_published_ns));
    if silent_s > SILENT_S {
        all.push(finding(
            format!("no command was heard for {:.1} s", silent_s.min(999.0)),
            "the daemon hangs or starts: read its log; `noctule run` ends itself when it cannot go on",
        ));
    }
    match state {
        DaemonState::Fault => {
            all.push(finding(
                format!("the daemon is in FAULT: {reason}"),
                format!("{}; then `noctule reset` and `noctule arm`", cure(reason)),
            ));
        }
        DaemonState::Stopped | DaemonState::Degraded => {
            all.push(finding(format!("the daemon is {state}: {reason}"), cure(reason)));
        }
        _ => {}
    }
    if look.heard.command.is_some_and(|command| command.stuck != 0) {
        all.push(finding(
            "the robot makes no progress although motion is asked for",
            "free its way, or give another goal",
        ));
    }
}

fn controller(look: &Look, all: &mut Vec<Finding>) {
    let Some((state, reason)) = look.controller() else {
        all.push(finding(
            "no controller runs: nothing drives the platform",
            "start `noctule controller` with the same --config",
        ));
        return;
    };
    let remedy = match state {
        GateState::Hold => "it goes on by itself when fresh commands come",
        GateState::Latched if reason == Reason::OperatorStop => "`noctule arm` when the robot may move again",
        GateState::Latched => "remove the cause, then `noctule arm`",
        GateState::Wait | GateState::Track => return,
    };
    all.push(finding(format!("the controller is in {state}: {reason}"), remedy));
}

fn pings(look: &Look, all: &mut Vec<Finding>) {
    let Some(health) = look.heard.health else { return };
    let configured_hz = look.config.control.rate_hz;
    if let Some(rate_hz) = look.ping_rate_hz().filter(|rate_hz| *rate_hz < RATE_MIN * configured_hz) {
        all.push(finding(
            format!("{rate_hz:.1} ping sets a second, {configured_hz} are configured (control.rate_hz)"),
            "look at the drivers, at the load of the machine, and at `noctule bench`",
        ));
    }
    for (index, sensor) in look.config.sensor.iter().enumerate() {
        let (name, present) = (&sensor.name, health.delivers(index));
        if !present && health.ping_set_count > 0 {
            all.push(finding(
                format!("sensor {name} does not deliver"),
                format!("look at its driver and cable; `noctule echo noctule/sonar/{name}/...` shows what it sends"),
            ));
        }
        if health.bad_channel_count[index] > 0 {
            all.push(finding(
                format!("{} channels of sensor {name} are left out", health.bad_channel_count[index]),
                "record a ping and run `noctule check` on it: it names the channels",
            ));
        }
    }
    for (index, sensor) in look.config.sensor.iter().enumerate() {
        let alarms = Alarms::from_bits(health.drift[index]);
        if !alarms.is_empty() {
            all.push(finding(
                format!("sensor {} has drifted: {alarms}", sensor.name),
                "measure it: record some pings and run `noctule calibrate` on them; set the temperature of the air",
            ));
        }
    }
    if let Some(first) = look.heard.first_health {
        let dropped = health.dropped_count.saturating_sub(first.dropped_count);
        let late = health.late_count.saturating_sub(first.late_count);
        if dropped + late > 0 {
            all.push(finding(
                format!("{dropped} ping sets dropped and {late} late while we looked"),
                "the machine is too slow for this configuration: `noctule bench` says by how much",
            ));
        }
    }
    if health.gpu_loss_count > 0 {
        all.push(finding(
            format!("the GPU was lost {} times", health.gpu_loss_count),
            "look at the driver's messages in the system's log; --backend cpu does without it",
        ));
    }
}

/// Why the robot moves or stands, in words.
pub(super) fn motion(look: &Look) -> String {
    let Some(platform) = look.heard.platform else { return "stands: no controller drives it".to_owned() };
    let gate = look.controller();
    let moves = platform.linear_m_s != 0.0 || platform.angular_rad_s != 0.0;
    if moves {
        return format!("moves: {:.2} m/s, {:.2} rad/s", platform.linear_m_s, platform.angular_rad_s);
    }
    match (gate, look.daemon()) {
        (Some((GateState::Track, _)), Some((state, _))) if state.allows_motion() => {
            let wanted = look.heard.command.is_some_and(|it| it.layer == crate::signal::LayerName::PassThrough as u32);
            if wanted {
                "stands: nobody asks for motion (noctule/input, or the world's guidance)".to_owned()
            } else {
                "stands: so the layer decided".to_owned()
            }
        }
        (_, Some((DaemonState::Ready, _))) => "stands: nobody armed; `noctule arm` makes it move".to_owned(),
        (_, Some((state, reason))) if !state.allows_motion() => format!("stands: the daemon is {state} ({reason})"),
        (Some((state, reason)), _) => format!("stands: the controller is in {state} ({reason})"),
        (None, _) => "stands: the controller's state is unknown".to_owned(),
    }
}

/// What to do about a reason of the daemon.
fn cure(reason: Reason) -> &'static str {
    match reason {
        Reason::SensorLost | Reason::ViewMissing => "look at the driver and the cable of the sensor that is missing",
        Reason::ChannelsLost | Reason::ChannelsDead | Reason::Clipped => {
            "look for something near or on the microphones; `noctule check RECORDING` names the channels"
        }
        Reason::PingRejected | Reason::FrozenPing | Reason::SequenceGaps => {
            "look at the driver: its pings are not sound"
        }
        Reason::PingTooOld | Reason::DeadlineMissed => {
            "the machine or a driver is too slow: `noctule bench`, `noctule doctor`"
        }
        Reason::PingFromFuture => "the driver must stamp pings with CLOCK_BOOTTIME of this machine",
        Reason::BackendFallback | Reason::BackendMismatch => {
            "look at the GPU's driver, or take imaging.backend = \"cpu\""
        }
        Reason::Desync | Reason::DesyncWarning => "the sensors must emit together: look at their trigger",
        Reason::NoDirectPath => "the sensor does not hear its emission: look at the emitter and at [emission]",
        Reason::ChannelMap => "the array is not the configured one: look at sensor.array and the order of the channels",
        Reason::OperatorStop => "`noctule arm` when the robot may move again",
        Reason::TooManyStops | Reason::StartTimeout | Reason::InternalError => {
            "read the daemon's log for the first cause"
        }
        _ => "it goes on by itself when the cause has gone",
    }
}
