//! Stands for the messages of a file in a build without MCAP: there are none.

use super::RecordError;
use std::marker::PhantomData;
use std::path::Path;

pub(super) struct RawMessage<'a> {
    pub topic: &'a str,
    pub data: &'a [u8],
}

/// What was lost of a file that was cut off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cut {
    /// Bytes up to the end of the last whole chunk.
    pub whole_bytes: u64,
    /// Bytes after it.
    pub lost_bytes: u64,
    /// Messages that were read.
    pub messages: u64,
}

pub(super) struct MessageReader<R>(PhantomData<R>);

impl<R> MessageReader<R> {
    pub fn open(_path: &Path, _source: R, _length: u64) -> Result<Self, RecordError> {
        Err(RecordError::Unsupported)
    }

    pub fn config_toml(&self) -> Option<&str> {
        None
    }

    pub fn cut(&self) -> Option<Cut> {
        None
    }

    pub fn skip_to(&mut self, _wanted: impl Fn(&str) -> bool) -> Result<bool, RecordError> {
        Ok(false)
    }

    pub fn current(&self) -> RawMessage<'_> {
        RawMessage { topic: "", data: &[] }
    }
}
