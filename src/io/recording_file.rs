//! Raw recordings in files: NumPy `.npy` and `.npz`, multichannel `.wav`, eRTIS `.bin` and recorded runs `.mcap`, read ping by
//! ping, so that memory does not grow with the file.
//!
//! In: a path and what the configuration says of the data. Out: [`Samples`] of one ping at a time. A file that ends
//! in the middle of a ping gives its complete pings and then one error. Never interprets samples.

mod name;
mod npz;
mod wav;

use name::ending;
pub use name::{is_mcap, is_recording};

use super::record::RecordError;
use super::record::pings::RunPings;
use crate::signal::{SampleFormat, Samples};
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

/// A `.npy` header longer than this is not one of ours; the format itself would allow 4 GiB.
const NPY_HEADER_BYTES_MAX: u64 = 64 * 1024;
/// A single ping above this is a damaged header, not a ping.
const PING_BYTES_MAX: u64 = 1 << 30;

/// Longest axis of an energyscape.
const AXIS_LEN_MAX: u64 = 1 << 24;
/// Samples of a ping of PCM where nobody says otherwise: the eRTIS's.
const SAMPLES_DEFAULT: usize = 16_384;
/// What is read.
const KINDS: &str = "a .npy, .npz, .wav, .bin or .mcap file";

/// What the configuration knows of a recording that has no header of its own, or one that says too little.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FileHints {
    /// PDM words in a ping, for `.bin`.
    pub words_per_ping: usize,
    /// PCM samples of one microphone in a ping, for `.wav`, where the configuration says so.
    pub samples_per_ping: Option<usize>,
    /// Rate that a file that tells its own must have.
    pub sample_rate_hz: Option<f64>,
}

impl From<usize> for FileHints {
    /// Of PDM words alone.
    fn from(words_per_ping: usize) -> Self {
        Self { words_per_ping, ..Self::default() }
    }
}

/// Why a recording cannot be read, naming the file.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be opened or read.
    #[error("{}: {}", path.display(), plain(error))]
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

/// What the system said, in the words of every other error.
fn plain(error: &std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::NotFound => format!("found no such file, allowed: {KINDS}"),
        std::io::ErrorKind::PermissionDenied => "found a file that may not be read (permission denied)".to_owned(),
        _ => format!("cannot be read: {error}"),
    }
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
    content: Content<R>,
    shape: RecordingShape,
    pings_read: usize,
    bytes: Vec<u8>,
}

/// How the values lie in the file.
enum Content<R> {
    /// Ping by ping, as they are wanted.
    Plain(R),
    Wave(Box<wav::Wave<R>>),
}

impl RecordingFile {
    /// Opens a recording. `hints` are the configuration's; a number is that of the PDM words in a ping, used for `.bin`, which
    /// has no header of its own.
    ///
    /// # Errors
    /// [`RecordingError`] when the file cannot be read, its name ends in none of the kinds that are read, or it holds no ping.
    pub fn open(path: &Path, hints: impl Into<FileHints>) -> Result<Self, RecordingError> {
        Self::open_sensor(path, hints, 0)
    }

    /// As [`RecordingFile::open`]; of a recorded run, which holds all sensors, the pings of this one.
    ///
    /// # Errors
    /// As [`RecordingFile::open`].
    pub fn open_sensor(path: &Path, hints: impl Into<FileHints>, sensor_index: usize) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::Io { path: path.to_owned(), error };
        // Asked before opening: to open a pipe would wait for its other end.
        let metadata = std::fs::metadata(path).map_err(io)?;
        if metadata.is_dir() {
            return Err(content(path, "a folder", KINDS));
        }
        if !metadata.is_file() {
            return Err(content(path, "no regular file", KINDS));
        }
        let file = File::open(path).map_err(io)?;
        if is_mcap(path) {
            return Self::open_run(path, sensor_index);
        }
        let buffered = BufReader::with_capacity(1 << 16, file);
        if ending(path).as_deref() == Some("npz") {
            let array = BufReader::with_capacity(1 << 16, npz::open(path, buffered, None)?);
            return Self::from_npy(path, Box::new(array));
        }
        Self::from_reader(path, Box::new(buffered), metadata.len(), hints)
    }

    fn open_run(path: &Path, sensor_index: usize) -> Result<Self, RecordingError> {
        let (pings, shape) = RunPings::open(path, sensor_index).map_err(|error| match error {
            RecordError::Content { path, found, allowed } => RecordingError::Content { path, found, allowed },
            other => RecordingError::Io { path: path.to_owned(), error: std::io::Error::other(other) },
        })?;
        let channel_count = (shape.format != SampleFormat::Pdm).then_some(shape.channel_count);
        let (format, sample_count, ping_count) = (shape.format, shape.sample_count, shape.count);
        let shape = RecordingShape { format, channel_count, sample_count, ping_count };
        Self::new(path, Content::Plain(Box::new(pings)), shape)
    }

    /// Opens the array of that name in an archive (`.npz`), whose layout must be that of a recording.
    ///
    /// # Errors
    /// As [`RecordingFile::open`].
    pub fn open_array(path: &Path, name: &str) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(|error| RecordingError::Io { path: path.to_owned(), error })?;
        Self::from_npy(path, Box::new(BufReader::new(npz::open(path, BufReader::new(file), Some(name))?)))
    }
}

impl<'a> RecordingFile<Box<dyn Read + 'a>> {
    /// As [`RecordingFile::open`], for the bytes of an archive (`.npz`) that `source` gives.
    ///
    /// # Errors
    /// As [`RecordingFile::open`].
    pub fn from_archive(path: &Path, source: impl Read + Seek + 'a) -> Result<Self, RecordingError> {
        Self::from_npy(path, Box::new(npz::open(path, source, None)?))
    }
}

