//! `noctule detect corridors`: vector projection against the classical detector in random corridors, or along a world's waypoints.
//!
//! Goes in: what was typed. Comes out: a table on standard output, JSON, a picture of the ways. What drives is
//! [`crate::service::corridor`].

use crate::cli::args::{ConfigChoice, CorridorsArguments};
use crate::cli::output::{print_line, progress, write_json, write_picture};
use crate::cli::run::{prefer_pcm, service_failure};
use crate::cli::series::{check_places, check_seeds, cores};
use crate::cli::{Failure, exit};
use crate::config::Config;
use crate::detect::FollowerState;
use crate::io::plot::{Doing, EdgePanel, edge_panels};
use crate::service::corridor::{Corridor, CorridorPoint, CorridorProgramme, CorridorRun, CorridorSummary, Entry};
use crate::service::trial::TrialRig;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// The robot that is driven without `--config`.
const P3DX: &str = include_str!("../../../fixtures/config/p3dx.toml");
/// Corridors that are drawn.
const DRAWN_MAX: usize = 5;

/// Runs the command.
///
/// # Errors
/// 65 for a world of no use, 70 when a run could not be driven, 73, 74, 77, 78.
pub(super) fn corridors(arguments: &CorridorsArguments, choice: &ConfigChoice) -> Result<(), Failure> {
    let mut config = match choice.config {
        Some(_) => crate::cli::config::load(choice)?,
        None => Config::parse(P3DX, Path::new("p3dx.toml")).map_err(|error| Failure::new(exit::INTERNAL, error))?,
    };
    prefer_pcm(&mut config);
    check_seeds(arguments.series.seed, arguments.runs)?;
    let params = config.detect.projection.clone();
    let rig = TrialRig::new(config).map_err(|error| service_failure(&error))?;
    let world = arguments.world.as_deref().map(crate::cli::simulate::choice::world).transpose()?;
    let corridor = world.map(|world| Corridor::of_world(&world, params.safe_width_m));
    if let (Some(path), Some(corridor)) = (&arguments.world, corridor.as_ref())
        && corridor.path_m.len() < 2
    {
        let message = format!("{}: found no waypoints, allowed: a world with waypoints", path.display());
        return Err(Failure::new(exit::DATA, message));
    }
    check_places([&arguments.series.json, &arguments.plot].into_iter().flatten().map(PathBuf::as_path))?;
    let entries = Entry::all(&params);
    let jobs = arguments.series.jobs.map_or_else(cores, usize::from);
    let runs_each = if corridor.is_some() { 1 } else { arguments.runs };
    let programme = CorridorProgramme {
        rig: &rig,
        entries: &entries,
        corridor,
        first_seed: arguments.series.seed,
        runs: runs_each,
        jobs,
    };
    let bar = progress(entries.len() as u64 * runs_each, "driving");
    let runs = programme.drive(&mut |done| bar.set_position(done));
    bar.finish_and_clear();
    let runs = runs.map_err(|error| service_failure(&error))?;
    let rows: Vec<CorridorSummary> =
        entries.iter().zip(&runs).map(|(entry, runs)| CorridorSummary::of(&entry.name, runs.iter())).collect();
    table(&rows).iter().try_for_each(|line| print_line(line))?;
    if let Some(path) = &arguments.series.json {
        write_json(path, &to_json(&programme, &rows, &runs))?;
    }
    if let Some(path) = &arguments.plot {
        draw(path, &programme, &runs)?;
    }
    Ok(())
}

fn table(rows: &[CorridorSummary]) -> Vec<String> {
    let mut lines = vec![format!(
        "{:<18} {:>5} {:>9} {:>14} {:>8} {:>16} {:>8} {:>5} {:>15}",
        "detector",
        "runs",
        "detected",
        "false (walls)",
        "arrived",
        "blocked (wrong)",
        "contact",
        "late",
        "clear_m (med)"
    )];
    lines.extend(rows.iter().map(|row| {
        format!(
            "{:<18} {:>5} {:>9} {:>14} {:>8} {:>16} {:>8} {:>5} {:>15}",
            row.detector,
            row.runs,
            format!("{}/{}", row.detected, row.met),
            format!("{} ({})", row.false_stops, row.wall_stops),
            row.arrived,
            format!("{} ({})", row.rightly_blocked + row.wrongly_blocked, row.wrongly_blocked),
            row.contacts,
            row.late,
            format!("{:.3} ({:.3})", row.min_clearance_m, row.median_clearance_m),
        )
    }));
    lines
}

fn to_json(programme: &CorridorProgramme, rows: &[CorridorSummary], runs: &[Vec<CorridorRun>]) -> Value {
    let run = |(number, run): (usize, &CorridorRun)| {
        json!({
            "seed": programme.first_seed.wrapping_add(number as u64),
            "met": run.met,
            "detected": run.detected,
            "stops": run.stops,
            "false_stops": run.false_stops,
            "wall_stops": run.wall_stops,
            "arrived": run.arrived,
            "blocked": run.blocked,
            "rightly_blocked": run.rightly_blocked,
            "collided": run.collided,
            "min_clearance_m": run.min_clearance_m,
            "duration_s": run.duration_s,
            "way_m": run.way_m,
        })
    };
    let of_detector = |(row, runs): (&CorridorSummary, &Vec<CorridorRun>)| {
        let runs: Vec<Value> = runs.iter().enumerate().map(run).collect();
        json!({"detector": row.detector, "runs": runs})
    };
    json!({"summary": rows, "detectors": rows.iter().zip(runs).map(of_detector).collect::<Vec<_>>()})
}

fn draw(path: &Path, programme: &CorridorProgramme, runs: &[Vec<CorridorRun>]) -> Result<(), Failure> {
    let shown = runs.first().map_or(0, Vec::len).min(DRAWN_MAX);
    let corridors: Vec<Corridor> = (0..shown).map(|number| programme.corridor(number as u64)).collect();
    let mut panels = Vec::new();
    for (entry, runs) in programme.entries.iter().zip(runs) {
        for (number, (corridor, run)) in corridors.iter().zip(runs).enumerate() {
            let seed = programme.first_seed.wrapping_add(number as u64);
            panels.push(EdgePanel {
                title: if programme.corridor.is_some() {
                    entry.name.clone()
                } else {
                    format!("{}, seed {seed}", entry.name)
                },
                world: &corridor.world,
                lines_m: vec![corridor.path_m.clone()],
                way: run.track.iter().map(way_point).collect(),
                collided: run.collided,
            });
        }
    }
    let columns = if shown == 1 { 3 } else { shown };
    write_picture(path, &edge_panels("Vector projection and classical detector", &panels, columns))
}

fn way_point(point: &CorridorPoint) -> ([f64; 2], Doing) {
    let doing = match point.state {
        FollowerState::Idle | FollowerState::Follow | FollowerState::Arrived => Doing::Follows,
        FollowerState::Measure => Doing::Measures,
        FollowerState::Pass | FollowerState::Return => Doing::Passes,
        FollowerState::Blocked => Doing::Blocked,
    };
    ([point.pose.x_m, point.pose.y_m], doing)
}
