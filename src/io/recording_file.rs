//! Raw recordings in files: NumPy `.npy`, eRTIS `.bin` and recorded runs `.mcap`, read ping by ping, so that memory does not grow with the file.
//!
//! In: a path and what the configuration says of the data. Out: [`Samples`] of one ping at a time. A file that ends
//! in the middle of a ping gives its complete pings and then one error. Never interprets samples.

use super::record::RecordError;
use super::record::pings::RunPings;
use crate::signal::{SampleFormat, Samples};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// A `.npy` header longer than this is not one of ours; the format itself would allow 4 GiB.
const NPY_HEADER_BYTES_MAX: u64 = 64 * 1024;
/// A single ping above this is a damaged header, not a ping.
const PING_BYTES_MAX: u64 = 1 << 30;

/// Why a recording cannot be read, naming the file.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be opened or read.
    #[error("{}: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// The file does not hold what it should.
    #[error("{}: found {found}, allowed: {allowed}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What was found.
        found: String,
        /// What is allowed.
        allowed: String,
    },
    /// The file ends in the middle of a ping.
    #[error("{}: found {found_bytes} bytes after ping {complete_pings}, a ping has {ping_bytes}: the file is truncated", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Pings read before the end.
        complete_pings: usize,
        /// Bytes left over.
        found_bytes: u64,
        /// Bytes of a ping.
        ping_bytes: u64,
    },
}

/// What a file says of its pings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordingShape {
    /// Format of the samples.
    pub format: SampleFormat,
    /// Channels, PCM only.
    pub channel_count: Option<usize>,
    /// PDM words or PCM samples of one channel in a ping.
    pub sample_count: usize,
    /// Pings that the file claims to hold.
    pub ping_count: usize,
}

/// An open recording: a file, or whatever else gives its bytes.
pub struct RecordingFile<R = Box<dyn Read + Send>> {
    path: PathBuf,
    reader: R,
    shape: RecordingShape,
    pings_read: usize,
    bytes: Vec<u8>,
}

impl RecordingFile {
    /// Opens a recording. `words_per_ping` is the configuration's, used for `.bin`, which has no header of its own.
    ///
    /// # Errors
    /// [`RecordingError`] when the file cannot be read, its name ends in none of `.npy`, `.bin` and `.mcap`, or it holds no ping.
    pub fn open(path: &Path, words_per_ping: usize) -> Result<Self, RecordingError> {
        Self::open_sensor(path, words_per_ping, 0)
    }

    /// As [`RecordingFile::open`]; of a recorded run, which holds all sensors, the pings of this one.
    ///
    /// # Errors
    /// As [`RecordingFile::open`].
    pub fn open_sensor(path: &Path, words_per_ping: usize, sensor_index: usize) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::Io { path: path.to_owned(), error };
        // Asked before opening: to open a pipe would wait for its other end.
        let metadata = std::fs::metadata(path).map_err(io)?;
        if !metadata.is_file() {
            return Err(content(path, "no regular file", "a .npy, .bin or .mcap file"));
        }
        let file = File::open(path).map_err(io)?;
        if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("mcap")) {
            return Self::open_run(path, sensor_index);
        }
        let reader: Box<dyn Read + Send> = Box::new(BufReader::with_capacity(1 << 16, file));
        Self::from_reader(path, reader, metadata.len(), words_per_ping)
    }

    fn open_run(path: &Path, sensor_index: usize) -> Result<Self, RecordingError> {
        let (pings, shape) = RunPings::open(path, sensor_index).map_err(|error| match error {
            RecordError::Content { path, found, allowed } => RecordingError::Content { path, found, allowed },
            other => RecordingError::Io { path: path.to_owned(), error: std::io::Error::other(other) },
        })?;
        let channel_count = (shape.format != SampleFormat::Pdm).then_some(shape.channel_count);
        let bytes = vec![0; shape.bytes];
        let (format, sample_count, ping_count) = (shape.format, shape.sample_count, shape.count);
        let shape = RecordingShape { format, channel_count, sample_count, ping_count };
        Ok(Self { path: path.to_owned(), reader: Box::new(pings), shape, pings_read: 0, bytes })
    }
}