impl<R: Read> RecordingFile<R> {
    /// As [`RecordingFile::open`], for the `length` bytes that `reader` gives; of `path` only the name is looked at.
    ///
    /// # Errors
    /// As [`RecordingFile::open`].
    pub fn from_reader(
        path: &Path,
        reader: R,
        length: u64,
        hints: impl Into<FileHints>,
    ) -> Result<Self, RecordingError> {
        let hints = hints.into();
        let (content, shape) = match ending(path).as_deref() {
            Some("npy") => return Self::from_npy(path, reader),
            Some("bin") => (Content::Plain(reader), bin_shape(path, length, hints.words_per_ping)?),
            Some("wav") => {
                let (wave, shape) = wav::Wave::open(path, reader, &hints)?;
                (Content::Wave(Box::new(wave)), shape)
            }
            Some("mcap") => {
                return Err(content(path, "an MCAP recording", "a .npy, .wav or .bin file"));
            }
            _ => return Err(content(path, "another kind of file", KINDS)),
        };
        Self::new(path, content, shape)
    }

    fn from_npy(path: &Path, mut reader: R) -> Result<Self, RecordingError> {
        let shape = npy_shape(path, &mut reader)?;
        Self::new(path, Content::Plain(reader), shape)
    }

    fn new(path: &Path, values: Content<R>, shape: RecordingShape) -> Result<Self, RecordingError> {
        let ping_bytes = ping_bytes(&shape);
        if ping_bytes == 0 || ping_bytes > PING_BYTES_MAX {
            return Err(content(path, format!("pings of {ping_bytes} bytes"), format!("1 to {PING_BYTES_MAX} bytes")));
        }
        Ok(Self { path: path.to_owned(), content: values, shape, pings_read: 0, bytes: Vec::new() })
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
        let wanted = ping_bytes(&self.shape);
        let filled = match &mut self.content {
            Content::Plain(reader) => {
                self.bytes.clear();
                // Grows with what comes: a header may claim anything.
                let read = reader.by_ref().take(wanted).read_to_end(&mut self.bytes);
                read.map_err(|error| unreadable(&self.path, error))? as u64
            }
            Content::Wave(wave) => {
                let values = self.shape.sample_count * self.shape.channel_count.unwrap_or(1);
                let value_bytes = wanted / values.max(1) as u64;
                wave.read(&self.path, values, samples)? as u64 * value_bytes
            }
        };
        if filled < wanted {
            return Err(RecordingError::Truncated {
                path: self.path.clone(),
                complete_pings: self.pings_read,
                found_bytes: filled,
                ping_bytes: wanted,
            });
        }
        if matches!(self.content, Content::Plain(_)) {
            decode(&self.bytes, self.shape.format, samples);
        }
        self.pings_read += 1;
        Ok(true)
    }
}

/// Reads an axis, `f64` of one or two dimensions, from a `.npy` or from the array of that name in a `.npz`; gives its values and the
/// number of columns.
///
/// # Errors
/// As [`RecordingFile::open`].
pub fn read_axis(path: &Path, name: &str) -> Result<(Vec<f64>, usize), RecordingError> {
    let file = File::open(path).map_err(|error| RecordingError::Io { path: path.to_owned(), error })?;
    let file = BufReader::new(file);
    let mut reader: Box<dyn Read> = match ending(path).as_deref() {
        Some("npz") => Box::new(npz::open(path, file, Some(name))?),
        _ => Box::new(file),
    };
    let header = read_npy_header(path, &mut reader)?;
    let axis = || content(path, format!("{name} of another kind"), "f64 of one or two dimensions in C order");
    let plain = matches!(header.dtype(), npyz::DType::Plain(kind) if kind.to_string() == "<f8");
    let (rows, columns) = match *header.shape() {
        [rows] => (rows, 1),
        [rows, columns] => (rows, columns),
        _ => return Err(axis()),
    };
    let count = rows.checked_mul(columns).filter(|count| *count <= AXIS_LEN_MAX);
    let (true, npyz::Order::C, Some(count)) = (plain, header.order(), count) else { return Err(axis()) };
    let mut bytes = Vec::new();
    let read = reader.take(8 * count).read_to_end(&mut bytes);
    read.map_err(|error| unreadable(path, error))?;
    if bytes.len() as u64 != 8 * count {
        return Err(content(path, format!("{name} that ends early"), format!("{count} values")));
    }
    let values = bytes.as_chunks::<8>().0.iter().map(|eight| f64::from_le_bytes(*eight));
    Ok((values.collect(), columns as usize))
}

/// What a reader said: a damaged archive is bad data, everything else a failing disk.
fn unreadable(path: &Path, error: std::io::Error) -> RecordingError {
    use std::io::ErrorKind::{InvalidData, InvalidInput};
    match error.kind() {
        InvalidData | InvalidInput => content(path, format!("a damaged archive ({error})"), "an array that is whole"),
        _ => RecordingError::Io { path: path.to_owned(), error },
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
            ("e.wav", vec![0; 8], "damaged file"),
            ("g.mp3", vec![0; 8], "another kind of file"),
            ("h.npz", vec![0; 8], "damaged archive"),
            ("f.bin", Vec::new(), "an empty file"),
        ] {
            let (_folder, path) = file(name, &bytes);
            let error = RecordingFile::open(&path, 4).err().expect("refused").to_string();
            assert!(error.contains(expected) && error.contains("allowed"), "{name}: {error}");
        }
    }
}
