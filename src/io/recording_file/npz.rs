//! NumPy archives: the one array of pings in a `.npz`, as a stream of the bytes of its `.npy`.
//!
//! In: a file that can be sought in. Out: a reader of the array's bytes, checked against the archive's checksum at its end. Stored
//! arrays (`numpy.savez`) and compressed ones (`numpy.savez_compressed`) are read without being held as a whole.

use super::{RecordingError, content};
use flate2::read::DeflateDecoder;
use std::io::{Read, Seek, SeekFrom, Take};
use std::path::Path;
use zip::{CompressionMethod, ZipArchive};

/// Names under which recordings are looked for, best first, when there are several arrays.
const NAMES: [&str; 7] = ["pings", "raw", "samples", "recording", "data", "signals", "arr_0"];
/// An archive of more arrays is none of recordings.
const ARRAYS_MAX: usize = 256;

enum Bytes<S: Read> {
    Stored(Take<S>),
    Deflated(Box<DeflateDecoder<Take<S>>>),
}

/// The bytes of one array.
pub(super) struct Entry<S: Read> {
    bytes: Bytes<S>,
    left: u64,
    hasher: crc32fast::Hasher,
    checksum: u32,
}

impl<S: Read> Read for Entry<S> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        // Not a byte more than the archive says: more is not covered by its checksum.
        let wanted = buffer.len().min(usize::try_from(self.left).unwrap_or(usize::MAX));
        if wanted == 0 {
            return Ok(0);
        }
        let count = match &mut self.bytes {
            Bytes::Stored(bytes) => bytes.read(&mut buffer[..wanted])?,
            Bytes::Deflated(bytes) => bytes.read(&mut buffer[..wanted])?,
        };
        self.hasher.update(&buffer[..count]);
        self.left -= count as u64;
        if self.left == 0 && self.hasher.clone().finalize() != self.checksum {
            let what = "the array's checksum is wrong: the archive is damaged";
            return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, what));
        }
        Ok(count)
    }
}

/// Finds the array of that name, or without one the array of pings.
pub(super) fn open<S: Read + Seek>(path: &Path, source: S, name: Option<&str>) -> Result<Entry<S>, RecordingError> {
    let damaged = |error: &dyn std::fmt::Display| {
        content(path, format!("a damaged archive ({error})"), "a .npz file as numpy.savez writes it")
    };
    let mut archive = ZipArchive::new(source).map_err(|error| damaged(&error))?;
    if archive.len() > ARRAYS_MAX {
        return Err(content(path, format!("{} arrays", archive.len()), format!("at most {ARRAYS_MAX}")));
    }
    let named = |index| archive.name_for_index(index).and_then(Result::ok).map(|name| name.into_owned());
    let names: Vec<(usize, String)> = (0..archive.len()).filter_map(|index| Some((index, named(index)?))).collect();
    let arrays: Vec<(usize, &str)> =
        names.iter().filter_map(|(index, name)| Some((*index, name.strip_suffix(".npy")?))).collect();
    let called = |wanted: &str| arrays.iter().find(|(_, name)| *name == wanted);
    let chosen = match (name, arrays.as_slice()) {
        (Some(name), _) => called(name),
        (None, [only]) => Some(only),
        (None, _) => NAMES.iter().find_map(|wanted| called(wanted)),
    };
    let Some((index, _)) = chosen else {
        let found: Vec<&str> = arrays.iter().map(|(_, name)| *name).take(12).collect();
        let found = if found.is_empty() { "no array".to_owned() } else { format!("arrays {}", found.join(", ")) };
        let allowed = match name {
            Some(name) => format!("an array {name}"),
            None => format!("one array, or one of these names: {}", NAMES.join(", ")),
        };
        return Err(content(path, found, allowed));
    };
    let entry = archive.by_index(*index).map_err(|error| damaged(&error))?;
    let (method, start) = (entry.compression(), entry.data_start());
    let (compressed, left, checksum) = (entry.compressed_size(), entry.size(), entry.crc32());
    drop(entry);
    let start = start.ok_or_else(|| damaged(&"an array without a place"))?;
    let mut source = archive.into_inner();
    source.seek(SeekFrom::Start(start)).map_err(|error| RecordingError::Io { path: path.to_owned(), error })?;
    let stream = source.take(compressed);
    let bytes = match method {
        CompressionMethod::Stored => Bytes::Stored(stream),
        CompressionMethod::Deflated => Bytes::Deflated(Box::new(DeflateDecoder::new(stream))),
        other => return Err(content(path, format!("compression {other}"), "numpy.savez or numpy.savez_compressed")),
    };
    Ok(Entry { bytes, left, hasher: crc32fast::Hasher::new(), checksum })
}
