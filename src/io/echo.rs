//! What passes on a topic, as lines for people or as one JSON object a line: `noctule echo`.
//!
//! Works from the same tables as `noctule topics`; fields that are enumerations are written by name. Of slices the header
//! is shown, with the length and the largest value. Listens only: never publishes, never holds a sample.

use super::error::IpcError;
use super::node::{Ipc, Needs, Registration};
use super::ports::{FixedSubscriber, SliceSubscriber};
use super::session::Session;
use super::topics::{self, Topic};
use super::wire::detections::{Objects, Obstacle, Scan};
use super::wire::message::{EnergyscapeHeader, Odometry, OperatorRequest, RawHeader, VelocityCommand, VelocityInput};
use super::wire::motion::EgoMotion;
use super::wire::points::PointCloud3;
use super::wire::telemetry::{Cues, Health, PlatformVelocity};
use super::wire::{Primitive, WireType, fields_json};
use crate::parameter::did_you_mean;
use crate::signal::SampleFormat;
use iceoryx2::prelude::ZeroCopySend;
use serde_json::{Map, Value, json};
use std::fmt::{Debug, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Pause between two looks: what keeps fewest samples keeps one, at 10 Hz; the platform's four come every 20 ms.
const LOOK_PAUSE: Duration = Duration::from_millis(2);
/// Longest array that people are shown; programs get all of it.
const LISTED_MAX: usize = 16;
/// Fields that say nothing to people.
const UNSAID: [&str; 5] = ["schema_hash", "reserved", "version", "checksum", "t_wall_ns"];

/// When an echo ends.
#[derive(Debug, Clone, Copy, Default)]
pub struct EchoLimit {
    /// After this many samples.
    pub count: Option<u64>,
    /// After this time.
    pub duration: Option<Duration>,
}

/// An open ear on one topic.
pub struct Echo {
    port: Box<dyn Listen>,
    json: bool,
    _registration: Registration,
}

impl Echo {
    /// Opens `topic`, one of those of a robot with these sensors and this raw format. Whoever publishes may come later.
    ///
    /// # Errors
    /// [`IpcError::UnknownTopic`] (2) naming those there are, and the errors of the transport.
    pub fn open(
        ipc: &Ipc,
        topic: &str,
        json: bool,
        sensors: &[String],
        format: SampleFormat,
    ) -> Result<Self, IpcError> {
        let mut all = Topic::all(sensors, format);
        all.extend(Topic::all_relayed(sensors));
        let known = || {
            let names: Vec<&str> = all.iter().map(|topic| topic.name.as_str()).collect();
            format!("{}{}", names.join(", "), did_you_mean(topic, names.iter().copied()))
        };
        let found = all
            .iter()
            .find(|known| known.name == topic)
            .ok_or_else(|| IpcError::UnknownTopic { topic: topic.to_owned(), known: known() })?
            .clone();
        let needs = Needs::new().subscriber(&found);
        let (registration, port) = ipc.set_up("noctule-echo", needs, move |session| listen(session, &found))?;
        Ok(Self { port, json, _registration: registration })
    }

    /// The fields of the next sample; `None` when nothing waits.
    #[must_use]
    pub fn next_fields(&self) -> Option<Map<String, Value>> {
        self.port.next_fields()
    }

    /// The next sample as a line without its end; `None` when nothing waits.
    #[must_use]
    pub fn next_line(&self) -> Option<String> {
        let fields = self.next_fields()?;
        Some(if self.json { Value::Object(fields).to_string() } else { line_for_people(&fields) })
    }

    /// Gives every line to `print` until `stop`, the limit, or until `print` says false. Returns the number of lines.
    pub fn run(&self, limit: EchoLimit, stop: &AtomicBool, mut print: impl FnMut(&str) -> bool) -> u64 {
        let begun = Instant::now();
        let mut printed = 0;
        loop {
            while let Some(line) = self.next_line() {
                if !print(&line) {
                    return printed;
                }
                printed += 1;
                if limit.count.is_some_and(|count| printed >= count) {
                    return printed;
                }
            }
            if stop.load(Ordering::Relaxed) || limit.duration.is_some_and(|duration| begun.elapsed() >= duration) {
                return printed;
            }
            std::thread::sleep(LOOK_PAUSE);
        }
    }
}

/// A subscriber whose type does not matter any more.
trait Listen: Send {
    fn next_fields(&self) -> Option<Map<String, Value>>;
}

impl<T: WireType + ZeroCopySend + Debug + Send> Listen for FixedSubscriber<T> {
    fn next_fields(&self) -> Option<Map<String, Value>> {
        self.next().map(|(sample, _)| fields_json(T::FIELDS, bytemuck::bytes_of(&sample)))
    }
}

impl<E, H> Listen for SliceSubscriber<E, H>
where
    E: ZeroCopySend + Debug + Copy + PartialOrd + Into<f64> + Send + 'static,
    H: WireType + ZeroCopySend + Debug + Send,
{
    fn next_fields(&self) -> Option<Map<String, Value>> {
        self.next(|header, values| {
            let mut fields = fields_json(H::FIELDS, bytemuck::bytes_of(header));
            // A NaN is larger than nothing and smaller than nothing: shown as null, as any other of JSON's.
            let largest =
                values.iter().map(|&value| value.into()).fold(f64::NEG_INFINITY, |largest: f64, value: f64| {
                    if value.is_nan() || largest.is_nan() { f64::NAN } else { largest.max(value) }
                });
            fields.insert("len".to_owned(), json!(values.len()));
            fields.insert("max".to_owned(), json!(largest));
            fields
        })
    }
}

fn listen(session: &Session, topic: &Topic) -> Result<Box<dyn Listen>, IpcError> {
    fn fixed<T>(session: &Session, topic: &Topic) -> Result<Box<dyn Listen>, IpcError>
    where
        T: WireType + ZeroCopySend + Debug + Send,
    {
        Ok(Box::new(session.subscriber::<T>(topic)?))
    }
    match topic.original_name().as_str() {
        topics::COMMAND => fixed::<VelocityCommand>(session, topic),
        topics::INPUT => fixed::<VelocityInput>(session, topic),
        topics::OPERATOR => fixed::<OperatorRequest>(session, topic),
        topics::ODOMETRY => fixed::<Odometry>(session, topic),
        topics::PLATFORM => fixed::<PlatformVelocity>(session, topic),
        topics::CUES => fixed::<Cues>(session, topic),
        topics::HEALTH => fixed::<Health>(session, topic),
        topics::SCAN => fixed::<Scan>(session, topic),
        topics::OBSTACLE => fixed::<Obstacle>(session, topic),
        topics::OBJECTS => fixed::<Objects>(session, topic),
        topics::EGO_MOTION => fixed::<EgoMotion>(session, topic),
        topics::POINTS => fixed::<PointCloud3>(session, topic),
        name if name.ends_with("/energyscape") => {
            Ok(Box::new(session.slice_subscriber::<f32, EnergyscapeHeader>(topic)?))
        }
        _ if topic.payload.type_name == Primitive::U32.name() => {
            Ok(Box::new(session.slice_subscriber::<u32, RawHeader>(topic)?))
        }
        _ if topic.payload.type_name == Primitive::I16.name() => {
            Ok(Box::new(session.slice_subscriber::<i16, RawHeader>(topic)?))
        }
        _ => Ok(Box::new(session.slice_subscriber::<f32, RawHeader>(topic)?)),
    }
}

/// `name=value` for what people read, numbers shortened.
fn line_for_people(fields: &Map<String, Value>) -> String {
    let mut line = String::new();
    for (name, value) in fields.iter().filter(|(name, _)| !UNSAID.contains(&name.as_str())) {
        let space = if line.is_empty() { "" } else { "  " };
        let _ = write!(line, "{space}{name}={}", short(value));
    }
    line
}

fn short(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) if values.len() > LISTED_MAX => format!("[{} values]", values.len()),
        Value::Array(values) => format!("[{}]", values.iter().map(short).collect::<Vec<_>>().join(" ")),
        Value::Number(number) if number.is_f64() => {
            let number = number.as_f64().unwrap_or(f64::NAN);
            let text = format!("{number:.4}");
            // Small energies must not all look like zero.
            if number != 0.0 && number.abs() < 1e-3 { format!("{number:.3e}") } else { text }
        }
        Value::Null => "nan".to_owned(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_read_names_and_short_numbers() {
        let command =
            VelocityCommand { linear_m_s: 0.123_456, cause_energy: 1.5e-5, state: 3, ..VelocityCommand::blank() };
        let line = line_for_people(&fields_json(VelocityCommand::FIELDS, bytemuck::bytes_of(&command)));
        assert!(line.contains("linear_m_s=0.1235") && line.contains("cause_energy=1.500e-5"), "{line}");
        assert!(line.contains("state=ACTIVE") && !line.contains("schema_hash"), "{line}");
    }
}
