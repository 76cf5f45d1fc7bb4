//! `noctule detect motion`: ego-motion by echoes on simulated drives, against the truth.
//!
//! Goes in: what was typed. Comes out: a table on standard output, JSON, a picture of one drive. What drives and scores is
//! [`crate::service::motion_trials`].

use crate::cli::args::{ConfigChoice, MotionArguments};
use crate::cli::output::{print_line, progress, write_json, write_picture};
use crate::cli::run::{prefer_pcm, service_failure};
use crate::cli::series::{check_places, check_seeds, cores};
use crate::cli::{Failure, exit};
use crate::config::Config;
use crate::io::plot::{PlottedMotion, PlottedMover, motion_panels};
use crate::service::motion_trials::score::{MotionScore, score};
use crate::service::motion_trials::{self, MotionCase, MotionDrive, MotionSample};
use crate::service::trial::TrialRig;
use crate::sim::World;
use nalgebra::Rotation2;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Robots that drive without `--config` and `--layout`: one to three sensors, small and large.
const LAYOUTS: [&str; 5] = ["sim-2", "sim-4", "sim-7", "sim-10", "real-1"];
/// Ping sets between two movers of the picture.
const DRAWN_EVERY: usize = 10;

/// A drive with its score.
struct Scored<'a> {
    case: &'a MotionCase,
    robot: &'a str,
    drive: MotionDrive,
    samples: Vec<MotionSample>,
    score: MotionScore,
}

/// Runs the command.
///
/// # Errors
/// 2 for seeds that run out, 65 for a world of no use, 70 when a run could not be driven, 73, 74, 77, 78.
pub(super) fn motion(arguments: &MotionArguments, choice: &ConfigChoice) -> Result<(), Failure> {
    check_seeds(arguments.series.seed, arguments.runs)?;
    check_places([&arguments.series.json, &arguments.plot].into_iter().flatten().map(PathBuf::as_path))?;
    let robots = robots(arguments, choice)?;
    let mut rigs = Vec::with_capacity(robots.len());
    let mut names = Vec::with_capacity(robots.len());
    for (name, mut config) in robots {
        prefer_pcm(&mut config);
        config.control.movers.enabled |= arguments.give_room;
        rigs.push(TrialRig::new(config).map_err(|error| service_failure(&error))?);
        names.push(name);
    }
    let cases = cases(arguments, rigs.len())?;
    let jobs = arguments.series.jobs.map_or_else(cores, usize::from);
    let bar = progress(arguments.runs, "drives");
    let driven = motion_trials::run(&rigs, &cases, jobs, &mut |done| bar.set_position(done));
    bar.finish_and_clear();
    let mut scored = Vec::with_capacity(cases.len());
    for (index, outcome) in driven.map_err(|error| service_failure(&error))? {
        let (drive, samples) = outcome.map_err(|error| service_failure(&error))?;
        let case = &cases[index];
        let radius_m = rigs[case.robot].config().platform.radius_m;
        let score = score(&samples, &case.slips, radius_m);
        scored.push(Scored { case, robot: &names[case.robot], drive, samples, score });
    }
    table(&scored).iter().try_for_each(|line| print_line(line))?;
    if let Some(path) = &arguments.series.json {
        write_json(path, &record(&scored))?;
    }
    if let Some(path) = &arguments.plot {
        let shown = scored.iter().find(|scored| !scored.case.slips.is_empty()).or(scored.first());
        if let Some(shown) = shown {
            write_picture(path, &picture(shown))?;
        }
    }
    Ok(())
}

fn robots(arguments: &MotionArguments, choice: &ConfigChoice) -> Result<Vec<(String, Config)>, Failure> {
    if choice.config.is_some() {
        return Ok(vec![("config".to_owned(), crate::cli::config::load(choice)?)]);
    }
    let given: Vec<&str> = arguments.layout.iter().map(String::as_str).collect();
    let names = if given.is_empty() { LAYOUTS.to_vec() } else { given };
    let layout = |name: &str| {
        let config = Config::layout(name).map_err(|error| Failure::new(exit::USAGE, format!("--layout: {error}")))?;
        Ok((name.to_owned(), config))
    };
    names.into_iter().map(layout).collect()
}

