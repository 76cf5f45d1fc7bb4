//! `noctule topics` and `noctule echo`.

use super::Failure;
use super::args::{EchoArguments, TopicsArguments};
use super::output::{is_printed, print_line};
use super::run::{ipc_failure, prefer_pcm, stop_flag};
use crate::io::Ipc;
use crate::io::c_header::c_header;
use crate::io::echo::{Echo, EchoLimit};
use crate::io::topics::{topics_json, topics_table};
use std::time::Duration;

/// Prints where the topics are, and every type with the offset of every field.
///
/// # Errors
/// Exit 78.
pub fn topics(arguments: &TopicsArguments) -> Result<(), Failure> {
    if arguments.c_header {
        return print_line(c_header().trim_end());
    }
    let config = super::config::load(&arguments.choice)?;
    let sensors: Vec<String> = config.sensor.iter().map(|sensor| sensor.name.clone()).collect();
    let format = config.recording.format;
    if arguments.json {
        print_line(&topics_json(&config.ipc, &sensors, format).to_string())
    } else {
        print_line(topics_table(&config.ipc, &sensors, format).trim_end())
    }
}

/// Prints what passes on a topic until Ctrl-C, a limit, or until nobody reads any more.
///
/// # Errors
/// 2 for a name that is no topic, 78, and the codes of the transport.
pub fn echo(arguments: &EchoArguments) -> Result<(), Failure> {
    let mut config = super::config::load(&arguments.choice)?;
    if arguments.topic.ends_with("/pcm_f32") {
        // Where the configuration leaves the format open, the simulator delivers this one.
        prefer_pcm(&mut config);
    }
    let sensors: Vec<String> = config.sensor.iter().map(|sensor| sensor.name.clone()).collect();
    let stop = stop_flag()?;
    let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
    let echo = Echo::open(&ipc, &arguments.topic, arguments.json, &sensors, config.recording.format)
        .map_err(|error| ipc_failure(&error))?;
    let limit = EchoLimit { count: arguments.count, duration: arguments.duration.map(Duration::from_secs_f64) };
    let mut failed = None;
    echo.run(limit, &stop, |line| match is_printed(line) {
        Ok(printed) => printed,
        Err(failure) => {
            failed = Some(failure);
            false
        }
    });
    failed.map_or(Ok(()), Err)
}
