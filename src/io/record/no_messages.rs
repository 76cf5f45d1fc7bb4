//! Stands for the messages of a file in a build without MCAP: there are none.

use super::{Cut, RawMessage, RecordError};
use std::marker::PhantomData;
use std::path::Path;

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
