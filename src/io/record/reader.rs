//! A recorded run, entry by entry: what the pipeline was told, raw pings, commands, images.
//!
//! Goes on from part to part. Topics that are not ours, as others add them, are passed over; a message of ours that another
//! build wrote with other fields is an error. Never interprets what it gives.

use super::messages::MessageReader;
use super::scribe::{COMMAND, INPUT, ODOMETRY, OPERATOR, PIPELINE};
use super::volume::part_path;
use super::{Cut, RecordError};
use crate::io::ros::{self, Image, PipelineStep, RawPingMessage, RosError, WireMessage};
use crate::io::wire::WireType;
use crate::io::wire::message::{
    EnergyscapeHeader, Odometry, OperatorRequest, VelocityCommand, VelocityInput, format_number,
};
use crate::signal::{PingSet, Samples};
use crate::time::Stamp;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// One entry of a recorded run.
#[derive(Debug)]
pub enum Entry<'a> {
    /// What the pipeline was told.
    Step(PipelineStep),
    /// A raw ping, and the sensor's name.
    Raw(&'a str, RawPingMessage<'a>),
    /// A command.
    Command(VelocityCommand),
    /// Axes and times of the image that follows.
    Info(EnergyscapeHeader),
    /// An image, and the sensor's name.
    Image(&'a str, Image<'a>),
    /// A wanted velocity.
    Input(VelocityInput),
    /// An operator's request.
    Operator(OperatorRequest),
    /// Pose and twist.
    Odometry(Odometry),
}

/// An open recording.
pub struct RunReader<R = BufReader<File>> {
    first: PathBuf,
    part: u32,
    messages: MessageReader<R>,
}

impl RunReader {
    /// Opens the first part of a recording; the others follow by themselves.
    ///
    /// # Errors
    /// [`RecordError`] for what cannot be read or is no MCAP file.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        Ok(Self { first: path.to_owned(), part: 0, messages: open_part(path)? })
    }

    /// The next entry; none at the end of the last part.
    ///
    /// # Errors
    /// [`RecordError`] for a file that is damaged, not merely cut off, and for messages of another build.
    pub fn next_entry(&mut self) -> Result<Option<Entry<'_>>, RecordError> {
        while !self.messages.skip_to(is_ours)? {
            let next = part_path(&self.first, self.part + 1);
            if !next.is_file() {
                return Ok(None);
            }
            self.messages = open_part(&next)?;
            self.part += 1;
        }
        self.entry()
    }
}

impl<R: Read> RunReader<R> {
    /// As [`RunReader::open`], for the `length` bytes that `reader` gives; of `path` only the name is used, and no part follows.
    ///
    /// # Errors
    /// As [`RunReader::open`].
    pub fn from_reader(path: &Path, reader: R, length: u64) -> Result<Self, RecordError> {
        Ok(Self { first: path.to_owned(), part: 0, messages: MessageReader::open(path, reader, length)? })
    }

    /// The next entry of this file.
    ///
    /// # Errors
    /// As [`RunReader::next_entry`].
    pub fn next_entry_of_part(&mut self) -> Result<Option<Entry<'_>>, RecordError> {
        if self.messages.skip_to(is_ours)? { self.entry() } else { Ok(None) }
    }

    /// The configuration that was recorded with it, as TOML.
    #[must_use]
    pub fn config_toml(&self) -> Option<&str> {
        self.messages.config_toml()
    }

    /// What was lost of the part read last, if it was cut off.
    #[must_use]
    pub fn cut(&self) -> Option<Cut> {
        self.messages.cut()
    }

    fn entry(&self) -> Result<Option<Entry<'_>>, RecordError> {
        let message = self.messages.current();
        entry(message.topic, message.data).map(Some).map_err(|error| RecordError::Content {
            path: part_path(&self.first, self.part),
            found: format!("{}: {error}", message.topic),
            allowed: "messages of this build of noctule".to_owned(),
        })
    }
}

fn is_ours(topic: &str) -> bool {
    let small = [PIPELINE, COMMAND, INPUT, OPERATOR, ODOMETRY];
    let leaf = ros::sonar_of(topic).map(|(_, leaf)| leaf);
    small.contains(&topic) || matches!(leaf, Some("raw" | "energyscape" | "energyscape_info"))
}

fn wire<T: WireType>(data: &[u8]) -> Result<T, RosError> {
    Ok(ros::decode::<WireMessage<T>>(data)?.checked()?.wire)
}

fn entry<'a>(topic: &'a str, data: &'a [u8]) -> Result<Entry<'a>, RosError> {
    Ok(match (topic, ros::sonar_of(topic)) {
        (PIPELINE, _) => Entry::Step(wire(data)?),
        (COMMAND, _) => Entry::Command(wire(data)?),
        (INPUT, _) => Entry::Input(wire(data)?),
        (OPERATOR, _) => Entry::Operator(wire(data)?),
        (_, Some((_, "energyscape_info"))) => Entry::Info(wire(data)?),
        (_, Some((sensor, "energyscape"))) => Entry::Image(sensor, ros::decode(data)?),
        (_, Some((sensor, _))) => Entry::Raw(sensor, ros::decode::<RawPingMessage<'_>>(data)?.checked()?),
        _ => Entry::Odometry(wire(data)?),
    })
}

/// Copies a raw ping into the set that is being put together.
///
/// # Errors
/// A sensor or a format that the set is not made for.
pub fn take_ping(path: &Path, ping: &RawPingMessage<'_>, heard: &mut PingSet) -> Result<(), RecordError> {
    let content = |found: String, allowed: String| RecordError::Content { path: path.to_owned(), found, allowed };
    let (wire, data, count) = (&ping.wire, ping.data.0, heard.pings.len());
    let Some(into) = heard.pings.get_mut(wire.sensor_index as usize) else {
        let found = format!("a ping of sensor {}", wire.sensor_index);
        return Err(content(found, format!("sensors 0 to {}, as the configuration says", count - 1)));
    };
    let (format, len) = (into.samples.format(), into.samples.len());
    let fits = format_number(format) == wire.format
        && match into.samples_mut() {
            Samples::Pdm(into) => fill(bytemuck::cast_slice_mut(into), data),
            Samples::PcmI16(into) => fill(bytemuck::cast_slice_mut(into), data),
            Samples::PcmF32(into) => fill(bytemuck::cast_slice_mut(into), data),
        };
    if !fits {
        let found = format!("pings of {} bytes in format {}", data.len(), wire.format);
        let allowed = format!("{} of {} values, as the configuration says", format.as_str(), len);
        return Err(content(found, allowed));
    }
    into.sequence = wire.sequence;
    into.emitted_at = Stamp { boottime_ns: wire.t_monotonic_ns, wall_ns: wire.t_wall_ns };
    heard.present[wire.sensor_index as usize] = true;
    Ok(())
}

fn fill(into: &mut [u8], from: &[u8]) -> bool {
    let fits = into.len() == from.len();
    if fits {
        into.copy_from_slice(from);
    }
    fits
}

fn open_part(path: &Path) -> Result<MessageReader<BufReader<File>>, RecordError> {
    let failed = |error: std::io::Error| RecordError::Io { path: path.to_owned(), reason: error.to_string() };
    let metadata = std::fs::metadata(path).map_err(failed)?;
    if !metadata.is_file() {
        return Err(RecordError::Content {
            path: path.to_owned(),
            found: "no regular file".to_owned(),
            allowed: "an MCAP file".to_owned(),
        });
    }
    let file = File::open(path).map_err(failed)?;
    MessageReader::open(path, BufReader::with_capacity(1 << 16, file), metadata.len())
}
