//! Multichannel WAV: a channel a microphone, pings one after the other.
//!
//! In: the bytes of a `.wav` file. Out: [`Samples`] of one ping at a time, channel by channel. 16-bit integers stay what they
//! are; 24- and 32-bit integers become `f32` of full scale 1, whose 24 bits hold the former exactly; `f32` is taken bit for bit.

use super::{FileHints, RecordingError, RecordingShape, content};
use crate::signal::{SampleFormat, Samples};
use hound::{SampleFormat as Kind, WavReader, WavSpec};
use std::io::Read;
use std::path::{Path, PathBuf};

/// An open WAV file.
pub(super) struct Wave<R> {
    reader: WavReader<R>,
    spec: WavSpec,
    /// Samples of one ping as the file has them: microphone by microphone at each time.
    integers: Vec<i16>,
    reals: Vec<f32>,
}

impl<R: Read> Wave<R> {
    /// Reads the header.
    pub(super) fn open(path: &Path, reader: R, hints: &FileHints) -> Result<(Self, RecordingShape), RecordingError> {
        let reader = WavReader::new(reader).map_err(|error| failure(path, error))?;
        let spec = reader.spec();
        let format = match (spec.sample_format, spec.bits_per_sample) {
            (Kind::Int, 16) => SampleFormat::PcmI16,
            (Kind::Int, 24 | 32) | (Kind::Float, 32) => SampleFormat::PcmF32,
            (kind, bits) => {
                let kind = if kind == Kind::Int { "integers" } else { "floating-point numbers" };
                return Err(content(
                    path,
                    format!("{kind} of {bits} bits"),
                    "integers of 16, 24 or 32 bits, or 32-bit floats",
                ));
            }
        };
        let channels = usize::from(spec.channels);
        let values = reader.len() as usize;
        if channels == 0 || values == 0 || !values.is_multiple_of(channels) {
            return Err(content(
                path,
                format!("{values} values in {channels} channels"),
                "a channel a microphone, as long as each other",
            ));
        }
        let rate_hz = f64::from(spec.sample_rate);
        if let Some(allowed_hz) = hints.sample_rate_hz.filter(|allowed_hz| *allowed_hz != rate_hz) {
            let allowed = format!("{allowed_hz} Hz, as the configuration says (recording.sample_rate_hz)");
            return Err(content(path, format!("a sample rate of {rate_hz} Hz"), allowed));
        }
        let frames = values / channels;
        let (sample_count, ping_count) = cut(frames, hints);
        let shape = RecordingShape { format, channel_count: Some(channels), sample_count, ping_count };
        Ok((Self { reader, spec, integers: Vec::new(), reals: Vec::new() }, shape))
    }

    /// Reads `wanted` values and sorts them by channel into `samples`; gives how many there were.
    pub(super) fn read(&mut self, path: &Path, wanted: usize, samples: &mut Samples) -> Result<usize, RecordingError> {
        let channels = usize::from(self.spec.channels);
        let fail = |error| failure(path, error);
        if let (Kind::Int, 16) = (self.spec.sample_format, self.spec.bits_per_sample) {
            fill(&mut self.integers, self.reader.samples::<i16>().take(wanted)).map_err(fail)?;
            if self.integers.len() == wanted {
                *samples =
                    by_channel(&self.integers, channels, std::mem::replace(samples, Samples::PcmI16(Vec::new())));
            }
            return Ok(self.integers.len());
        }
        let scale = 1.0 / 2_f64.powi(i32::from(self.spec.bits_per_sample) - 1);
        match self.spec.sample_format {
            Kind::Float => fill(&mut self.reals, self.reader.samples::<f32>().take(wanted)).map_err(fail)?,
            Kind::Int => {
                let integers = self.reader.samples::<i32>().take(wanted);
                fill(&mut self.reals, integers.map(|value| value.map(|value| (f64::from(value) * scale) as f32)))
                    .map_err(fail)?;
            }
        }
        if self.reals.len() == wanted {
            *samples = by_channel(&self.reals, channels, std::mem::replace(samples, Samples::PcmF32(Vec::new())));
        }
        Ok(self.reals.len())
    }
}

/// Samples of a ping and number of pings: those of the configuration, or where it is silent the sensor's own where the file is
/// a whole number of them; else the file is one ping.
fn cut(frames: usize, hints: &FileHints) -> (usize, usize) {
    match hints.samples_per_ping {
        Some(samples) => (samples, frames.div_ceil(samples.max(1))),
        None if frames.is_multiple_of(super::SAMPLES_DEFAULT) => {
            (super::SAMPLES_DEFAULT, frames / super::SAMPLES_DEFAULT)
        }
        None => (frames, 1),
    }
}

/// Fills `values` until the end of what there is; an end in the middle is no error here.
fn fill<T>(values: &mut Vec<T>, from: impl Iterator<Item = hound::Result<T>>) -> hound::Result<()> {
    values.clear();
    for value in from {
        match value {
            Ok(value) => values.push(value),
            Err(hound::Error::IoError(error)) if error.kind() == std::io::ErrorKind::UnexpectedEof => break,
            // The library says so of a file that ends early.
            Err(hound::Error::IoError(error)) if error.to_string().contains("enough bytes") => break,
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// A value of PCM.
trait Value: Copy {
    /// The buffer of `samples` for values of this type.
    fn buffer(samples: Samples) -> Vec<Self>;
    /// The buffer as samples.
    fn samples(buffer: Vec<Self>) -> Samples;
}

impl Value for i16 {
    fn buffer(samples: Samples) -> Vec<Self> {
        if let Samples::PcmI16(buffer) = samples { buffer } else { Vec::new() }
    }

    fn samples(buffer: Vec<Self>) -> Samples {
        Samples::PcmI16(buffer)
    }
}

impl Value for f32 {
    fn buffer(samples: Samples) -> Vec<Self> {
        if let Samples::PcmF32(buffer) = samples { buffer } else { Vec::new() }
    }

    fn samples(buffer: Vec<Self>) -> Samples {
        Samples::PcmF32(buffer)
    }
}

/// `[time][channel]` to `[channel][time]`, in the buffer that `old` had.
fn by_channel<T: Value>(values: &[T], channels: usize, old: Samples) -> Samples {
    let mut buffer = T::buffer(old);
    buffer.clear();
    for channel in 0..channels {
        buffer.extend(values.iter().skip(channel).step_by(channels));
    }
    T::samples(buffer)
}

fn failure(path: &Path, error: hound::Error) -> RecordingError {
    let allowed = "a WAV file of PCM";
    match error {
        hound::Error::IoError(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            content(path, "a file that ends early", allowed)
        }
        hound::Error::IoError(error) if error.kind() == std::io::ErrorKind::Other => {
            content(path, format!("a damaged file ({error})"), allowed)
        }
        hound::Error::IoError(error) => RecordingError::Io { path: PathBuf::from(path), error },
        error => content(path, format!("a damaged file ({error})"), allowed),
    }
}
