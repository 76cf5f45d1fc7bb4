//! `noctule doctor`: is this machine, this configuration and what lies in shared memory fit for the robot? Each line says what
//! was found and what to do about it.
//!
//! In: a configuration and the machine. Out: lines, or one JSON object. Makes, locks and changes nothing, so that it runs beside a
//! live daemon and where none ever ran; every look ends.

mod communication;
mod graphics;
mod machine;
mod needs;

use super::args::DoctorArguments;
use super::output::print_line;
use super::run::prefer_pcm;
use super::{Failure, exit};
use crate::config::Config;
use crate::io::survey::Survey;
use crate::io::topics::Topic;
use serde::Serialize;
use serde_json::json;

/// How grave a line is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
enum Level {
    /// As it should be.
    Ok,
    /// Good to know; the robot runs with it.
    Note,
    /// Prevents a start, or spoils a run.
    Problem,
}

impl Level {
    fn as_str(self) -> &'static str {
        match self {
            Level::Ok => "ok",
            Level::Note => "note",
            Level::Problem => "PROBLEM",
        }
    }
}

/// One thing looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Line {
    level: Level,
    about: &'static str,
    found: String,
    #[serde(skip_serializing_if = "String::is_empty")]
    remedy: String,
}

impl Line {
    fn ok(about: &'static str, found: impl Into<String>) -> Self {
        Self { level: Level::Ok, about, found: found.into(), remedy: String::new() }
    }

    fn note(about: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { level: Level::Note, about, found: found.into(), remedy: remedy.into() }
    }

    fn problem(about: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { level: Level::Problem, about, found: found.into(), remedy: remedy.into() }
    }
}

/// Looks at everything.
///
/// # Errors
/// Exit 1 with a problem.
pub fn doctor(arguments: &DoctorArguments) -> Result<(), Failure> {
    let mut lines = Vec::new();
    let mut config = configuration(arguments, &mut lines);
    prefer_pcm(&mut config);
    let sensors: Vec<String> = config.sensor.iter().map(|sensor| sensor.name.clone()).collect();
    let survey = Survey::take(&config.ipc, Topic::all(&sensors, config.recording.format));
    communication::look(&survey, &mut lines);
    needs::look(&config, &survey, &mut lines);
    graphics::look(config.imaging.backend, &mut lines);
    machine::look(&mut lines);
    let count = |level: Level| lines.iter().filter(|line| line.level == level).count();
    let (problems, notes) = (count(Level::Problem), count(Level::Note));
    if arguments.json {
        let object = json!({
            "root": survey.root_path, "prefix": survey.prefix, "lines": lines, "problems": problems, "notes": notes,
        });
        print_line(&object.to_string())?;
    } else {
        let width = lines.iter().map(|line| line.about.len()).max().unwrap_or(0);
        for line in &lines {
            print_line(&format!("{:8} {:width$}  {}", line.level.as_str(), line.about, line.found))?;
            if !line.remedy.is_empty() {
                print_line(&format!("{:8} {:width$}  -> {}", "", "", line.remedy))?;
            }
        }
        print_line(&format!("{problems} problems, {notes} notes"))?;
    }
    if problems == 0 { Ok(()) } else { Err(Failure::new(exit::FINDING, "")) }
}

/// Judges the configuration. Where it is refused, the rest is looked at with the built-in one.
fn configuration(arguments: &DoctorArguments, lines: &mut Vec<Line>) -> Config {
    const ABOUT: &str = "configuration";
    let Some(path) = &arguments.choice.config else {
        let found = "none given: the built-in three-sensor robot in simulation";
        lines.push(Line::ok(ABOUT, found));
        return Config::default();
    };
    match Config::load(path) {
        Ok(config) => {
            let names: Vec<&str> = config.sensor.iter().map(|sensor| sensor.name.as_str()).collect();
            lines.push(Line::ok(ABOUT, format!("{}: valid, sensors {}", path.display(), names.join(", "))));
            for warning in config.warnings() {
                lines.push(Line::note(ABOUT, warning, "change the key that is named, or leave it if it is meant"));
            }
            config
        }
        Err(error) => {
            let remedy = "correct it; `noctule config --default` prints one that is valid";
            lines.push(Line::problem(ABOUT, error.to_string(), remedy));
            Config::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_well_needs_no_remedy() {
        let mut lines = Vec::new();
        let mut config = Config::default();
        config.ipc.prefix = format!("doctor{}_", std::process::id());
        let survey = Survey::take(&config.ipc, Vec::new());
        communication::look(&survey, &mut lines);
        needs::look(&config, &survey, &mut lines);
        machine::look(&mut lines);
        assert!(lines.len() > 8, "{lines:?}");
        for line in lines {
            assert_eq!(line.remedy.is_empty(), line.level == Level::Ok, "{line:?}");
            assert!(!line.found.is_empty());
        }
    }
}
