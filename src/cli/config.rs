//! `noctule config`, and loading the configuration for every other command.

use super::args::{ConfigAction, ConfigArguments, ConfigChoice};
use super::output::print_line;
use super::{Failure, exit};
use crate::config::Config;
use crate::document::{DocumentError, DocumentErrorKind};

/// Loads the chosen configuration, or the built-in one, and logs its warnings.
///
/// # Errors
/// Exit 78 for a configuration that is missing or refused.
pub fn load(choice: &ConfigChoice) -> Result<Config, Failure> {
    let config = match &choice.config {
        None => Config::default(),
        Some(path) => Config::load(path).map_err(|error| refused(&error))?,
    };
    for warning in config.warnings() {
        log::warn!("{warning}");
    }
    Ok(config)
}

/// Keys at the top of a world that a configuration has not.
const OF_WORLDS: [&str; 6] = ["waypoints", "wall", "pillar", "mover", "start", "reach_m"];

/// The failure for a configuration, with what to do where that is known.
fn refused(error: &DocumentError) -> Failure {
    let top = error.key.as_deref().map(|key| key.split(['.', '[']).next().unwrap_or(key));
    let hint = match (error.kind, top) {
        (DocumentErrorKind::Missing, _) => {
            format!("; `noctule config --default > {}` makes one to start from", error.path.display())
        }
        (_, Some(key)) if OF_WORLDS.contains(&key) => {
            "\nthis is a world, not a configuration: `noctule simulate WORLD`, `run --source sim:WORLD` or `demo --world WORLD`"
                .to_owned()
        }
        _ => String::new(),
    };
    Failure::new(exit::CONFIG, format!("{error}{hint}"))
}

/// As [`load`], or one of the built-in sensor layouts if one is named.
///
/// # Errors
/// As [`load`], also for a layout that there is not.
pub fn load_or_layout(choice: &ConfigChoice, layout: Option<&str>) -> Result<Config, Failure> {
    match layout {
        None => load(choice),
        Some(name) => Config::layout(name).map_err(|error| Failure::new(exit::CONFIG, error)),
    }
}

/// Prints the configuration in force with every default filled in, which loads again to an equal one; or the reference of all
/// keys; or imports settings.
///
/// # Errors
/// Exit 78, and those of the import.
pub fn config(arguments: &ConfigArguments) -> Result<(), Failure> {
    if let Some(ConfigAction::Import(import)) = &arguments.action {
        return super::import::import(import);
    }
    if arguments.reference {
        return print_line(crate::config::reference().trim_end());
    }
    let config = if arguments.default { Config::default() } else { load(&arguments.choice)? };
    let text = config.to_toml();
    print_line(text.trim_end())
}
