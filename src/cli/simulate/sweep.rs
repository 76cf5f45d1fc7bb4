//! `noctule simulate --sweep`: candidate layouts are drawn and driven, and printed, written and pictured in the order of
//! their rank. The rule of the rank stands at [`SweepScore::compare`].

use super::{Proving, first_failure, report};
use crate::cli::Failure;
use crate::cli::output::{print_line, progress, write_picture};
use crate::cli::run::service_failure;
use crate::io::plot_layouts::{LayoutCard, render_layouts};
use crate::sensor::SensorParams;
use crate::service::proving::{Entrant, Run};
use crate::service::sweep::{self, NEAR_MISS_M, Sight, SweepScore};
use nalgebra::Vector2;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::Path;

/// Candidates in the picture.
const PICTURED_MAX: usize = 12;

/// Draws `drawn` candidates beside the layouts given, drives all and ranks them.
///
/// # Errors
/// As [`super::simulate`].
pub fn sweep(mut proving: Proving, drawn: u64) -> Result<(), Failure> {
    let references = proving.entrants.len();
    let base = proving.entrants[0].rig.config();
    let bar = progress(drawn, "drawing");
    let candidates = sweep::draw(base, drawn as usize, proving.arguments.seed, &mut || bar.inc(1));
    bar.finish_and_clear();
    let candidates = candidates.map_err(|error| service_failure(&error))?;
    proving.entrants.extend(candidates);
    let runs = proving.drive(|run| {
        match &run.outcome {
            Ok(_) => log::debug!("{}", report::line(run, proving.world.waypoints.len())),
            Err(error) => log::warn!("{}, seed {}: {error}", run.layout, run.seed),
        }
        Ok(())
    })?;
    let ranking = sweep::rank(&proving.entrants, &runs);
    if !proving.json.is_stdout() {
        print_table(&proving.entrants, &ranking, references)?;
    }
    let world = proving.world_name();
    let place = |(place, (index, score)): (usize, &(usize, SweepScore))| {
        record(place + 1, &proving.entrants[*index], *index >= references, score)
    };
    proving.json.write(&json!({
        "world": world,
        "ranking": ranking.iter().enumerate().map(place).collect::<Vec<_>>(),
        "runs": report::records(&runs, &world),
        "failed": report::failures(&runs),
        "summary": report::summary(&runs),
    }))?;
    if let Some(path) = &proving.arguments.plot {
        draw(path, &proving, &ranking)?;
    }
    all_failed(&runs)
}

/// A layout that cannot begin a run is ranked last; only when none could is the sweep itself a failure.
fn all_failed(runs: &[Run]) -> Result<(), Failure> {
    if runs.iter().any(|run| run.outcome.is_ok()) { Ok(()) } else { first_failure(runs) }
}

fn print_table(entrants: &[Entrant], ranking: &[(usize, SweepScore)], references: usize) -> Result<(), Failure> {
    print_line(&format!(
        "{:>4} {:12} {:>7} {:>8} {:>6} {:>6} {:>6} {:>8} {:>9} {:>7} {:>8} {:>6}  sensors (distance m, bearing deg, yaw deg)",
        "rank",
        "layout",
        "contact",
        "missed",
        "near",
        "goal_s",
        "failed",
        "clear_m",
        "median_m",
        "ahead_m",
        "behind_m",
        "around"
    ))?;
    let number = |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |value| format!("{value:.digits$}"));
    for (place, (index, score)) in ranking.iter().enumerate() {
        let entrant = &entrants[*index];
        let mounts: Vec<String> = entrant
            .rig
            .config()
            .sensor
            .iter()
            .map(|sensor| sensor.mount)
            .map(|mount| format!("({}, {}, {})", mount.distance_m, mount.bearing_deg, mount.yaw_deg))
            .collect();
        print_line(&format!(
            "{:>4} {:12} {:>7} {:>8} {:>6} {:>6} {:>6} {:>8} {:>9} {:>7.2} {:>8.2} {:>4.0} %  {}",
            place + 1,
            entrant.name,
            score.contacts,
            score.goals_missed,
            score.near_misses,
            number(score.time_to_goal_s, 1),
            score.failed,
            number(score.min_clearance_m, 2),
            number(score.median_clearance_m, 2),
            score.coverage.ahead_m,
            score.coverage.behind_m,
            score.coverage.around_share * 100.0,
            mounts.join(" ")
        ))?;
    }
    let Some((best, _)) = ranking.first().filter(|(index, _)| *index >= references) else { return Ok(()) };
    print_line(&format!("\n# {}, the best, for a configuration:", entrants[*best].name))?;
    print_line(sensor_toml(&entrants[*best].rig.config().sensor).trim_end())
}

