//! The messages of one MCAP file, in their order, from any reader of bytes.
//!
//! A chunk is checked before anything of it is given. A file that was cut off gives its whole chunks and then says how much was
//! lost; one that is damaged elsewhere is an error. Never takes more memory than the file's size can justify.

use super::file::CONFIG_NAME;
use super::{Cut, RawMessage, RecordError};
use mcap::McapError;
use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// No compression here makes more than this of a byte; what claims to is damaged.
const EXPANSION_MAX: u64 = 255;
/// Largest chunk or message.
const RECORD_BYTES_MAX: u64 = 1 << 30;
/// Most bytes asked for at a time: a length in a damaged file must not become memory.
const STEP_BYTES: usize = 1 << 16;

pub(super) struct MessageReader<R> {
    path: PathBuf,
    source: R,
    reader: LinearReader,
    length: u64,
    fed_bytes: u64,
    whole_bytes: u64,
    message_count: u64,
    topics: BTreeMap<u16, String>,
    topic: u16,
    data: Vec<u8>,
    pending: bool,
    config_toml: Option<String>,
    cut: Option<Cut>,
    over: bool,
}

impl<R: Read> MessageReader<R> {
    /// Reads up to the first message, so that the attachment is known.
    pub fn open(path: &Path, source: R, length: u64) -> Result<Self, RecordError> {
        let limit = length.saturating_mul(EXPANSION_MAX).min(RECORD_BYTES_MAX);
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(usize::try_from(limit).unwrap_or(usize::MAX));
        let mut reader = Self {
            path: path.to_owned(),
            source,
            reader: LinearReader::new_with_options(options),
            length,
            fed_bytes: 0,
            whole_bytes: 0,
            message_count: 0,
            topics: BTreeMap::new(),
            topic: 0,
            data: Vec::new(),
            pending: false,
            config_toml: None,
            cut: None,
            over: false,
        };
        reader.pending = reader.advance()?;
        Ok(reader)
    }

    pub fn config_toml(&self) -> Option<&str> {
        self.config_toml.as_deref()
    }

    pub fn cut(&self) -> Option<Cut> {
        self.cut
    }

    /// Goes on to the next message whose topic is `wanted`; false at the end, be it that of the file or of what is whole of it.
    pub fn skip_to(&mut self, wanted: impl Fn(&str) -> bool) -> Result<bool, RecordError> {
        while std::mem::take(&mut self.pending) || self.advance()? {
            if self.topics.get(&self.topic).is_some_and(|topic| wanted(topic)) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The message that [`Self::skip_to`] found last.
    pub fn current(&self) -> RawMessage<'_> {
        let topic = self.topics.get(&self.topic).map_or("", String::as_str);
        RawMessage { topic, data: &self.data }
    }

    /// Goes on to the next message; false at the end.
    fn advance(&mut self) -> Result<bool, RecordError> {
        while !self.over {
            let wanted = match self.reader.next_event() {
                None => break,
                Some(Ok(LinearReadEvent::ReadRequest(count))) => count.clamp(1, STEP_BYTES),
                Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                    self.whole_bytes = self.fed_bytes;
                    // Parsed here, and only what is needed: the library believes lengths inside a record before it looks whether they
                    // are there.
                    let mut fields = Fields(data);
                    match opcode {
                        op::CHANNEL => {
                            if let Some((id, topic)) = fields.channel() {
                                self.topics.insert(id, topic);
                            }
                        }
                        op::ATTACHMENT => {
                            if let Some(text) = fields.attachment(CONFIG_NAME) {
                                self.config_toml = Some(text);
                            }
                        }
                        op::MESSAGE => {
                            if let Some((topic, data)) = fields.message() {
                                self.message_count += 1;
                                self.topic = topic;
                                self.data.clear();
                                self.data.extend_from_slice(data);
                                return Ok(true);
                            }
                        }
                        _ => {}
                    }
                    continue;
                }
                Some(Err(error)) => return self.end_early(&error),
            };
            let read = self.source.read(self.reader.insert(wanted));
            let read = read.map_err(|error| RecordError::Io { path: self.path.clone(), reason: error.to_string() })?;
            self.fed_bytes += read as u64;
            self.reader.notify_read(read);
        }
        self.over = true;
        Ok(false)
    }

    fn end_early(&mut self, error: &McapError) -> Result<bool, RecordError> {
        self.over = true;
        // The magic alone is no recording.
        if !matches!(error, McapError::UnexpectedEof) || self.whole_bytes == 0 {
            return Err(damaged(&self.path, error, self.whole_bytes));
        }
        let lost_bytes = self.length.saturating_sub(self.whole_bytes);
        let cut = Cut { whole_bytes: self.whole_bytes, lost_bytes, messages: self.message_count };
        log::warn!(
            "{}: was not finished: {} messages in {} bytes are whole, the last {} bytes are lost",
            self.path.display(),
            cut.messages,
            cut.whole_bytes,
            cut.lost_bytes
        );
        self.cut = Some(cut);
        Ok(false)
    }
}

/// The bytes of a record, taken from the front.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (front, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(front)
    }

    fn number<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.first_chunk().copied()
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = u32::from_le_bytes(self.number()?);
        std::str::from_utf8(self.take(usize::try_from(length).ok()?)?).ok()
    }

    /// Identifier and topic.
    fn channel(&mut self) -> Option<(u16, String)> {
        let id = u16::from_le_bytes(self.number()?);
        let _schema: [u8; 2] = self.number()?;
        Some((id, self.text()?.to_owned()))
    }

    /// Identifier of the channel, and data.
    fn message(&mut self) -> Option<(u16, &'a [u8])> {
        let id = u16::from_le_bytes(self.number()?);
        let _sequence_and_times: [u8; 20] = self.number()?;
        Some((id, self.0))
    }

    /// The attachment, if it has that name and is text.
    fn attachment(&mut self, wanted: &str) -> Option<String> {
        let _times: [u8; 16] = self.number()?;
        let (name, _media_type) = (self.text()?, self.text()?);
        let length = u64::from_le_bytes(self.number()?);
        let text = std::str::from_utf8(self.take(usize::try_from(length).ok()?)?).ok()?;
        (name == wanted).then(|| text.to_owned())
    }
}

fn damaged(path: &Path, error: &McapError, whole_bytes: u64) -> RecordError {
    RecordError::Content {
        path: path.to_owned(),
        found: format!("after {whole_bytes} bytes: {error}"),
        allowed: "an MCAP file".to_owned(),
    }
}