/// Round the worlds, and with every round one robot farther.
fn cases(arguments: &MotionArguments, robots: usize) -> Result<Vec<MotionCase>, Failure> {
    let office = [PathBuf::from("office")];
    let paths: &[PathBuf] = if arguments.worlds.is_empty() { &office } else { &arguments.worlds };
    let mut worlds: Vec<(String, World)> = Vec::with_capacity(paths.len());
    for path in paths {
        let mut world = crate::cli::simulate::choice::world(path)?;
        world.time_limit_s = world.time_limit_s.min(f64::from(arguments.duration));
        worlds.push((stem(path), world));
    }
    let case = |run: u64| {
        let index = run as usize;
        let (name, world) = &worlds[index % worlds.len()];
        let seed = arguments.series.seed + run;
        let slips = !arguments.no_slip && run % 2 == 1;
        MotionCase {
            world_name: name.clone(),
            world: world.clone(),
            robot: (index + index / worlds.len()) % robots,
            seed,
            slips: if slips { motion_trials::slips(seed) } else { Vec::new() },
        }
    };
    Ok((0..arguments.runs).map(case).collect())
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(|| "world".to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// Scores of a world, or of all drives.
fn sum<'a>(scored: impl Iterator<Item = &'a Scored<'a>>) -> (MotionScore, usize, f64) {
    let mut sums = (MotionScore::default(), 0, f64::INFINITY);
    for one in scored {
        sums.0.add(&one.score);
        sums.1 += usize::from(one.drive.score.collided);
        sums.2 = f64::min(sums.2, one.drive.mover_clearance_m);
    }
    sums
}

/// The table, a line a world and one for all.
fn table(scored: &[Scored]) -> Vec<String> {
    let mut lines = vec![format!(
        "{:<14} {:>6} {:>4} {:>4} {:>13} {:>13} {:>5} {:>8} {:>5} {:>7} {:>7} {:>4} {:>6} {:>7} {:>8} {:>4} {:>6}",
        "world",
        "drives",
        "V_%",
        "w_%",
        "V_m/s",
        "w_rad/s",
        "nees",
        "slips",
        "s",
        "false/h",
        "movers",
        "time",
        "v_err",
        "contact",
        "ghosts/h",
        "hits",
        "gap_m"
    )];
    let mut names: Vec<&str> = Vec::new();
    for one in scored {
        if !names.contains(&one.case.world_name.as_str()) {
            names.push(&one.case.world_name);
        }
    }
    for name in &names {
        lines.push(line(name, &sum(scored.iter().filter(|one| one.case.world_name == *name))));
    }
    lines.push(line("all", &sum(scored.iter())));
    lines
}

fn line(name: &str, (score, contacts, gap_m): &(MotionScore, usize, f64)) -> String {
    let told = |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |value| format!("{value:.digits$}"));
    let percent = |part: usize, of: usize| {
        if of == 0 { "-".to_owned() } else { format!("{:.0}", 100.0 * part as f64 / of as f64) }
    };
    let mean = |sum: f64, count: usize| (count > 0).then(|| sum / count as f64);
    let rms = |axis: usize| format!("{}/{}", told(score.rms()[axis], 4), told(score.wheel_rms()[axis], 4));
    format!(
        "{:<14} {:>6} {:>4} {:>4} {:>13} {:>13} {:>5} {:>8} {:>5} {:>7.1} {:>7} {:>4} {:>6} {:>7} {:>8.1} {:>4} {:>6}",
        name,
        score.drives,
        percent(score.observed[0], score.sets),
        percent(score.observed[1], score.sets),
        rms(0),
        rms(1),
        told(score.mean_nees(), 1),
        format!("{}/{}", score.slips_told, score.slips),
        told(mean(score.slip_delay_s, score.slips_told), 2),
        score.per_hour(score.false_alarms),
        format!("{}/{}", score.movers_found, score.movers),
        percent(score.mover_hits, score.mover_sets),
        told(score.mover_rms()[0], 3),
        told(mean(score.contact_error_s, score.contacts), 2),
        score.per_hour(score.ghosts),
        contacts,
        told(gap_m.is_finite().then_some(*gap_m), 2),
    )
}

