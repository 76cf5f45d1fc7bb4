//! `noctule detect`: the range-based detectors at work: on readings that somebody else took, JSON in, JSON out; on worlds ([`edges`]); in
//! simulated corridors ([`corridors`]), on simulated maps ([`scenes`]), drives ([`motion`]) and rooms
//! ([`space`]).

mod corridors;
mod edges;
mod motion;
mod scenes;
mod space;

use super::args::{ConfigChoice, DetectAction, DetectArguments};
use super::output::print_line;
use super::{Failure, exit};
use crate::config::Config;
use crate::detect::projection::{self, Edge};
use crate::detect::ring;
use crate::geometry::Pose2;
use nalgebra::Vector2;
use serde::Deserialize;
use serde_json::{Value, json};
use std::io::Read as _;

/// Longest input: a ring has twelve readings.
const INPUT_BYTES_MAX: u64 = 1 << 20;
/// Farthest place or reading that is taken for one.
const METRES_MAX: f64 = 1e6;

/// A pose as it is written.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Pose {
    x_m: f64,
    y_m: f64,
    heading_deg: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ProjectionInput {
    ranges_m: [Option<f64>; projection::SONARS],
    pose: Pose,
    edge: [[f64; 2]; 2],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RingInput {
    ranges_m: [Option<f64>; ring::SONARS],
    pose: Pose,
    ring_radius_m: Option<f64>,
    cone_deg: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// 65 for what is no input of the detector or no world, 73, 74, 77, 78.
pub fn detect(arguments: &DetectArguments) -> Result<(), Failure> {
    let chosen = |own: &ConfigChoice| {
        let config = own.config.clone().or_else(|| arguments.choice.config.clone());
        ConfigChoice { config }
    };
    match &arguments.action {
        DetectAction::Projection(own) => answer(&chosen(&own.choice), project),
        DetectAction::Ring(own) => answer(&chosen(&own.choice), ring_objects),
        DetectAction::Edges(own) => edges::edges(own, &chosen(&own.choice)),
        DetectAction::Corridors(own) => {
            corridors::corridors(own, &chosen(&ConfigChoice { config: own.config.clone() }))
        }
        DetectAction::Motion(own) => motion::motion(own, &chosen(&ConfigChoice { config: own.config.clone() })),
        DetectAction::Space(own) => space::space(own, &chosen(&ConfigChoice { config: own.config.clone() })),
        DetectAction::Scenes(own) => scenes::scenes(own, &chosen(&ConfigChoice { config: own.config.clone() })),
    }
}

/// Detects in the readings on standard input.
fn answer(choice: &ConfigChoice, detector: fn(&Config, &str) -> Result<Value, Failure>) -> Result<(), Failure> {
    let config = super::config::load(choice)?;
    let mut text = String::new();
    std::io::stdin().lock().take(INPUT_BYTES_MAX + 1).read_to_string(&mut text).map_err(|error| {
        match error.kind() {
            std::io::ErrorKind::InvalidData => {
                Failure::new(exit::DATA, "standard input: found bytes that are no UTF-8")
            }
            _ => Failure::from(error),
        }
    })?;
    if text.len() as u64 > INPUT_BYTES_MAX {
        return Err(refuse("", format!("more than {INPUT_BYTES_MAX} bytes"), "one JSON object"));
    }
    print_line(&detector(&config, &text)?.to_string())
}

fn project(config: &Config, text: &str) -> Result<Value, Failure> {
    let input: ProjectionInput = parse(text)?;
    check_ranges(&input.ranges_m)?;
    let pose = checked(input.pose)?;
    for (index, value) in input.edge.iter().flatten().enumerate() {
        check_metres(&format!("edge[{}][{}]", index / 2, index % 2), *value, -METRES_MAX)?;
    }
    let [start, end] = input.edge.map(|[x_m, y_m]| Vector2::new(x_m, y_m));
    if start == end {
        return Err(refuse("edge", "two equal points", "an edge with a direction"));
    }
    let edge = Edge { start_m: start, end_m: end };
    let found = projection::project(&config.detect.projection, &input.ranges_m, &pose, &edge);
    Ok(json!({
        "projections": found.projections,
        "detected": found.sonar.is_some(),
        "sonar": found.sonar,
        "blind": found.blind,
    }))
}

fn ring_objects(config: &Config, text: &str) -> Result<Value, Failure> {
    let input: RingInput = parse(text)?;
    check_ranges(&input.ranges_m)?;
    let pose = checked(input.pose)?;
    let mut params = config.detect.ring;
    for (field, given, target, most) in [
        ("ring_radius_m", input.ring_radius_m, &mut params.ring_radius_m, 5.0),
        ("cone_deg", input.cone_deg, &mut params.cone_deg, 180.0),
    ] {
        let Some(value) = given else { continue };
        if !(value > 0.0 && value <= most) {
            return Err(refuse(field, value, &format!("a number above 0, at most {most}")));
        }
        *target = value;
    }
    let objects: Vec<Value> = ring::objects(&params, &input.ranges_m, &pose)
        .iter()
        .map(|object| {
            let covariance = object.covariance_m2;
            json!({
                "x_m": object.position_m.x,
                "y_m": object.position_m.y,
                "pair": object.pair,
                "covariance": [[covariance.m11, covariance.m12], [covariance.m21, covariance.m22]],
            })
        })
        .collect();
    Ok(json!({ "objects": objects }))
}

fn parse<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, Failure> {
    if text.trim().is_empty() {
        return Err(refuse("", "nothing", "one JSON object; `noctule detect --help` has examples"));
    }
    serde_json::from_str(text).map_err(|error| Failure::new(exit::DATA, format!("standard input: {error}")))
}

fn refuse(field: &str, found: impl std::fmt::Display, allowed: &str) -> Failure {
    let colon = if field.is_empty() { "" } else { ": " };
    Failure::new(exit::DATA, format!("standard input: {field}{colon}found {found}, allowed: {allowed}"))
}

fn check_metres(field: &str, value_m: f64, least_m: f64) -> Result<(), Failure> {
    if value_m >= least_m && value_m <= METRES_MAX {
        return Ok(());
    }
    Err(refuse(field, value_m, &format!("metres from {least_m} to {METRES_MAX}")))
}

fn check_ranges(ranges_m: &[Option<f64>]) -> Result<(), Failure> {
    let given = ranges_m.iter().enumerate().filter_map(|(index, range_m)| range_m.map(|range_m| (index, range_m)));
    given.into_iter().try_for_each(|(index, range_m)| check_metres(&format!("ranges_m[{index}]"), range_m, 0.0))
}

fn checked(pose: Pose) -> Result<Pose2, Failure> {
    check_metres("pose.x_m", pose.x_m, -METRES_MAX)?;
    check_metres("pose.y_m", pose.y_m, -METRES_MAX)?;
    if !(pose.heading_deg.abs() <= 1e6) {
        return Err(refuse("pose.heading_deg", pose.heading_deg, "degrees from -1e6 to 1e6"));
    }
    Ok(Pose2 { x_m: pose.x_m, y_m: pose.y_m, heading_rad: pose.heading_deg.to_radians() })
}