impl<R: Read> RecordingFile<R> {
    /// As [`RecordingFile::open`], for the `length` bytes that `reader` gives; of `path` only the name is looked at.
    ///
    /// # Errors
    /// As [`RecordingFile::open`].
    pub fn from_reader(path: &Path, mut reader: R, length: u64, words_per_ping: usize) -> Result<Self, RecordingError> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
        let shape = match extension.as_deref() {
            Some("npy") => npy_shape(path, &mut reader)?,
            Some("bin") => bin_shape(path, length, words_per_ping)?,
            Some("mcap") => {
                return Err(content(path, "an MCAP recording", "a .npy or .bin file"));
            }
            _ => return Err(content(path, "another kind of file", "a name that ends in .npy, .bin or .mcap")),
        };
        let ping_bytes = ping_bytes(&shape);
        if ping_bytes == 0 || ping_bytes > PING_BYTES_MAX {
            return Err(content(path, format!("pings of {ping_bytes} bytes"), format!("1 to {PING_BYTES_MAX} bytes")));
        }
        // Never more memory than the file has bytes: a header may claim anything.
        let bytes = vec![0; ping_bytes.min(length) as usize];
        Ok(Self { path: path.to_owned(), reader, shape, pings_read: 0, bytes })
    }

    /// What the file says of its pings.
    #[must_use]
    pub fn shape(&self) -> RecordingShape {
        self.shape
    }

    /// The file's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads the next ping into `samples`, whose buffer is used again. `false` at the end of the file.
    ///
    /// # Errors
    /// [`RecordingError::Truncated`] when the file ends in the middle of a ping, [`RecordingError::Io`] otherwise.
    pub fn read_ping(&mut self, samples: &mut Samples) -> Result<bool, RecordingError> {
        if self.pings_read == self.shape.ping_count {
            return Ok(false);
        }
        let wanted = ping_bytes(&self.shape) as usize;
        let mut filled = 0;
        while filled < self.bytes.len() {
            match self.reader.read(&mut self.bytes[filled..]) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(RecordingError::Io { path: self.path.clone(), error }),
            }
        }
        if filled < wanted {
            return Err(RecordingError::Truncated {
                path: self.path.clone(),
                complete_pings: self.pings_read,
                found_bytes: filled as u64,
                ping_bytes: wanted as u64,
            });
        }
        decode(&self.bytes, self.shape.format, samples);
        self.pings_read += 1;
        Ok(true)
    }
}

/// Decodes little-endian bytes into the buffer of `samples`; makes a new one only when the format differs.
fn decode(bytes: &[u8], format: SampleFormat, samples: &mut Samples) {
    if samples.format() != format {
        *samples = Samples::zeros(format, 0);
    }
    match samples {
        Samples::Pdm(words) => {
            words.clear();
            words.extend(bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])));
        }
        Samples::PcmI16(values) => {
            values.clear();
            values.extend(bytes.chunks_exact(2).map(|b| i16::from_le_bytes([b[0], b[1]])));
        }
        Samples::PcmF32(values) => {
            values.clear();
            values.extend(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])));
        }
    }
}

fn content(path: &Path, found: impl Into<String>, allowed: impl Into<String>) -> RecordingError {
    RecordingError::Content { path: path.to_owned(), found: found.into(), allowed: allowed.into() }
}

fn ping_bytes(shape: &RecordingShape) -> u64 {
    let value_bytes = if shape.format == SampleFormat::PcmI16 { 2 } else { 4 };
    (shape.sample_count as u64).saturating_mul(shape.channel_count.unwrap_or(1) as u64).saturating_mul(value_bytes)
}

/// A `.bin` is PDM words and nothing else; a last ping that is incomplete counts, so that it is reported when reached.
fn bin_shape(path: &Path, file_bytes: u64, words_per_ping: usize) -> Result<RecordingShape, RecordingError> {
    if file_bytes == 0 {
        return Err(content(path, "an empty file", format!("pings of {words_per_ping} words of 4 bytes")));
    }
    let ping_count = file_bytes.div_ceil((words_per_ping as u64).saturating_mul(4).max(1)) as usize;
    Ok(RecordingShape { format: SampleFormat::Pdm, channel_count: None, sample_count: words_per_ping, ping_count })
}

fn npy_shape(path: &Path, reader: &mut impl Read) -> Result<RecordingShape, RecordingError> {
    let io = |error| RecordingError::Io { path: path.to_owned(), error };
    let header = read_npy_header(path, reader)?;
    if header.order() != npyz::Order::C {
        return Err(content(path, "an array in Fortran order", "C order (numpy.ascontiguousarray)"));
    }
    let npyz::DType::Plain(kind) = header.dtype() else {
        return Err(content(path, "a structured array", "dtype <u4 (PDM words), <i2 or <f4 (PCM)"));
    };
    let format = match kind.to_string().as_str() {
        "<u4" => SampleFormat::Pdm,
        "<i2" => SampleFormat::PcmI16,
        "<f4" => SampleFormat::PcmF32,
        other => return Err(content(path, format!("dtype {other}"), "dtype <u4 (PDM words), <i2 or <f4 (PCM)")),
    };
    let lengths = header.shape().iter().map(|&length| usize::try_from(length)).collect::<Result<Vec<_>, _>>();
    let lengths = lengths.map_err(|error| io(std::io::Error::other(error)))?;
    let (ping_count, channel_count, sample_count) = match (format, lengths.as_slice()) {
        (SampleFormat::Pdm, &[words]) => (1, None, words),
        (SampleFormat::Pdm, &[pings, words]) => (pings, None, words),
        (SampleFormat::PcmI16 | SampleFormat::PcmF32, &[channels, samples]) => (1, Some(channels), samples),
        (SampleFormat::PcmI16 | SampleFormat::PcmF32, &[pings, channels, samples]) => (pings, Some(channels), samples),
        (SampleFormat::Pdm, other) => {
            return Err(content(path, format!("shape {other:?}"), "[pings, words] or [words] for PDM words"));
        }
        (_, other) => {
            return Err(content(path, format!("shape {other:?}"), "[pings, mics, samples] or [mics, samples] for PCM"));
        }
    };
    if ping_count == 0 {
        return Err(content(path, "no ping", "at least one ping"));
    }
    Ok(RecordingShape { format, channel_count, sample_count, ping_count })
}

