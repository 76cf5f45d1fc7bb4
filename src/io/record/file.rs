//! One MCAP file: opened, its channels, its chunks, its end. The only file, with [`super::messages`], that names the library.
//!
//! Profile `ros2`. Chunks are made in memory and written whole, so that a process that is killed leaves whole chunks; they are
//! compressed with LZ4 at its fastest: raw pings are close to noise, and more effort costs the processor and gains nothing.

use super::RecordError;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, WriteOptions, Writer};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A chunk is closed when it holds so much.
const CHUNK_BYTES: u64 = 4 << 20;
/// Name of the attachment that holds the configuration.
pub(super) const CONFIG_NAME: &str = "noctule.toml";

/// Counts what goes to the disk.
struct Counted {
    file: BufWriter<File>,
    written: Arc<AtomicU64>,
}

impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.written.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Counted {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(to)
    }
}

/// An open file.
pub(super) struct OutFile {
    path: PathBuf,
    writer: Writer<Counted>,
    written: Arc<AtomicU64>,
    topics: BTreeMap<String, u16>,
}

impl OutFile {
    /// Makes a file that is not there yet.
    pub fn create(path: &Path, config_toml: &str, wall_ns: u64) -> Result<Self, RecordError> {
        let cannot = |source| RecordError::Create { path: path.to_owned(), source };
        let file = File::options().write(true).create_new(true).open(path).map_err(cannot)?;
        let written = Arc::new(AtomicU64::new(0));
        let counted = Counted { file: BufWriter::with_capacity(1 << 16, file), written: Arc::clone(&written) };
        let failed = |error: mcap::McapError| failure(path, &error);
        let mut writer = WriteOptions::new()
            .profile("ros2")
            .library(concat!("noctule ", env!("CARGO_PKG_VERSION")))
            .chunk_size(Some(CHUNK_BYTES))
            .compression(Some(Compression::Lz4))
            .disable_seeking(true)
            .create(counted)
            .map_err(failed)?;
        writer
            .attach(&Attachment {
                log_time: wall_ns,
                create_time: wall_ns,
                name: CONFIG_NAME.to_owned(),
                media_type: "application/toml".to_owned(),
                data: Cow::Borrowed(config_toml.as_bytes()),
            })
            .map_err(failed)?;
        let facts = [("version", env!("CARGO_PKG_VERSION"))];
        let metadata = facts.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        writer.write_metadata(&Metadata { name: "noctule".to_owned(), metadata }).map_err(failed)?;
        Ok(Self { path: path.to_owned(), writer, written, topics: BTreeMap::new() })
    }

    /// Writes a message; its topic is made on first use. `schema` gives type name and definition.
    pub fn write(
        &mut self,
        topic: &str,
        schema: impl FnOnce() -> (String, String),
        sequence: u64,
        times_ns: [u64; 2],
        bytes: &[u8],
    ) -> Result<(), RecordError> {
        let channel_id = match self.topics.get(topic) {
            Some(&channel_id) => channel_id,
            None => self.add_topic(topic, schema())?,
        };
        let header =
            MessageHeader { channel_id, sequence: sequence as u32, log_time: times_ns[0], publish_time: times_ns[1] };
        self.writer.write_to_known_channel(&header, bytes).map_err(|error| failure(&self.path, &error))
    }

    fn add_topic(&mut self, topic: &str, (name, definition): (String, String)) -> Result<u16, RecordError> {
        use crate::io::ros::{MESSAGE_ENCODING, SCHEMA_ENCODING};
        let failed = |error: mcap::McapError| failure(&self.path, &error);
        let schema = self.writer.add_schema(&name, SCHEMA_ENCODING, definition.as_bytes()).map_err(failed)?;
        let channel_id = self.writer.add_channel(schema, topic, MESSAGE_ENCODING, &BTreeMap::new()).map_err(failed)?;
        self.topics.insert(topic.to_owned(), channel_id);
        Ok(channel_id)
    }

    /// Closes the chunk and gives everything to the system.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.writer.flush().map_err(|error| failure(&self.path, &error))
    }

    /// Writes index and end.
    pub fn finish(&mut self) -> Result<(), RecordError> {
        self.writer.finish().map_err(|error| failure(&self.path, &error))?;
        Ok(())
    }

    /// Bytes that went to the file; those of the open chunk are not among them.
    pub fn written(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }
}

fn failure(path: &Path, error: &mcap::McapError) -> RecordError {
    RecordError::Io { path: path.to_owned(), reason: error.to_string() }
}
