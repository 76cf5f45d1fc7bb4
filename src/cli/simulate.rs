//! `noctule simulate`: robots drive through a world, many at a time, and are scored (specification, section 11).
//!
//! Goes in: what was typed. Comes out: a line a run on standard output, JSON, trajectories and pictures. What drives is
//! [`crate::service::proving`]; nothing here decides how a robot moves.

pub(super) mod choice;
mod film;
mod report;
mod sweep;
mod trajectory;

use super::Failure;
use super::args::SimulateArguments;
use super::output::{NewFile, make_folder, print_line, progress, write_picture};
use super::run::service_failure;
use super::series::{check_places, check_seeds, cores};
use crate::imaging::backend::BackendKind;
use crate::imaging::params::Prefer;
use crate::io::plot::{HeatMapOptions, PathsOptions, PlottedRun, heat_map, paths, paths_by_layout};
use crate::service::plots::plotted_run;
use crate::service::proving::{Entrant, Programme, Run, Told};
use crate::sim::{SimParams, World};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Runs the command.
///
/// # Errors
/// 2 for a layout or sensor that there is not, 65 for a world and 78 for a configuration that cannot be used, 69 without
/// the backend asked for, 73, 74 and 77 for what cannot be written; else the code of the first run that failed, after everything
/// that the other runs gave was written.
pub fn simulate(arguments: &SimulateArguments) -> Result<(), Failure> {
    let proving = Proving::prepare(arguments)?;
    match arguments.sweep {
        Some(drawn) => sweep::sweep(proving, drawn),
        None => prove(&proving),
    }
}

/// Everything that was typed, found good.
struct Proving<'a> {
    arguments: &'a SimulateArguments,
    world: World,
    entrants: Vec<Entrant>,
    acoustics: SimParams,
    prefer: Prefer,
    jobs: usize,
    json: JsonPlace,
}

impl<'a> Proving<'a> {
    fn prepare(arguments: &'a SimulateArguments) -> Result<Self, Failure> {
        let world = choice::world(&arguments.world)?;
        check_seeds(arguments.seed, arguments.runs)?;
        let entrants = choice::entrants(arguments)?;
        let acoustics = choice::acoustics(&arguments.conditions)?;
        let asked = arguments.backend.map_or(entrants[0].rig.config().imaging.backend, Into::into);
        let report = entrants[0].rig.backend(asked).map_err(|error| service_failure(&error))?;
        // What was found once need not be looked for again by every run.
        let (prefer, jobs) = match report.kind {
            BackendKind::Cpu => (Prefer::Cpu, cores()),
            BackendKind::Gpu => (asked, 1),
        };
        // Long work should not end at a place that cannot be written to.
        let json = JsonPlace::take(arguments.json.as_deref())?;
        arguments.trajectories.as_deref().map_or(Ok(()), make_folder)?;
        let pictures = [&arguments.plot, &arguments.paths, &arguments.frames];
        check_places(pictures.into_iter().flatten().map(PathBuf::as_path))?;
        let jobs = arguments.jobs.map_or(jobs, usize::from);
        Ok(Self { arguments, world, entrants, acoustics, prefer, jobs, json })
    }

    /// Drives all entrants; `finished` sees every run in order. A trajectory is written as soon as its run is over.
    fn drive(&self, mut finished: impl FnMut(&Run) -> Result<(), Failure>) -> Result<Vec<Run>, Failure> {
        let programme = Programme {
            world: &self.world,
            entrants: &self.entrants,
            acoustics: self.acoustics,
            prefer: self.prefer,
            first_seed: self.arguments.seed,
            runs: self.arguments.runs,
            jobs: self.jobs,
        };
        let bar = progress(0, "driving");
        let begin = Instant::now();
        let mut failed = None;
        let runs = programme.drive(&mut |told| match told {
            Told::Progress { sets, of } => {
                bar.set_length(of);
                bar.set_position(sets);
            }
            Told::Finished(run) => {
                let told = bar.suspend(|| finished(run)).and_then(|()| self.write_trajectory(run));
                failed = failed.take().or(told.err());
            }
        });
        bar.finish_and_clear();
        let runs = runs.map_err(|error| service_failure(&error))?;
        let simulated_s: f64 = runs.iter().flat_map(|run| &run.outcome).map(|trial| trial.score.duration_s).sum();
        log::info!("{} runs, {simulated_s:.0} s driven in {:.1} s", runs.len(), begin.elapsed().as_secs_f64());
        failed.map_or(Ok(runs), Err)
    }

