//! The raw pings of one sensor of a recorded run, as the bytes of a file of pings: for tools that image recordings.
//!
//! In: a recording and a sensor. Out: what its pings look like, and their samples one after the other, little-endian. A recording
//! that was cut off ends with its last whole chunk.

use super::{Entry, RecordError, RunReader};
use crate::io::wire::message::format_of;
use crate::signal::SampleFormat;
use std::io::{Error, ErrorKind, Read};
use std::path::Path;

/// What the pings of a sensor look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PingShape {
    /// Format of the samples.
    pub format: SampleFormat,
    /// Microphones.
    pub channel_count: usize,
    /// PDM words, or PCM samples of one microphone.
    pub sample_count: usize,
    /// Bytes of a ping.
    pub bytes: usize,
    /// Pings in the recording.
    pub count: usize,
}

/// Samples of one sensor's pings.
pub struct RunPings {
    reader: RunReader,
    sensor_index: u32,
    ping: Vec<u8>,
    at: usize,
    bytes: usize,
}

impl RunPings {
    /// Goes through the recording at `path` once to see what pings sensor `sensor_index` has there.
    ///
    /// # Errors
    /// [`RecordError`], also where there is no ping of that sensor, or where they are not all alike.
    pub fn open(path: &Path, sensor_index: usize) -> Result<(Self, PingShape), RecordError> {
        let content = |found: String, allowed: &str| RecordError::Content {
            path: path.to_owned(),
            found,
            allowed: allowed.to_owned(),
        };
        let mut shape: Option<PingShape> = None;
        let mut reader = RunReader::open(path)?;
        while let Some(entry) = reader.next_entry()? {
            let Entry::Raw(_, ping) = entry else { continue };
            if ping.wire.sensor_index as usize != sensor_index {
                continue;
            }
            let unknown = || content(format!("raw format {}", ping.wire.format), "0 pdm, 1 pcm-i16, 2 pcm-f32");
            let format = format_of(ping.wire.format).ok_or_else(unknown)?;
            let found = PingShape {
                format,
                channel_count: ping.wire.channel_count as usize,
                sample_count: ping.wire.sample_count as usize,
                bytes: ping.data.0.len(),
                count: 1,
            };
            let alike = |shape: &PingShape| PingShape { count: 1, ..*shape } == found;
            match &mut shape {
                None => shape = Some(found),
                Some(shape) if alike(shape) => shape.count += 1,
                Some(_) => {
                    return Err(content("pings that differ in format or length".to_owned(), "pings of one kind"));
                }
            }
        }
        let none = || content(format!("no raw ping of sensor {sensor_index}"), "a recording with raw pings");
        let shape = shape.ok_or_else(none)?;
        let value_bytes = if shape.format == SampleFormat::PcmI16 { 2 } else { 4 };
        let channels = if shape.format == SampleFormat::Pdm { 1 } else { shape.channel_count };
        if shape.sample_count.checked_mul(channels * value_bytes) != Some(shape.bytes) {
            let found = format!("{} bytes for {} samples of {channels} channels", shape.bytes, shape.sample_count);
            return Err(content(found, "as many bytes as samples"));
        }
        let (sensor_index, bytes) = (sensor_index as u32, shape.bytes);
        let reader = RunReader::open(path)?;
        Ok((Self { reader, sensor_index, ping: Vec::new(), at: 0, bytes }, shape))
    }

    /// Takes the next ping; false at the end.
    fn advance(&mut self) -> Result<bool, Error> {
        while let Some(entry) = self.reader.next_entry().map_err(Error::other)? {
            match entry {
                Entry::Raw(_, ping) if ping.wire.sensor_index == self.sensor_index => {
                    if ping.data.0.len() != self.bytes {
                        return Err(Error::new(ErrorKind::InvalidData, "the recording changed while it was read"));
                    }
                    self.ping.clear();
                    self.ping.extend_from_slice(ping.data.0);
                    self.at = 0;
                    return Ok(true);
                }
                _ => {}
            }
        }
        Ok(false)
    }
}

impl Read for RunPings {
    fn read(&mut self, into: &mut [u8]) -> Result<usize, Error> {
        if self.at == self.ping.len() && !self.advance()? {
            return Ok(0);
        }
        let count = into.len().min(self.ping.len() - self.at);
        into[..count].copy_from_slice(&self.ping[self.at..self.at + count]);
        self.at += count;
        Ok(count)
    }
}
