//! `noctule topics` and `noctule echo`.

use super::Failure;
use super::args::{EchoArguments, TopicsArguments};
use super::output::{is_printed, print_line};
use super::run::{ipc_failure, stop_flag};
use crate::config::Config;
use crate::io::Ipc;
use crate::io::c_header::c_header;
use crate::io::echo::{Echo, EchoLimit};
use crate::io::topics::{relayed_json, topics_json, topics_table};
use crate::sensor::RecordingParams;
use crate::signal::SampleFormat;
use crate::time::{Clock as _, Stamp, SystemClock};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Silence after which a person is told what to do.
const SILENCE: Duration = Duration::from_secs(2);

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
    if arguments.transport {
        let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
        return print_line(ipc.transport_toml().map_err(|error| ipc_failure(&error))?.trim_end());
    }
    if arguments.relayed {
        return print_line(&relayed_json(&config.ipc, &sensors, format).to_string());
    }
    if arguments.json {
        print_line(&topics_json(&config.ipc, &sensors, format).to_string())
    } else {
        print_line(topics_table(&config.ipc, &sensors, format).trim_end())
    }
}

/// Prints what passes on a topic until Ctrl-C, a limit, or until nobody reads any more; or how often.
///
/// # Errors
/// 2 for a name that is no topic, 78, and the codes of the transport.
pub fn echo(arguments: &EchoArguments) -> Result<(), Failure> {
    let mut config = super::config::load(&arguments.choice)?;
    let topic = full_name(&arguments.topic);
    fit_format(&topic, &mut config);
    let sensors: Vec<String> = config.sensor.iter().map(|sensor| sensor.name.clone()).collect();
    let stop = stop_flag()?;
    let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
    let echo = Echo::open(&ipc, &topic, arguments.json, &sensors, config.recording.format)
        .map_err(|error| ipc_failure(&error))?;
    let mut failed = None;
    let mut print = |line: &str| match is_printed(line) {
        Ok(printed) => printed,
        Err(failure) => {
            failed = Some(failure);
            false
        }
    };
    let duration = arguments.duration.map(Duration::from_secs_f64);
    if arguments.rate {
        rates(&echo, arguments, duration, &stop, &mut print);
    } else {
        let limit = EchoLimit { count: arguments.count, duration };
        let heard = AtomicBool::new(false);
        std::thread::scope(|scope| {
            // People wonder why nothing comes; programs read standard output alone.
            let told = scope.spawn(|| tell_of_silence(&topic, &heard, &stop));
            echo.run(limit, &stop, |line| {
                heard.store(true, Ordering::Relaxed);
                print(line)
            });
            heard.store(true, Ordering::Relaxed);
            drop(told);
        });
    }
    failed.map_or(Ok(()), Err)
}

/// `command` means `noctule/command`.
fn full_name(topic: &str) -> String {
    if topic.starts_with("noctule/") { topic.to_owned() } else { format!("noctule/{}", topic.trim_start_matches('/')) }
}

/// Where the configuration leaves the format of raw pings open, the topic that is asked for tells it.
fn fit_format(topic: &str, config: &mut Config) {
    if config.recording == RecordingParams::default() {
        if topic.ends_with("/pcm_f32") {
            config.recording.format = SampleFormat::PcmF32;
        } else if topic.ends_with("/pcm") {
            config.recording.format = SampleFormat::PcmI16;
        }
    }
}

fn tell_of_silence(topic: &str, heard: &AtomicBool, stop: &AtomicBool) {
    let begun = Instant::now();
    while begun.elapsed() < SILENCE {
        if heard.load(Ordering::Relaxed) || stop.load(Ordering::Relaxed) {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    log::warn!("nothing on {topic} yet: `noctule status` tells who runs");
}

/// A line a second: samples, and the age of what the newest tells of.
fn rates(
    echo: &Echo,
    arguments: &EchoArguments,
    duration: Option<Duration>,
    stop: &AtomicBool,
    print: &mut impl FnMut(&str) -> bool,
) {
    let begun = Instant::now();
    let mut lines = 0_u64;
    loop {
        let second = Instant::now();
        let (mut count, mut emitted_ns) = (0_u64, None);
        while second.elapsed() < Duration::from_secs(1) {
            if stop.load(Ordering::Relaxed) || duration.is_some_and(|limit| begun.elapsed() >= limit) {
                return;
            }
            while let Some(fields) = echo.next_fields() {
                count += 1;
                emitted_ns = fields.get("t_monotonic_ns").and_then(Value::as_u64);
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        let rate_hz = count as f64 / second.elapsed().as_secs_f64();
        let now = SystemClock.now();
        let age_ms = emitted_ns.map(|at| now.since_ns(Stamp { boottime_ns: at, wall_ns: 0 }) as f64 * 1e-6);
        let line = if arguments.json {
            json!({"rate_hz": rate_hz, "age_ms": age_ms}).to_string()
        } else {
            let age = age_ms.map_or(String::new(), |age_ms| format!(", the newest tells of {age_ms:.1} ms ago"));
            format!("{rate_hz:.1} a second{age}")
        };
        lines += 1;
        if !print(&line) || arguments.count.is_some_and(|count| lines >= count) {
            return;
        }
    }
}