fn record(rank: usize, entrant: &Entrant, drawn: bool, score: &SweepScore) -> Value {
    let sensors = &entrant.rig.config().sensor;
    let mount = |sensor: &SensorParams| json!({ "name": sensor.name, "mount": sensor.mount });
    json!({
        "rank": rank,
        "layout": entrant.name,
        "drawn": drawn,
        "sensors": sensors.iter().map(mount).collect::<Vec<_>>(),
        "toml": sensor_toml(sensors),
        "score": {
            "runs": score.runs,
            "failed": score.failed,
            "collided": score.contacts,
            "goals_missed": score.goals_missed,
            "near_misses": score.near_misses,
            "near_miss_m": NEAR_MISS_M,
            "time_to_goal_s": score.time_to_goal_s,
            "min_clearance_m": score.min_clearance_m,
            "median_clearance_m": score.median_clearance_m,
            "coverage": {
                "ahead_m": score.coverage.ahead_m,
                "behind_m": score.coverage.behind_m,
                "around_share": score.coverage.around_share,
            },
        },
    })
}

/// The sensors as a configuration has them.
fn sensor_toml(sensors: &[SensorParams]) -> String {
    #[derive(Serialize)]
    struct Sensors<'a> {
        sensor: &'a [SensorParams],
    }
    // Names, numbers and lists always have a TOML form.
    toml::to_string(&Sensors { sensor: sensors }).unwrap_or_default()
}

fn draw(path: &Path, proving: &Proving, ranking: &[(usize, SweepScore)]) -> Result<(), Failure> {
    let best = &ranking[..ranking.len().min(PICTURED_MAX)];
    let sights: Vec<Sight> = best.iter().map(|(index, _)| Sight::new(&proving.entrants[*index].rig)).collect();
    let views: Vec<_> = sights.iter().map(|sight| |point_m| sight.seen_by(point_m)).collect();
    let cards: Vec<LayoutCard> = best
        .iter()
        .zip(&views)
        .enumerate()
        .map(|(place, ((index, score), view))| card(place + 1, &proving.entrants[*index], score, view))
        .collect();
    let runs = match proving.arguments.runs {
        1 => "one run".to_owned(),
        count => format!("{count} runs"),
    };
    let heading = format!("Sensor layouts by rank in {}, {runs} each", proving.world_title());
    write_picture(path, &render_layouts(&heading, &cards))
}

fn card<'a>(
    rank: usize,
    entrant: &Entrant,
    score: &SweepScore,
    seen_by: &'a dyn Fn(Vector2<f64>) -> usize,
) -> LayoutCard<'a> {
    let time = match score.time_to_goal_s {
        Some(time_s) => format!("goal in {time_s:.1} s"),
        None if score.failed == score.runs => "cannot start".to_owned(),
        None => "no goal".to_owned(),
    };
    let metres = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2} m"));
    let coverage = &score.coverage;
    LayoutCard {
        title: format!("{rank}. {}", entrant.name),
        lines: vec![
            format!("{time}, {} near-misses", score.near_misses),
            format!("clear {}, median {}", metres(score.min_clearance_m), metres(score.median_clearance_m)),
            format!("sees {:.1} m ahead, {:.0} % around", coverage.ahead_m, coverage.around_share * 100.0),
        ],
        radius_m: entrant.rig.config().platform.radius_m,
        sensors: entrant.rig.setup().sensors.iter().map(|sensor| sensor.mount.pose()).collect(),
        seen_by,
        ended: [score.runs - score.goals_missed, score.goals_missed.saturating_sub(score.contacts), score.contacts],
    }
}