/// Reads the header, having judged its length first: the library allocates what the length field says.
fn read_npy_header(path: &Path, reader: &mut impl Read) -> Result<npyz::NpyHeader, RecordingError> {
    let io = |error| RecordingError::Io { path: path.to_owned(), error };
    let mut start = Vec::with_capacity(12);
    reader.by_ref().take(12).read_to_end(&mut start).map_err(io)?;
    let length = match start.as_slice() {
        [0x93, b'N', b'U', b'M', b'P', b'Y', 1, _, low, high, ..] => u64::from(u16::from_le_bytes([*low, *high])),
        [0x93, b'N', b'U', b'M', b'P', b'Y', 2 | 3, _, a, b, c, d] => u64::from(u32::from_le_bytes([*a, *b, *c, *d])),
        _ => return Err(content(path, "no NumPy header", "a .npy file of version 1, 2 or 3")),
    };
    if length > NPY_HEADER_BYTES_MAX {
        return Err(content(path, format!("a header of {length} bytes"), format!("at most {NPY_HEADER_BYTES_MAX}")));
    }
    npyz::NpyHeader::from_reader(start.as_slice().chain(reader))
        .map_err(|error| content(path, format!("a damaged header ({error})"), "a .npy header as NumPy writes it"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use npyz::WriterBuilder as _;
    use std::io::Write as _;

    fn npy<T: npyz::AutoSerialize + Copy>(shape: &[u64], values: &[T]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut writer =
            npyz::WriteOptions::new().default_dtype().shape(shape).writer(&mut bytes).begin_nd().expect("header");
        writer.extend(values.iter().copied()).expect("values");
        writer.finish().expect("end");
        bytes
    }

    fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join(name);
        File::create(&path).and_then(|mut file| file.write_all(bytes)).expect("file");
        (folder, path)
    }

    #[test]
    fn pcm_comes_back_ping_by_ping() {
        let values: Vec<i16> = (0..24).collect();
        let (_folder, path) = file("a.npy", &npy(&[2, 3, 4], &values));
        let mut recording = RecordingFile::open(&path, 0).expect("opens");
        assert_eq!(recording.shape().channel_count, Some(3));
        let mut samples = Samples::zeros(SampleFormat::PcmI16, 0);
        assert!(recording.read_ping(&mut samples).expect("first"));
        assert_eq!(samples, Samples::PcmI16((0..12).collect()));
        assert!(recording.read_ping(&mut samples).expect("second"));
        assert_eq!(samples, Samples::PcmI16((12..24).collect()));
        assert!(!recording.read_ping(&mut samples).expect("end"));
    }

    #[test]
    fn a_truncated_bin_gives_its_complete_pings_then_one_error() {
        let bytes: Vec<u8> = (0..10_u32).flat_map(u32::to_le_bytes).collect();
        let (_folder, path) = file("a.bin", &bytes[..38]);
        let mut recording = RecordingFile::open(&path, 4).expect("opens");
        let mut samples = Samples::zeros(SampleFormat::Pdm, 0);
        assert!(recording.read_ping(&mut samples).expect("first"));
        assert!(recording.read_ping(&mut samples).expect("second"));
        assert_eq!(samples, Samples::Pdm(vec![4, 5, 6, 7]));
        let error = recording.read_ping(&mut samples).expect_err("third is cut");
        assert!(matches!(error, RecordingError::Truncated { complete_pings: 2, found_bytes: 6, ping_bytes: 16, .. }));
    }

    #[test]
    fn a_header_that_claims_gigabytes_is_refused_without_allocating_them() {
        let mut bytes = b"\x93NUMPY\x02\x00".to_vec();
        bytes.extend(u32::MAX.to_le_bytes());
        bytes.extend([b' '; 64]);
        let (_folder, path) = file("bomb.npy", &bytes);
        let error = RecordingFile::open(&path, 4).err().expect("refused").to_string();
        assert!(error.contains("header of 4294967295 bytes"), "{error}");
    }

    #[test]
    fn other_types_shapes_and_names_are_refused_with_what_is_allowed() {
        for (name, bytes, expected) in [
            ("a.npy", npy(&[2, 2], &[1.0_f64, 2.0, 3.0, 4.0]), "dtype <f8"),
            ("b.npy", npy(&[4], &[1.0_f32, 2.0, 3.0, 4.0]), "shape [4]"),
            ("c.npy", npy(&[1, 1, 1], &[1_u32]), "shape [1, 1, 1]"),
            ("d.npy", b"garbage".to_vec(), "no NumPy header"),
            ("e.wav", vec![0; 8], "another kind of file"),
            ("f.bin", Vec::new(), "an empty file"),
        ] {
            let (_folder, path) = file(name, &bytes);
            let error = RecordingFile::open(&path, 4).err().expect("refused").to_string();
            assert!(error.contains(expected) && error.contains("allowed"), "{name}: {error}");
        }
    }
}
