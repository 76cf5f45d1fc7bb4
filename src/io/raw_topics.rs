//! Raw pings on topics: the driver's or simulator's side, and the daemon's.
//!
//! What does not fit the configuration is refused with the value found and the value allowed; it never reaches the
//! imaging. Pings are copied once, from shared memory into the daemon's own buffers, without allocating.

use super::error::IpcError;
use super::node::{Ipc, Needs, Registration};
use super::ports::{SlicePublisher, SliceSubscriber};
use super::session::Session;
use super::topics::Topic;
use super::wire::message::{RawHeader, format_number};
use super::wire::{HEADER_VERSION, WireType};
use crate::safety::check_age;
use crate::signal::{RawPing, SampleFormat, Samples};
use crate::time::{FUTURE_LIMIT_NS, Stamp};

/// Oldest emission of a ping on arrival: no timeout of the daemon is longer.
const AGE_MAX_NS: u64 = 1_000_000_000;

/// One port a sample format.
#[derive(Debug)]
enum RawPort<P, I, F> {
    Pdm(P),
    PcmI16(I),
    PcmF32(F),
}

type Sending = RawPort<SlicePublisher<u32, RawHeader>, SlicePublisher<i16, RawHeader>, SlicePublisher<f32, RawHeader>>;
type Receiving =
    RawPort<SliceSubscriber<u32, RawHeader>, SliceSubscriber<i16, RawHeader>, SliceSubscriber<f32, RawHeader>>;

/// What a raw ping must look like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawShape {
    /// Format of the samples.
    pub format: SampleFormat,
    /// Rate of PDM words or PCM samples.
    pub sample_rate_hz: f64,
    /// Microphones.
    pub channel_count: usize,
    /// PDM words, or PCM samples of one microphone.
    pub sample_count: usize,
}

impl RawShape {
    /// Elements of the payload: words (PDM), or values over all microphones (PCM).
    #[must_use]
    pub fn len(&self) -> usize {
        match self.format {
            SampleFormat::Pdm => self.sample_count,
            SampleFormat::PcmI16 | SampleFormat::PcmF32 => self.sample_count * self.channel_count,
        }
    }

    /// Whether a ping would be empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Judges what a driver says of a ping of sensor `sensor_index` that has `value_count` values and arrived at `now`.
    ///
    /// # Errors
    /// The first thing that does not fit.
    pub fn check(
        &self,
        sensor_index: usize,
        header: &RawHeader,
        value_count: usize,
        now: Stamp,
    ) -> Result<(), RawRefusal> {
        if !header.schema_matches() {
            return Err(RawRefusal::Schema { found: header.schema_hash });
        }
        let numbers = [
            ("version", f64::from(header.version), f64::from(HEADER_VERSION)),
            ("sensor_index", f64::from(header.sensor_index), sensor_index as f64),
            ("format", f64::from(header.format), f64::from(format_number(self.format))),
            ("channel_count", f64::from(header.channel_count), self.channel_count as f64),
            ("sample_count", f64::from(header.sample_count), self.sample_count as f64),
            ("sample_rate_hz", header.sample_rate_hz, self.sample_rate_hz),
        ];
        for (field, found, allowed) in numbers {
            if found != allowed {
                return Err(RawRefusal::Header { field, found, allowed });
            }
        }
        if check_age(header.t_monotonic_ns, now, AGE_MAX_NS).is_err() {
            let age_ns = now.since_ns(Stamp { boottime_ns: header.t_monotonic_ns, wall_ns: 0 });
            return Err(RawRefusal::Age { found_ms: age_ns / 1_000_000 });
        }
        if value_count != self.len() {
            return Err(RawRefusal::Length { found: value_count, allowed: self.len() });
        }
        Ok(())
    }
}

/// Publishes one sensor's raw pings.
#[derive(Debug)]
pub struct RawPublisher {
    port: Sending,
    shape: RawShape,
    _registration: Registration,
}

impl RawPublisher {
    /// Shared memory that [`RawPublisher::open`] needs for one sensor, in bytes.
    #[must_use]
    pub fn needed_bytes(name: &str, shape: RawShape) -> u64 {
        Needs::new().publisher(&Topic::raw(name, shape.format), shape.len()).bytes()
    }

    /// Opens the topic of sensor `name` for pings of `shape`.
    ///
    /// # Errors
    /// [`IpcError`], among them 69 when the sensor already has its driver and 73 for too little shared memory.
    pub fn open(ipc: &Ipc, name: &str, shape: RawShape) -> Result<Self, IpcError> {
        let topic = Topic::raw(name, shape.format);
        let needs = Needs::new().publisher(&topic, shape.len());
        let (registration, port) = ipc.set_up("noctule-driver", needs, move |session| {
            Ok(match shape.format {
                SampleFormat::Pdm => RawPort::Pdm(session.slice_publisher(&topic, shape.len())?),
                SampleFormat::PcmI16 => RawPort::PcmI16(session.slice_publisher(&topic, shape.len())?),
                SampleFormat::PcmF32 => RawPort::PcmF32(session.slice_publisher(&topic, shape.len())?),
            })
        })?;
        Ok(Self { port, shape, _registration: registration })
    }

