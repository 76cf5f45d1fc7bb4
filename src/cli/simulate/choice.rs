//! What was typed, to what it means: world, robots, conditions. What does not exist is refused with what does.

use crate::cli::args::{ConditionArguments, ConfigChoice, SimulateArguments};
use crate::cli::run::{load_world, prefer_pcm};
use crate::cli::{Failure, exit};
use crate::config::{Config, LAYOUT_NAMES};
use crate::parameter::did_you_mean;
use crate::service::proving::Entrant;
use crate::service::trial::{SensorLoss, TrialRig};
use crate::sim::{SimParams, World};
use std::path::Path;

/// The word for the built-in world.
const OFFICE: &str = "office";
/// Name of the built-in robot.
const DEFAULT: &str = "default";

/// The world of that file, or the built-in one.
pub fn world(path: &Path) -> Result<World, Failure> {
    let named = path.to_string_lossy();
    let bare = !named.contains(['/', '.', '\\']);
    if bare && named != OFFICE && !path.exists() {
        let near = did_you_mean(&named, [OFFICE]);
        let message = format!("found no world {named}, allowed: {OFFICE} (built in), or a file{near}");
        return Err(Failure::new(exit::DATA, message));
    }
    load_world((named != OFFICE).then_some(path))
}

/// The robots that were asked for, at least one, each once and in the order asked for.
pub fn entrants(arguments: &SimulateArguments) -> Result<Vec<Entrant>, Failure> {
    let configs = match &arguments.config {
        Some(path) => {
            let config = crate::cli::config::load(&ConfigChoice { config: Some(path.clone()) })?;
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            vec![(stem, config)]
        }
        None if arguments.layout.is_empty() => vec![(DEFAULT.to_owned(), Config::default())],
        None => layouts(&arguments.layout)?,
    };
    let entrant = |(name, mut config): (String, Config)| {
        prefer_pcm(&mut config);
        let losses = losses(&arguments.conditions, &name, &config)?;
        let rig =
            TrialRig::new(config).map_err(|error| Failure::new(exit::CONFIG, format!("layout {name}: {error}")))?;
        rig.setup().hidden.iter().for_each(|what| log::debug!("{name}: hidden: {what}"));
        rig.setup().warnings.iter().for_each(|what| log::debug!("{name}: {what}"));
        Ok(Entrant { name, rig, losses })
    };
    configs.into_iter().map(entrant).collect()
}

fn layouts(typed: &[String]) -> Result<Vec<(String, Config)>, Failure> {
    let mut names: Vec<String> = Vec::new();
    for typed in typed {
        for name in layout_names(typed)? {
            if !names.contains(&name) {
                names.push(name);
            }
        }
    }
    let config = |name: String| match name.as_str() {
        DEFAULT => Ok((name, Config::default())),
        known => {
            let config = Config::layout(known).map_err(|error| Failure::new(exit::USAGE, error))?;
            Ok((name, config))
        }
    };
    names.into_iter().map(config).collect()
}

/// A name, a number or a group as a list of names.
fn layout_names(typed: &str) -> Result<Vec<String>, Failure> {
    let is_group = matches!(typed, "sim" | "real" | "all");
    let numbered = if typed.bytes().all(|byte| byte.is_ascii_digit()) { format!("sim-{typed}") } else { typed.into() };
    let known = LAYOUT_NAMES.iter().map(|name| (*name).to_owned());
    let found: Vec<String> = match typed {
        DEFAULT => vec![DEFAULT.to_owned()],
        "all" => known.collect(),
        _ if is_group => known.filter(|name| name.starts_with(typed)).collect(),
        _ => known.filter(|name| *name == numbered).collect(),
    };
    if found.is_empty() {
        let allowed = LAYOUT_NAMES.join(", ");
        let message = format!(
            "--layout: found {typed:?}, allowed: {allowed}, a number from 1 to 10 for sim-1 to sim-10, {DEFAULT}, or a group: \
             sim, real, all{}",
            did_you_mean(typed, LAYOUT_NAMES)
        );
        return Err(Failure::new(exit::USAGE, message));
    }
    Ok(found)
}

fn losses(conditions: &ConditionArguments, layout: &str, config: &Config) -> Result<Vec<SensorLoss>, Failure> {
    let loss = |(name, at_s): &(String, f64)| {
        let index = config.sensor.iter().position(|sensor| sensor.name == *name);
        let sensor_index = index.ok_or_else(|| {
            let known: Vec<&str> = config.sensor.iter().map(|sensor| sensor.name.as_str()).collect();
            let message = format!(
                "--lose: found {name:?}, allowed: a sensor of every robot; layout {layout} has {}{}",
                known.join(", "),
                did_you_mean(name, known.iter().copied())
            );
            Failure::new(exit::USAGE, message)
        })?;
        Ok(SensorLoss { sensor_index, at_s: *at_s })
    };
    conditions.lose.iter().map(loss).collect()
}

/// The acoustics of all runs. What else the simulator can make harder belongs here.
pub fn acoustics(conditions: &ConditionArguments) -> Result<SimParams, Failure> {
    let quiet = SimParams::default();
    let noise_rms = quiet.noise_rms * 10f64.powf(conditions.noise_db / 20.0);
    let acoustics = SimParams { noise_rms, multipath: conditions.multipath, ..quiet };
    acoustics.validate().map_err(|error| Failure::new(exit::USAGE, format!("the simulation: {error}")))?;
    Ok(acoustics)
}
