//! `noctule detect scenes`: what the virtual sonar ring finds on random maps, beside the way of paper 003.
//!
//! Goes in: what was typed. Comes out: a table on standard output, JSON, a picture. What looks and scores is
//! [`crate::service::ring_scenes`].

use crate::cli::args::{ConfigChoice, ScenesArguments};
use crate::cli::output::{print_line, progress, write_json, write_picture};
use crate::cli::run::service_failure;
use crate::cli::series::{check_places, check_seeds, cores};
use crate::cli::{Failure, exit};
use crate::detect::route::{RouteOptions, route};
use crate::io::plot::{PlottedGrid, PlottedObject, grid_map};
use crate::service::ring_scenes::score::EXPECTED_SHARES;
use crate::service::ring_scenes::{self, Method, RingScenes, Scene, SceneRun, Score, Scores};
use nalgebra::Vector2;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Where the way of the picture leads: between the things at the lower left, to the corner.
const GOAL_M: [f64; 2] = [0.2, 0.2];
/// The map, with a border of half a cell.
const WINDOW_M: [[f64; 2]; 2] = [[-0.1, -0.1], [2.1, 2.1]];

/// Runs the command.
///
/// # Errors
/// 2 for seeds that run out, 73, 74 and 77 for what cannot be written, 78 for a configuration that cannot be used.
pub fn scenes(arguments: &ScenesArguments, choice: &ConfigChoice) -> Result<(), Failure> {
    check_seeds(arguments.series.seed, arguments.runs)?;
    check_places([&arguments.series.json, &arguments.plot].into_iter().flatten().map(PathBuf::as_path))?;
    let config = match choice.config {
        Some(_) => crate::cli::config::load(choice)?,
        None => ring_scenes::config().map_err(|error| service_failure(&error))?,
    };
    if config.sensor.len() != 3 {
        let message = format!("sensor: found {}, allowed: three, 120 degrees apart", config.sensor.len());
        return Err(Failure::new(exit::CONFIG, message));
    }
    let harness = RingScenes::new(config).map_err(|error| service_failure(&error))?;
    let jobs = arguments.series.jobs.map_or_else(cores, usize::from);
    let bar = progress(arguments.runs, "scenes");
    let scored = harness.run(arguments.series.seed, arguments.runs, jobs, &mut |done| bar.set_position(done));
    bar.finish_and_clear();
    let scored = scored.map_err(|error| service_failure(&error))?;
    let sums = ring_scenes::sum(scored.iter().map(|(_, scores)| scores));
    table(&sums).iter().try_for_each(|line| print_line(line))?;
    if let Some(path) = &arguments.series.json {
        write_json(path, &record(&scored, &sums))?;
    }
    if let Some(path) = &arguments.plot {
        let mut worker = harness.worker().map_err(|error| service_failure(&error))?;
        let scene = Scene::paper(arguments.series.seed);
        let run = worker.run(&scene).map_err(|error| service_failure(&error))?;
        write_picture(path, &picture(&harness, &scene, &run))?;
    }
    Ok(())
}

/// The table, a line a method.
fn table(sums: &Scores) -> Vec<String> {
    let scenes = sums.first().map_or(0, |score| score.scenes);
    let things = sums.first().map_or(0, |score| score.things);
    let hidden = sums.first().map_or(0, |score| score.hidden);
    let mut lines = vec![
        format!("{scenes} scenes, {things} things, {hidden} of them behind others"),
        format!(
            "{:<27} {:>5} {:>6} {:>6} {:>7} {:>6} {:>6} {:>5} {:>6} {:>4} {:>4} {:>4}",
            "method", "hits", "misses", "ghosts", "doubles", "cells", "median", "p95", "nees", "1s", "2s", "3s"
        ),
    ];
    lines.extend(Method::ALL.iter().zip(sums).map(|(method, score)| line(*method, score)));
    let [one, two, three] = EXPECTED_SHARES.map(|share| format!("{:.0}", 100.0 * share));
    lines.push(format!("{:<75} {:>6} {one:>4} {two:>4} {three:>4}", "of honest covariances", "2.0"));
    lines
}

