//! Why the robot moves as it does, in a sentence.
//!
//! Goes in: the newest command, cues and word of the controller. Comes out: English for people, with the numbers that were
//! compared. Explains what was decided; decides nothing.

use super::robot::Robot;
use crate::io::wire::NO_SENSOR;
use crate::io::wire::message::VelocityCommand;
use crate::io::wire::telemetry::{Cues, PlatformVelocity};
use crate::signal::{DaemonState, GateState, LayerName, Reason};

/// Slower than this counts as standing.
const STANDING_M_S: f64 = 5e-3;
/// Slower than this counts as not turning.
const STRAIGHT_RAD_S: f64 = 0.02;

/// A name as people write it: `view_missing` is "view missing".
#[must_use]
pub fn words(name: &str) -> String {
    name.replace('_', " ")
}

/// `12° to the left`.
#[must_use]
pub fn bearing_words(bearing_rad: f64) -> String {
    let bearing_deg = bearing_rad.to_degrees();
    match bearing_deg {
        _ if !bearing_deg.is_finite() => "in an unknown direction".to_owned(),
        _ if bearing_deg.abs() < 0.5 => "straight ahead of it".to_owned(),
        _ => format!("{:.0}° to the {}", bearing_deg.abs(), if bearing_deg > 0.0 { "left" } else { "right" }),
    }
}

/// Three digits, from 0.0058 to 12.3.
#[must_use]
pub fn energy_words(energy: f64) -> String {
    match energy.abs() {
        _ if !energy.is_finite() => "beyond all measure".to_owned(),
        0.0 => "0".to_owned(),
        small if small < 0.1 => format!("{energy:.4}"),
        middle if middle < 10.0 => format!("{energy:.2}"),
        _ => format!("{energy:.1}"),
    }
}

/// What the robot is told to do: `drives at 0.30 m/s and turns left at 0.42 rad/s`.
#[must_use]
pub fn motion_words(linear_m_s: f64, angular_rad_s: f64) -> String {
    if !(linear_m_s.is_finite() && angular_rad_s.is_finite()) {
        return "is told no number".to_owned();
    }
    let drive = match linear_m_s {
        v if v.abs() < STANDING_M_S => None,
        v if v < 0.0 => Some(format!("backs off at {:.2} m/s", -v)),
        v => Some(format!("drives at {v:.2} m/s")),
    };
    let side = if angular_rad_s > 0.0 { "left" } else { "right" };
    let turn =
        (angular_rad_s.abs() >= STRAIGHT_RAD_S).then(|| format!("turns {side} at {:.2} rad/s", angular_rad_s.abs()));
    match (drive, turn) {
        (None, None) => "stands still".to_owned(),
        (None, Some(turn)) => format!("{turn} on the spot"),
        (Some(drive), None) => format!("{drive} straight on"),
        (Some(drive), Some(turn)) => format!("{drive} and {turn}"),
    }
}

/// The sentences for a command.
#[must_use]
pub fn why(command: &VelocityCommand, cues: Option<&Cues>, robot: &Robot) -> String {
    let motion = motion_words(command.linear_m_s, command.angular_rad_s);
    let Some(layer) = LayerName::from_number(command.layer) else {
        return format!("The robot {motion}; layer {} is unknown to this page.", command.layer);
    };
    let mut text = match layer {
        LayerName::Stopped => standstill(command),
        LayerName::PassThrough => format!("No layer is triggered: the wanted velocity passes, the robot {motion}."),
        LayerName::FlowFollowing => format!("Flow following: the robot {motion}; {}.", walls(command, cues)),
        layer => {
            let name = words(layer.as_str());
            let first = name.chars().next().map(|first| first.to_ascii_uppercase());
            let name = first.map_or(name.clone(), |first| format!("{first}{}", &name[1..]));
            format!("{name}: the robot {motion}, since {}.", echo(command, robot))
        }
    };
    let limited = command.speed_limit_m_s.is_finite() && command.linear_m_s >= command.speed_limit_m_s - 1e-3;
    if layer != LayerName::Stopped && limited && command.speed_limit_m_s < robot.max_linear_m_s() - 1e-3 {
        text.push_str(&format!(" What is seen of the way allows {:.2} m/s at most.", command.speed_limit_m_s));
    }
    if command.stuck != 0 {
        text.push_str(" It makes no progress and tries to get away.");
    }
    text
}

fn standstill(command: &VelocityCommand) -> String {
    let state = command.daemon_state().map_or("an unknown state", DaemonState::as_str);
    let reason = Reason::from_number(command.reason)
        .map_or("a reason unknown to this page".to_owned(), |reason| words(reason.as_str()));
    format!("The daemon keeps the robot still: {state}, {reason}.")
}

/// What was compared. A layer that has fired holds on below its threshold, until its release.
fn compared(command: &VelocityCommand) -> String {
    let (energy, threshold) = (energy_words(command.cause_energy), energy_words(command.cause_threshold));
    if command.cause_energy <= command.cause_threshold {
        return format!("energy {energy}; it fired above {threshold} and has not let go yet");
    }
    format!("energy {energy} against a threshold of {threshold}")
}

