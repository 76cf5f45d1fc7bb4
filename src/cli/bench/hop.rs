//! The transport by itself: from before a sample is published to its reader having it, between two threads, no work beside.
//!
//! The reader looks all the time, so that what is measured is the transport and not a pause between two looks.

use super::super::Failure;
use super::super::run::ipc_failure;
use super::place::Place;
use super::quantiles::Quantiles;
use crate::config::Config;
use crate::io::wire::message::VelocityCommand;
use crate::io::{ControllerTopics, DaemonTopics, Ipc, LiveTopics, RawPublisher, RawShape};
use crate::service::wiring;
use crate::signal::{DaemonState, PingSet, Reason};
use crate::time::{Clock, Stamp, SystemClock};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Commands, and raw pings, of a measurement.
const COMMANDS: u64 = 10_000;
const PINGS: u64 = 1_000;
/// Pauses between them: the reader has long taken the one before.
const COMMAND_PAUSE: Duration = Duration::from_micros(200);
const PING_PAUSE: Duration = Duration::from_millis(3);

/// One way through the transport.
pub struct Hop {
    /// From what to what.
    pub what: &'static str,
    /// What the machine was doing besides.
    pub load: &'static str,
    /// How long it took.
    pub times: Quantiles,
}

impl Hop {
    /// As the program's output has it.
    #[must_use]
    pub fn json(&self) -> Value {
        let mut value = self.times.json();
        value["what"] = json!(self.what);
        value["load"] = json!(self.load);
        value
    }
}

/// Measures both ways.
///
/// # Errors
/// When the topics cannot be opened, with the transport's code.
pub fn measure(config: &Config, load: &'static str) -> Result<Vec<Hop>, Failure> {
    let place = Place::new(config)?;
    Ok(vec![
        Hop { what: "transport: command sent, received", load, times: commands(&place)? },
        Hop { what: "transport: ping of a sensor sent, copied out", load, times: pings(&place)? },
    ])
}

fn since_ms(then: Stamp, earlier_ns: u64) -> f64 {
    then.since_ns(Stamp { boottime_ns: earlier_ns, wall_ns: 0 }) as f64 * 1e-6
}

fn commands(place: &Place) -> Result<Quantiles, Failure> {
    let ipc = Ipc::open(&place.config.ipc).map_err(|error| ipc_failure(&error))?;
    let mut daemon = DaemonTopics::open(&ipc, &[], &[]).map_err(|error| ipc_failure(&error))?;
    let controller = ControllerTopics::open(&ipc).map_err(|error| ipc_failure(&error))?;
    daemon.connect_latecomers().map_err(|error| ipc_failure(&error))?;
    let stop = AtomicBool::new(false);
    let times_ms = std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let mut times_ms = Vec::with_capacity(COMMANDS as usize);
            while !stop.load(Ordering::Relaxed) {
                match controller.next_command() {
                    Some((command, _)) => times_ms.push(since_ms(SystemClock.now(), command.t_published_ns)),
                    None => std::thread::yield_now(),
                }
            }
            times_ms
        });
        let mut sent = Ok(0);
        for _ in 0..COMMANDS {
            let now = SystemClock.now();
            sent = daemon.publish_command(VelocityCommand::standstill(now, DaemonState::Ready, Reason::NotArmed), now);
            if sent.is_err() {
                break;
            }
            pause(COMMAND_PAUSE);
        }
        stop.store(true, Ordering::Relaxed);
        let times_ms = reader.join().unwrap_or_default();
        sent.map(|_| times_ms)
    });
    Ok(Quantiles::of(times_ms.map_err(|error| ipc_failure(&error))?))
}

fn pings(place: &Place) -> Result<Quantiles, Failure> {
    let config = &place.config;
    let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
    let setup = wiring::sensing(config).map_err(|error| Failure::new(super::super::exit::CONFIG, error))?;
    let shape = RawShape {
        format: setup.plan.format,
        sample_rate_hz: setup.recording.sample_rate_hz,
        channel_count: setup.plan.sensors[0].channel_count,
        sample_count: setup.recording.samples,
    };
    let name = &setup.sensors[0].name;
    let listener = LiveTopics::open(&ipc, &[(name.clone(), shape)]).map_err(|error| ipc_failure(&error))?;
    let publisher = RawPublisher::open(&ipc, name, shape).map_err(|error| ipc_failure(&error))?;
    let empty = PingSet::empty(1, setup.plan.format, &[setup.plan.raw_len(0)]);
    let stop = AtomicBool::new(false);
    let times_ms = std::thread::scope(|scope| {
        let mut into = empty.clone();
        let (stop, listener) = (&stop, &listener);
        let reader = scope.spawn(move || {
            let mut times_ms = Vec::with_capacity(PINGS as usize);
            while !stop.load(Ordering::Relaxed) {
                match listener.poll(0, &mut into.pings[0], SystemClock.now()) {
                    Some(Ok(())) => times_ms.push(since_ms(SystemClock.now(), into.pings[0].emitted_at.boottime_ns)),
                    Some(Err(_)) | None => std::thread::yield_now(),
                }
            }
            times_ms
        });
        let mut ping = empty.pings[0].clone();
        let mut sent = Ok(());
        for sequence in 0..PINGS {
            (ping.sequence, ping.emitted_at) = (sequence, SystemClock.now());
            sent = publisher.publish(&ping);
            if sent.is_err() {
                break;
            }
            pause(PING_PAUSE);
        }
        stop.store(true, Ordering::Relaxed);
        let times_ms = reader.join().unwrap_or_default();
        sent.map(|()| times_ms)
    });
    Ok(Quantiles::of(times_ms.map_err(|error| ipc_failure(&error))?))
}

/// Waits without giving up the processor for long: a sleeping thread would start the next way from a cold core.
fn pause(time: Duration) {
    let end = Instant::now() + time;
    while Instant::now() < end {
        std::thread::sleep(Duration::from_micros(20));
    }
}