fn line(method: Method, score: &Score) -> String {
    let percent = |share: f64| format!("{:.0}", 100.0 * share);
    let cm =
        |share: f64| score.error_quantile_m(share).map_or("-".to_owned(), |error_m| format!("{:.1}", 100.0 * error_m));
    let nees = score.mean_square().map_or("-".to_owned(), |square| format!("{square:.1}"));
    let [one, two, three] = score.shares_within().map(percent);
    format!(
        "{:<27} {:>5} {:>6} {:>6} {:>7} {:>6} {:>6} {:>5} {nees:>6} {one:>4} {two:>4} {three:>4}",
        method.as_str(),
        score.hits,
        score.misses(),
        score.ghosts,
        score.doubles,
        score.cells_right,
        cm(0.5),
        cm(0.95),
    )
}

/// Table and scenes as JSON.
fn record(scored: &[(u64, Scores)], sums: &Scores) -> Value {
    let summary: Vec<Value> = Method::ALL.iter().zip(sums).map(|(method, score)| numbers(*method, score)).collect();
    let scenes = scored.iter().map(|(seed, scores)| {
        let methods: Vec<Value> =
            Method::ALL.iter().zip(scores).map(|(method, score)| numbers(*method, score)).collect();
        json!({ "seed": seed, "methods": methods })
    });
    json!({ "summary": summary, "scenes": scenes.collect::<Vec<_>>() })
}

fn numbers(method: Method, score: &Score) -> Value {
    json!({
        "method": method.as_str(),
        "things": score.things,
        "hidden": score.hidden,
        "hits": score.hits,
        "misses": score.misses(),
        "ghosts": score.ghosts,
        "doubles": score.doubles,
        "cells_right": score.cells_right,
        "error_median_m": score.error_quantile_m(0.5),
        "error_p95_m": score.error_quantile_m(0.95),
        "mean_square": score.mean_square(),
        "within_deviations": score.shares_within(),
    })
}

/// The paper's experiment: what the detector knows after a second, with a way between the things.
fn picture(harness: &RingScenes, scene: &Scene, run: &SceneRun) -> crate::io::picture::Picture {
    let (view, robot) = (&run.report.grid, &run.poses[1]);
    let radius_m = harness.config().platform.radius_m;
    let options = RouteOptions { robot_radius_m: radius_m, ..RouteOptions::default() };
    let found = route(&view.map(), robot.position_m(), Vector2::from(GOAL_M), &options);
    let objects = run.report.objects().iter().map(|track| PlottedObject {
        position_m: track.position_m.into(),
        covariance_m2: [track.covariance_m2.m11, track.covariance_m2.m12, track.covariance_m2.m22],
    });
    let grid = PlottedGrid {
        origin_m: view.origin_m,
        cell_m: view.cell_m,
        width: crate::detect::occupancy::SIDE,
        percent: view.percent.to_vec(),
        objects: objects.collect(),
        route_m: found.as_ref().map_or_else(Vec::new, |way| way.points_m.iter().map(|point| (*point).into()).collect()),
        robot: ([robot.x_m, robot.y_m], radius_m),
    };
    let way =
        found.map_or("no way to the corner".to_owned(), |way| format!("way of {:.2} m to the corner", way.length_m));
    let told = format!("after one second: {} objects, {way}; numbers: percent occupied", run.report.object_count);
    grid_map(&scene.world, &grid, ["Virtual sonar ring: five round things on a map of 2 m by 2 m", &told], WINDOW_M)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_a_line_a_method_and_says_nothing_where_nothing_was_hit() {
        let lines = table(&Scores::default());
        assert_eq!(lines.len(), 2 + Method::ALL.len() + 1);
        assert!(lines[2].contains(" - "), "{}", lines[2]);
        let width = lines[1].len();
        assert!(lines[2..].iter().all(|line| line.len() == width), "{lines:#?}");
    }
}
