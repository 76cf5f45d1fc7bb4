//! One moment as JSON, for the page: states, command and why, cues, health, and the time of everything.
//!
//! Goes in: a [`Moment`] and the [`Robot`]. Comes out: one object. Times are milliseconds of CLOCK_BOOTTIME beside the time now,
//! so that the page can tell the age of what it shows; what was never heard is null, and numbers that are none are null, too.

use super::board::Moment;
use super::detections;
use super::robot::Robot;
use super::why;
use crate::io::wire::message::{VelocityCommand, backend_name, layer_name};
use crate::io::wire::telemetry::{Cues, Health, PlatformVelocity, REGION_LAYERS};
use crate::signal::{DaemonState, GateState, LayerName, Reason, SENSORS_MAX};
use serde_json::{Value, json};

/// Layers in the order of the arrays in [`Cues`].
const CUE_LAYERS: [LayerName; REGION_LAYERS] =
    [LayerName::CollisionAvoidance, LayerName::ObstacleAvoidance, LayerName::CorridorFollowing];

fn ms(t_ns: u64) -> f64 {
    t_ns as f64 * 1e-6
}

/// The whole moment.
#[must_use]
pub fn state_json(moment: &Moment, robot: &Robot) -> Value {
    json!({
        "kind": "state",
        "now_ms": ms(moment.made_ns),
        "trouble": moment.trouble,
        "daemon": moment.daemon_heard_ns().map(|heard_ns| daemon_json(moment, heard_ns)),
        "controller": moment.platform.as_ref().map(controller_json),
        "command": moment.command.as_ref().map(|command| command_json(command, moment, robot)),
        "cues": moment.cues.as_ref().map(|cues| cues_json(cues, robot)),
        "health": moment.health.as_ref().map(health_json),
        "scan": moment.scan.as_deref().map(detections::scan_json),
        "obstacle": moment.obstacle.as_deref().map(|obstacle| detections::obstacle_json(obstacle, moment.objects.as_deref())),
        "objects": moment.objects.as_deref().map(detections::objects_json),
        "sensors": robot.sensors.iter().enumerate().map(|(index, _)| sensor_json(moment, index)).collect::<Vec<_>>(),
    })
}

fn daemon_json(moment: &Moment, heard_ns: u64) -> Value {
    // Whoever spoke last knows the state: commands come with every ping set, health at every change.
    let command = moment.command.map(|command| (command.t_published_ns, command.state, command.reason, command.epoch));
    let health = moment.health.map(|health| (health.t_monotonic_ns, health.state, health.reason, health.epoch));
    let (_, state, reason, epoch) = command.max(health).unwrap_or_default();
    json!({
        "heard_ms": ms(heard_ns),
        "state": DaemonState::from_number(state).map(DaemonState::as_str),
        "moves": DaemonState::from_number(state).is_some_and(DaemonState::allows_motion),
        "reason": Reason::from_number(reason).map(|reason| why::words(reason.as_str())),
        "epoch": format!("{epoch:016x}"),
    })
}

fn controller_json(platform: &PlatformVelocity) -> Value {
    json!({
        "heard_ms": ms(platform.t_monotonic_ns),
        "state": GateState::from_number(platform.state).map(GateState::as_str),
        "reason": Reason::from_number(platform.reason).map(|reason| why::words(reason.as_str())),
        "linear_m_s": platform.linear_m_s,
        "angular_rad_s": platform.angular_rad_s,
        "received": platform.received_count,
        "accepted": platform.accepted_count,
        "refused": platform.refused_count,
        "refusal": why::refusal(platform),
    })
}

fn command_json(command: &VelocityCommand, moment: &Moment, robot: &Robot) -> Value {
    // A cue of another ping set explains nothing.
    let cues = moment.cues.as_ref().filter(|cues| cues.t_monotonic_ns == command.t_monotonic_ns);
    json!({
        "sequence": command.sequence,
        "emitted_ms": ms(command.t_monotonic_ns),
        "published_ms": ms(command.t_published_ns),
        "linear_m_s": command.linear_m_s,
        "angular_rad_s": command.angular_rad_s,
        "speed_limit_m_s": command.speed_limit_m_s,
        "layer": layer_name(command.layer),
        "stuck": command.stuck != 0,
        "why": why::why(command, cues, robot),
        "cause": robot.sensor_name(command.cause_sensor).map(|sensor| json!({
            "sensor": sensor,
            "sensor_index": command.cause_sensor,
            "range_m": command.cause_range_m,
            "bearing_rad": command.cause_bearing_rad,
        })),
        "energy": command.cause_energy,
        "threshold": command.cause_threshold,
    })
}