fn echo(command: &VelocityCommand, robot: &Robot) -> String {
    let compared = compared(command);
    if command.cause_sensor == NO_SENSOR {
        return format!("its region is loud ({compared})");
    }
    let sensor = robot.sensor_name(command.cause_sensor).unwrap_or("a sensor that is not configured");
    format!(
        "{sensor} hears an echo at {:.2} m, {} ({compared})",
        command.cause_range_m,
        bearing_words(command.cause_bearing_rad)
    )
}

fn walls(command: &VelocityCommand, cues: Option<&Cues>) -> String {
    let compared = compared(command);
    let laterals = cues.map_or(&[][..], |cues| {
        let count = (cues.wall_count as usize).min(cues.wall_lateral_m.len());
        &cues.wall_lateral_m[..count]
    });
    let left = laterals.iter().copied().find(|lateral_m| *lateral_m >= 0.0);
    let right = laterals.iter().copied().find(|lateral_m| *lateral_m < 0.0);
    match (left, right) {
        (Some(left), Some(right)) => {
            format!("walls {left:.2} m to the left and {:.2} m to the right ({compared})", -right)
        }
        (Some(left), None) => format!("a wall {left:.2} m to the left ({compared})"),
        (None, Some(right)) => format!("a wall {:.2} m to the right ({compared})", -right),
        (None, None) => format!("its wall is fading ({compared})"),
    }
}

/// What the controller does with the command; `None` while it obeys.
#[must_use]
pub fn refusal(platform: &PlatformVelocity) -> Option<String> {
    let state = GateState::from_number(platform.state);
    if state == Some(GateState::Track) {
        return None;
    }
    let name = state.map_or("in an unknown state", GateState::as_str);
    let reason = Reason::from_number(platform.reason)
        .filter(|reason| *reason != Reason::None)
        .map_or(String::new(), |reason| format!(", {}", words(reason.as_str())));
    Some(format!("The controller does not follow: {name}{reason}; the platform is told to stand still."))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    fn robot() -> Robot {
        Robot::new(&Config::default()).expect("robot")
    }

    fn command(layer: LayerName) -> VelocityCommand {
        VelocityCommand {
            layer: layer as u32,
            linear_m_s: 0.3,
            angular_rad_s: -0.5,
            speed_limit_m_s: 0.5,
            cause_sensor: 1,
            cause_range_m: 0.423,
            cause_bearing_rad: 12f64.to_radians(),
            cause_energy: 0.85,
            cause_threshold: 0.3,
            ..VelocityCommand::blank()
        }
    }

    #[test]
    fn a_sentence_names_layer_motion_sensor_range_bearing_and_energies() {
        let text = why(&command(LayerName::ObstacleAvoidance), None, &robot());
        assert_eq!(
            text,
            "Obstacle avoidance: the robot drives at 0.30 m/s and turns right at 0.50 rad/s, since left hears an echo at \
             0.42 m, 12° to the left (energy 0.85 against a threshold of 0.30)."
        );
    }

    #[test]
    fn a_layer_that_holds_on_below_its_threshold_is_not_said_to_be_above_it() {
        let mut held = command(LayerName::CollisionAvoidance);
        held.cause_energy = 0.15;
        let text = why(&held, None, &robot());
        assert!(text.contains("energy 0.15; it fired above 0.30 and has not let go yet"), "{text}");
    }

    #[test]
    fn walls_are_named_with_their_sides() {
        let mut cues = Cues { wall_count: 2, ..Cues::blank() };
        (cues.wall_lateral_m[0], cues.wall_lateral_m[1]) = (-0.8, 1.25);
        let text = why(&command(LayerName::FlowFollowing), Some(&cues), &robot());
        assert!(text.contains("walls 1.25 m to the left and 0.80 m to the right"), "{text}");
        cues.wall_count = 1;
        assert!(why(&command(LayerName::FlowFollowing), Some(&cues), &robot()).contains("a wall 0.80 m to the right"));
    }

    #[test]
    fn a_standstill_tells_state_and_reason_and_the_controller_its_own() {
        let mut stopped = command(LayerName::Stopped);
        (stopped.state, stopped.reason) = (DaemonState::Stopped.number(), Reason::SensorLost.number());
        assert_eq!(why(&stopped, None, &robot()), "The daemon keeps the robot still: STOPPED, sensor lost.");
        let platform = |state: GateState, reason: Reason| PlatformVelocity {
            state: state.number(),
            reason: reason.number(),
            ..PlatformVelocity::blank()
        };
        assert_eq!(refusal(&platform(GateState::Track, Reason::Armed)), None);
        let text = refusal(&platform(GateState::Hold, Reason::NoCommand)).expect("refused");
        assert!(text.contains("HOLD, no command"), "{text}");
    }

    #[test]
    fn a_limit_by_what_is_seen_a_robot_that_is_stuck_and_broken_numbers_are_told() {
        let mut limited = command(LayerName::PassThrough);
        (limited.linear_m_s, limited.speed_limit_m_s, limited.stuck) = (0.2, 0.2, 1);
        let text = why(&limited, None, &robot());
        assert!(text.contains("allows 0.20 m/s at most") && text.contains("no progress"), "{text}");
        limited.linear_m_s = f64::NAN;
        limited.layer = 99;
        assert!(why(&limited, None, &robot()).contains("is told no number"));
        assert_eq!(energy_words(f64::INFINITY), "beyond all measure");
    }
}