/// Table and drives as JSON.
fn record(scored: &[Scored]) -> Value {
    let runs: Vec<Value> = scored
        .iter()
        .map(|one| {
            let mut value = numbers(&(one.score, usize::from(one.drive.score.collided), one.drive.mover_clearance_m));
            value["world"] = json!(one.case.world_name);
            value["layout"] = json!(one.robot);
            value["seed"] = json!(one.case.seed);
            value["slips_driven"] = json!(one.case.slips.len());
            value
        })
        .collect();
    json!({ "summary": numbers(&sum(scored.iter())), "runs": runs })
}

fn numbers((score, contacts, gap_m): &(MotionScore, usize, f64)) -> Value {
    json!({
        "drives": score.drives,
        "ping_sets": score.sets,
        "time_s": score.time_s,
        "linear_observed": score.observed[0],
        "angular_observed": score.observed[1],
        "linear_rms_m_s": score.rms()[0],
        "angular_rms_rad_s": score.rms()[1],
        "odometry_linear_rms_m_s": score.wheel_rms()[0],
        "odometry_angular_rms_rad_s": score.wheel_rms()[1],
        "nees": score.mean_nees(),
        "slips": score.slips,
        "slips_told": score.slips_told,
        "slip_delay_s": score.slip_delay_s,
        "false_alarms": score.false_alarms,
        "movers": score.movers,
        "movers_found": score.movers_found,
        "mover_sets": score.mover_sets,
        "mover_hits": score.mover_hits,
        "mover_velocity_rms_m_s": score.mover_rms()[0],
        "mover_place_rms_m": score.mover_rms()[1],
        "contacts_foreseen": score.contacts,
        "contact_error_s": score.contact_error_s,
        "ghosts": score.ghosts,
        "ghost_sets": score.ghost_sets,
        "contacts": contacts,
        "mover_gap_m": gap_m.is_finite().then_some(*gap_m),
    })
}

/// Velocities over time and movers on the map.
fn picture(shown: &Scored) -> crate::io::picture::Picture {
    let mut plotted = PlottedMotion::default();
    for (index, sample) in shown.samples.iter().enumerate() {
        let report = &sample.report;
        let known = |axis: usize, value: f64| if report.observed[axis] { value } else { f64::NAN };
        let wheels = report.odometry.map_or([f64::NAN; 2], |wheels| [wheels.linear_m_s, wheels.angular_rad_s]);
        plotted.times_s.push(sample.time_s);
        plotted.truth.push([sample.truth.linear_m_s, sample.truth.angular_rad_s]);
        plotted.echoes.push([known(0, report.velocity.linear_m_s), known(1, report.velocity.angular_rad_s)]);
        plotted.odometry.push(wheels);
        plotted.slip.push(report.slip);
        plotted.way_m.push([sample.pose.x_m, sample.pose.y_m]);
        if index % DRAWN_EVERY == 0 {
            let turn = Rotation2::new(sample.pose.heading_rad);
            plotted.told.extend(report.movers.as_slice().iter().map(|mover| PlottedMover {
                position_m: sample.pose.parent_from_local(mover.position_m).into(),
                velocity_m_s: (turn * mover.velocity_m_s).into(),
                radius_m: mover.radius_m,
            }));
            plotted.real.extend(sample.movers.iter().map(|mover| PlottedMover {
                position_m: mover.centre_m.into(),
                velocity_m_s: mover.velocity_m_s.into(),
                radius_m: mover.radius_m,
            }));
        }
    }
    let title = format!("Ego-motion by echoes: {}, {}, seed {}", shown.case.world_name, shown.robot, shown.case.seed);
    motion_panels(&shown.case.world, &plotted, &title)
}