fn cues_json(cues: &Cues, robot: &Robot) -> Value {
    let layer = |(index, name): (usize, &LayerName)| {
        // CA compares the sum, the others the loudest cell.
        let energy = if *name == LayerName::CollisionAvoidance { cues.energy[index] } else { cues.peak[index] };
        let nearest = robot.sensor_name(cues.nearest_sensor[index]).map(|sensor| {
            json!({
                "sensor": sensor,
                "sensor_index": cues.nearest_sensor[index],
                "range_m": cues.nearest_range_m[index],
                "bearing_rad": cues.nearest_bearing_rad[index],
                "distance_m": cues.nearest_distance_m[index],
            })
        });
        // JSON knows no infinity; a broken image is louder than everything.
        let shown = if energy.is_finite() { energy } else { f32::MAX };
        json!({ "layer": name.as_str(), "energy": shown, "threshold": cues.threshold[index], "nearest": nearest })
    };
    let walls: Vec<Value> = cues
        .wall_lateral_m
        .iter()
        .zip(&cues.wall_strength)
        .take(cues.wall_count as usize)
        .map(|(lateral_m, strength)| json!({ "lateral_m": lateral_m, "strength": strength }))
        .collect();
    json!({
        "sequence": cues.sequence,
        "emitted_ms": ms(cues.t_monotonic_ns),
        "layers": CUE_LAYERS.iter().enumerate().map(layer).collect::<Vec<_>>(),
        "walls": walls,
        "wall_threshold_single": cues.wall_threshold_single,
        "wall_threshold_corridor": cues.wall_threshold_corridor,
        "coverage_ahead_m": cues.coverage_ahead_m,
        "coverage_behind_m": cues.coverage_behind_m,
    })
}

fn health_json(health: &Health) -> Value {
    json!({
        "heard_ms": ms(health.t_monotonic_ns),
        "ping_sets": health.ping_set_count,
        "commands": health.command_count,
        "dropped": health.dropped_count,
        "late": health.late_count,
        "stops": health.stop_count,
        "gpu_losses": health.gpu_loss_count,
        "desync_us": health.desync_ns as f64 * 1e-3,
        "latency_ms": health.latency_ms,
        "latency_p50_ms": health.latency_p50_ms,
        "latency_p99_ms": health.latency_p99_ms,
        "latency_max_ms": health.latency_max_ms,
        "stage_ms": health.stage_ms,
        "backend": backend_name(health.backend),
        "adapter": health.adapter_name(),
    })
}

fn sensor_json(moment: &Moment, index: usize) -> Value {
    let health = moment.health.as_ref().filter(|_| index < SENSORS_MAX);
    let image = moment.images.get(index).and_then(Option::as_ref);
    let peak = image.map(|image| f64::from(image.peak)).filter(|peak| *peak > 0.0);
    json!({
        "delivers": health.map(|health| health.delivers(index)),
        "bad_channels": health.map(|health| health.bad_channel_count[index]),
        "rejected": health.map(|health| health.rejected_count[index]),
        "gaps": health.map(|health| health.gap_count[index]),
        "image_emitted_ms": image.map(|image| ms(image.header.t_monotonic_ns)),
        "sequence": image.map(|image| image.header.sequence),
        "peak_dbfs": peak.map(|peak| 20.0 * peak.log10()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn what_was_never_heard_is_null_and_what_is_no_number_is_null_too() {
        let robot = Robot::new(&Config::default()).expect("robot");
        let empty = state_json(&Moment::default(), &robot);
        for key in ["daemon", "controller", "command", "cues", "health", "trouble", "scan", "obstacle", "objects"] {
            assert!(empty[key].is_null(), "{key}");
        }
        assert_eq!(empty["sensors"].as_array().map(Vec::len), Some(3));
        let command = VelocityCommand { linear_m_s: f64::NAN, state: 3, ..VelocityCommand::blank() };
        let state = state_json(&Moment { command: Some(command), ..Moment::default() }, &robot);
        assert!(state["command"]["linear_m_s"].is_null());
        assert_eq!(state["daemon"]["state"], "ACTIVE");
    }

    #[test]
    fn the_state_is_that_of_whoever_spoke_last() {
        let robot = Robot::new(&Config::default()).expect("robot");
        let command = VelocityCommand { t_published_ns: 5, state: 3, ..VelocityCommand::blank() };
        let health = Health { t_monotonic_ns: 9, state: 5, ..Health::blank() };
        let moment = Moment { command: Some(command), health: Some(health), ..Moment::default() };
        assert_eq!(state_json(&moment, &robot)["daemon"]["state"], "STOPPED");
    }
}
