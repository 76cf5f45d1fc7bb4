//! `noctule detect space`: points in space of simulated rooms, against the truth.
//!
//! Goes in: what was typed. Comes out: a table on standard output, JSON, a picture of one room. What looks and scores is
//! [`crate::service::space_trials`].

use crate::cli::Failure;
use crate::cli::args::{ConfigChoice, SpaceArguments};
use crate::cli::output::{print_line, progress, write_json, write_picture};
use crate::cli::run::{prefer_pcm, service_failure};
use crate::cli::series::{check_places, check_seeds};
use crate::config::Config;
use crate::imaging::params::{DirectionsParams, Prefer};
use crate::io::plot::{PlottedSpace, space_panels};
use crate::service::space_trials::{self, BAND_M, CEILING_M, FLOOR_M, Look, Looker, Room, SpaceScore};
use crate::signal::{SpaceClass, SpacePoint};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Runs the command.
///
/// # Errors
/// 2 for seeds that run out, 70 when a room could not be looked at, 73, 74, 77, 78.
pub(super) fn space(arguments: &SpaceArguments, choice: &ConfigChoice) -> Result<(), Failure> {
    check_seeds(arguments.seed, arguments.runs)?;
    check_places([&arguments.json, &arguments.plot].into_iter().flatten().map(PathBuf::as_path))?;
    let mut config = crate::cli::config::load(choice)?;
    prefer_pcm(&mut config);
    let lookers = lookers(&config, &arguments.directions)?;
    let sensor_m = lookers[0].sensor_m();
    let rooms: Vec<Room> = (0..arguments.runs).map(|run| space_trials::room(arguments.seed + run, sensor_m)).collect();
    let bar = progress(arguments.runs * lookers.len() as u64, "rooms");
    let mut scores = Vec::with_capacity(lookers.len());
    let mut first = Vec::with_capacity(lookers.len());
    for looker in &lookers {
        let looks = looker.look(&rooms, Prefer::Cpu, &mut || bar.inc(1)).map_err(|error| service_failure(&error))?;
        let mut score = SpaceScore::default();
        for (room, look) in rooms.iter().zip(&looks) {
            score.add(room, look, sensor_m, looker.is_level());
        }
        scores.push((name(looker), score));
        first.extend(looks.into_iter().take(1));
    }
    bar.finish_and_clear();
    table(&scores).iter().try_for_each(|line| print_line(line))?;
    if let Some(path) = &arguments.json {
        write_json(path, &Value::from(scores.iter().map(record).collect::<Vec<_>>()))?;
    }
    if let (Some(path), [fan, .., last]) = (&arguments.plot, first.as_slice()) {
        let names = [scores[0].0.as_str(), scores[scores.len() - 1].0.as_str()];
        write_picture(path, &space_panels(&plotted(&rooms[0], fan, last), names))?;
    }
    Ok(())
}

/// The level fan of the configuration, if it has one, or the default one; and the grids.
fn lookers(config: &Config, counts: &[usize]) -> Result<Vec<Looker>, Failure> {
    let of = |directions: DirectionsParams| -> Result<Looker, Failure> {
        let mut config = config.clone();
        config.imaging.directions = directions;
        config.validate().map_err(|error| Failure::new(crate::cli::exit::USAGE, format!("--directions: {error}")))?;
        Looker::new(config).map_err(|error| service_failure(&error))
    };
    let own = &config.imaging.directions;
    let fan = if own.file.is_none() && own.equal_area.is_none() { own.clone() } else { DirectionsParams::default() };
    let limits = own.elevation_deg;
    let grid = |count: &usize| {
        of(DirectionsParams { equal_area: Some(*count), elevation_deg: limits, ..DirectionsParams::default() })
    };
    std::iter::once(of(fan)).chain(counts.iter().map(grid)).collect()
}

fn name(looker: &Looker) -> String {
    let kind = if looker.is_level() { "fan" } else { "equal-area" };
    format!("{kind} {}", looker.direction_count())
}