    fn write_trajectory(&self, run: &Run) -> Result<(), Failure> {
        let (Some(folder), Ok(trial)) = (&self.arguments.trajectories, &run.outcome) else { return Ok(()) };
        let sensors = &self.entrants[run.entrant].rig.setup().sensors;
        trajectory::write(&folder.join(format!("{}_{}.csv", run.layout, run.seed)), trial, sensors)
    }

    fn world_name(&self) -> String {
        self.arguments.world.display().to_string()
    }

    /// What a picture calls the world.
    fn world_title(&self) -> String {
        self.arguments.world.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    }
}

/// Drives, prints and writes.
fn prove(proving: &Proving) -> Result<(), Failure> {
    let mut header = (!proving.json.is_stdout()).then(report::header);
    let waypoints = proving.world.waypoints.len();
    let runs = proving.drive(|run| {
        if proving.json.is_stdout() {
            return Ok(());
        }
        header.take().map_or(Ok(()), |header| print_line(&header))?;
        print_line(&report::line(run, waypoints))
    })?;
    if !proving.json.is_stdout() {
        report::summary_lines(&runs).iter().try_for_each(|line| print_line(line))?;
    }
    let world = proving.world_name();
    proving.json.write(&json!({
        "world": world,
        "runs": report::records(&runs, &world),
        "failed": report::failures(&runs),
        "summary": report::summary(&runs),
    }))?;
    draw(proving, &runs)?;
    first_failure(&runs)
}

/// The pictures that were asked for, of all runs together.
fn draw(proving: &Proving, runs: &[Run]) -> Result<(), Failure> {
    let plotted: Vec<PlottedRun> =
        runs.iter().filter_map(|run| run.outcome.as_ref().ok().map(|trial| plotted_run(&run.layout, trial))).collect();
    let title = proving.world_title();
    if let Some(path) = &proving.arguments.plot {
        let radii_m = proving.entrants.iter().map(|entrant| entrant.rig.config().platform.radius_m);
        // Where robots of several sizes drove, what the smallest covered was covered by all.
        let footprint_radius_m = radii_m.fold(f64::INFINITY, f64::min);
        let options = HeatMapOptions { title: title.clone(), footprint_radius_m, ..HeatMapOptions::default() };
        write_picture(path, &heat_map(&proving.world, &plotted, &options))?;
    }
    if let Some(path) = &proving.arguments.paths {
        let options = PathsOptions { title, ..PathsOptions::default() };
        let several = proving.entrants.len() > 1;
        let picture = if several { paths_by_layout } else { paths }(&proving.world, &plotted, &options);
        write_picture(path, &picture)?;
    }
    if let Some(path) = &proving.arguments.frames {
        write_picture(path, &film::film(proving)?)?;
    }
    Ok(())
}

/// One error for all runs that could not be driven, with the code of the first.
fn first_failure(runs: &[Run]) -> Result<(), Failure> {
    let mut failed = runs.iter().filter_map(|run| run.outcome.as_ref().err().map(|error| (run, error)));
    let Some((first, error)) = failed.next() else { return Ok(()) };
    let more = match failed.count() {
        0 => String::new(),
        count => format!(" (and {count} more of {} runs failed)", runs.len()),
    };
    let failure = service_failure(error);
    Err(Failure::new(failure.code, format!("{}, seed {}: {}{more}", first.layout, first.seed, failure.message)))
}

/// Where the JSON goes. A file is opened before the work begins and takes its place when it is complete.
enum JsonPlace {
    Nowhere,
    Stdout,
    File(std::path::PathBuf),
}

impl JsonPlace {
    fn take(path: Option<&Path>) -> Result<Self, Failure> {
        match path {
            None => Ok(Self::Nowhere),
            Some(path) if path.as_os_str() == "-" => Ok(Self::Stdout),
            Some(path) => {
                drop(NewFile::create(path)?);
                Ok(Self::File(path.to_owned()))
            }
        }
    }

    fn is_stdout(&self) -> bool {
        matches!(self, Self::Stdout)
    }

    fn write(&self, value: &Value) -> Result<(), Failure> {
        match self {
            Self::Nowhere => Ok(()),
            Self::Stdout => print_line(&format!("{value:#}")),
            Self::File(path) => super::output::write_json(path, value),
        }
    }
}