    /// Publishes a ping.
    ///
    /// # Errors
    /// [`IpcError::Send`] for another format, more samples than announced, or a failing transport.
    pub fn publish(&self, ping: &RawPing) -> Result<(), IpcError> {
        let header = RawHeader {
            version: HEADER_VERSION,
            sensor_index: ping.sensor_index as u32,
            sequence: ping.sequence,
            t_monotonic_ns: ping.emitted_at.boottime_ns,
            t_wall_ns: ping.emitted_at.wall_ns,
            sample_rate_hz: self.shape.sample_rate_hz,
            channel_count: self.shape.channel_count as u32,
            sample_count: self.shape.sample_count as u32,
            format: format_number(ping.samples.format()),
            ..RawHeader::blank()
        };
        match (&self.port, &*ping.samples) {
            (RawPort::Pdm(port), Samples::Pdm(words)) => port.send(&header, words),
            (RawPort::PcmI16(port), Samples::PcmI16(values)) => port.send(&header, values),
            (RawPort::PcmF32(port), Samples::PcmF32(values)) => port.send(&header, values),
            _ => Err(IpcError::Send {
                service: "noctule/sonar".to_owned(),
                reason: format!("{:?} was announced, not {:?}", self.shape.format, ping.samples.format()),
            }),
        }
    }
}

/// Why a raw ping was refused, with what was found and what is allowed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum RawRefusal {
    /// Another layout.
    #[error("schema {found:016x}, allowed is {:016x}", RawHeader::SCHEMA_HASH)]
    Schema {
        /// The writer's.
        found: u64,
    },
    /// A number in the header.
    #[error("{field} {found}, the configuration says {allowed}")]
    Header {
        /// Which.
        field: &'static str,
        /// Found.
        found: f64,
        /// Allowed.
        allowed: f64,
    },
    /// The emission lies in the future, or so long ago that the driver's clock must be another: its pings would push
    /// those of the other sensors out of their sets.
    #[error(
        "t_monotonic_ns is {found_ms} ms ago, allowed: {} ms ahead to {} ms ago on CLOCK_BOOTTIME",
        FUTURE_LIMIT_NS / 1_000_000,
        AGE_MAX_NS / 1_000_000
    )]
    Age {
        /// Age on arrival, negative for the future.
        found_ms: i64,
    },
    /// Length of the payload.
    #[error("{found} values, the configuration says {allowed}")]
    Length {
        /// Found.
        found: usize,
        /// Allowed.
        allowed: usize,
    },
}

/// The daemon's ears for raw pings of all sensors.
#[derive(Debug)]
pub struct LiveTopics {
    sensors: Vec<(Receiving, RawShape)>,
    _registration: Registration,
}

impl LiveTopics {
    /// Opens the topic of every sensor; `sensors` are names with what their pings must look like.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc, sensors: &[(String, RawShape)]) -> Result<Self, IpcError> {
        let wanted = sensors.to_vec();
        let topics = sensors.iter().map(|(name, shape)| Topic::raw(name, shape.format));
        let needs = topics.fold(Needs::new(), |needs, topic| needs.subscriber(&topic));
        let (registration, sensors) = ipc.set_up("noctule-live", needs, move |session| {
            wanted.iter().map(|(name, shape)| Ok((receiving(session, name, shape)?, *shape))).collect()
        })?;
        Ok(Self { sensors, _registration: registration })
    }

    /// Copies the next ping of a sensor into `ping`, whose buffer must have the configured format and length. `None` when
    /// nothing waits; to be called until then. `now` is what the ping's stamp is judged by.
    ///
    /// # Errors
    /// [`RawRefusal`]; `ping` is then unchanged.
    pub fn poll(&self, sensor_index: usize, ping: &mut RawPing, now: Stamp) -> Option<Result<(), RawRefusal>> {
        let (port, shape) = self.sensors.get(sensor_index)?;
        match (port, ping.samples_mut()) {
            (RawPort::Pdm(port), Samples::Pdm(into)) => port
                .next(|header, from| take(sensor_index, shape, header, from, into, now))
                .map(|taken| stamp(ping, taken)),
            (RawPort::PcmI16(port), Samples::PcmI16(into)) => port
                .next(|header, from| take(sensor_index, shape, header, from, into, now))
                .map(|taken| stamp(ping, taken)),
            (RawPort::PcmF32(port), Samples::PcmF32(into)) => port
                .next(|header, from| take(sensor_index, shape, header, from, into, now))
                .map(|taken| stamp(ping, taken)),
            _ => Some(Err(RawRefusal::Length { found: 0, allowed: shape.len() })),
        }
    }
}

fn receiving(session: &Session, name: &str, shape: &RawShape) -> Result<Receiving, IpcError> {
    let topic = Topic::raw(name, shape.format);
    Ok(match shape.format {
        SampleFormat::Pdm => RawPort::Pdm(session.slice_subscriber(&topic)?),
        SampleFormat::PcmI16 => RawPort::PcmI16(session.slice_subscriber(&topic)?),
        SampleFormat::PcmF32 => RawPort::PcmF32(session.slice_subscriber(&topic)?),
    })
}

/// Copies the samples of a ping that fits its shape.
fn take<E: Copy>(
    sensor_index: usize,
    shape: &RawShape,
    header: &RawHeader,
    from: &[E],
    into: &mut [E],
    now: Stamp,
) -> Result<RawHeader, RawRefusal> {
    shape.check(sensor_index, header, from.len(), now)?;
    if into.len() != from.len() {
        return Err(RawRefusal::Length { found: from.len(), allowed: into.len() });
    }
    into.copy_from_slice(from);
    Ok(*header)
}

fn stamp(ping: &mut RawPing, taken: Result<RawHeader, RawRefusal>) -> Result<(), RawRefusal> {
    let header = taken?;
    ping.sensor_index = header.sensor_index as usize;
    ping.sequence = header.sequence;
    ping.emitted_at = Stamp { boottime_ns: header.t_monotonic_ns, wall_ns: header.t_wall_ns };
    Ok(())
}