fn table(scores: &[(String, SpaceScore)]) -> Vec<String> {
    let mut lines = vec![format!(
        "{:<16} {:>9} {:>9} {:>9} {:>9} {:>6} {:>6} {:>7} {:>7} {:>6} {:>6} {:>5} {:>8} {:>7}",
        "grid",
        "floor",
        "obstacle",
        "overhang",
        "ceiling",
        "right",
        "false",
        "ghosts",
        "r_m",
        "az",
        "el",
        "nees",
        "image",
        "find"
    )];
    for (name, score) in scores {
        let of = |class: SpaceClass| format!("{}/{}", score.found[class as usize], score.there[class as usize]);
        let told =
            |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |value| format!("{value:.digits$}"));
        let rms = |axis: usize| score.rms().map(|rms| if axis == 0 { rms[0] } else { rms[axis].to_degrees() });
        let rooms = score.rooms.max(1) as f64;
        lines.push(format!(
            "{:<16} {:>9} {:>9} {:>9} {:>9} {:>6} {:>6.2} {:>7.2} {:>7} {:>6} {:>6} {:>5} {:>8.1} {:>7.2}",
            name,
            of(SpaceClass::Floor),
            of(SpaceClass::Obstacle),
            of(SpaceClass::Overhang),
            of(SpaceClass::Ceiling),
            told(right(score), 3),
            score.false_obstacles as f64 / rooms,
            score.ghosts as f64 / rooms,
            told(rms(0), 4),
            told(rms(1), 2),
            told(rms(2), 2),
            told(score.mean_nees(), 1),
            score.imaging_ms / rooms,
            score.finding_ms / rooms,
        ));
    }
    lines
}

/// Share of the found things that were told as what they are.
fn right(score: &SpaceScore) -> Option<f64> {
    let found: usize = score.found.iter().sum();
    let right: usize = (0..4).map(|class| score.confusion[class][class]).sum();
    (found > 0).then(|| right as f64 / found as f64)
}

fn record((name, score): &(String, SpaceScore)) -> Value {
    json!({
        "grid": name,
        "rooms": score.rooms,
        "classes": SpaceClass::ALL.map(SpaceClass::as_str),
        "there": score.there,
        "found": score.found,
        "confusion": score.confusion,
        "false_obstacles": score.false_obstacles,
        "ghosts": score.ghosts,
        "measured": score.measured,
        "range_rms_m": score.rms().map(|rms| rms[0]),
        "azimuth_rms_rad": score.rms().map(|rms| rms[1]),
        "elevation_rms_rad": score.rms().map(|rms| rms[2]),
        "nees": score.mean_nees(),
        "imaging_ms": score.imaging_ms / score.rooms.max(1) as f64,
        "finding_ms": score.finding_ms / score.rooms.max(1) as f64,
    })
}

/// A room, what the fan takes it for and what the grid does.
fn plotted(room: &Room, fan: &Look, grid: &Look) -> PlottedSpace {
    let place = |point: &SpacePoint| (point.position_m.into(), point.class, sigma_m(point));
    PlottedSpace {
        things: room.things.iter().map(|thing| (thing.place_m.into(), thing.class)).collect(),
        fan: fan.cloud.points.iter().map(place).collect(),
        grid: grid.cloud.points.iter().map(place).collect(),
        bars: room.world.bars.iter().map(|bar| (bar.from, bar.to)).collect(),
        balls: room.world.balls.iter().map(|ball| (ball.centre, ball.radius_m)).collect(),
        levels_m: [FLOOR_M, BAND_M[0], BAND_M[1], CEILING_M],
    }
}

/// Two standard deviations along each axis.
fn sigma_m(point: &SpacePoint) -> [f64; 3] {
    let spread = point.covariance_m2.diagonal();
    [spread.x, spread.y, spread.z].map(|variance| 2.0 * variance.max(0.0).sqrt())
}
