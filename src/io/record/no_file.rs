//! Stands for the file in a build without MCAP: it cannot be made.

use super::RecordError;
use std::path::Path;

/// A file that never is.
pub(super) enum OutFile {}

impl OutFile {
    pub fn create(_path: &Path, _config_toml: &str, _wall_ns: u64) -> Result<Self, RecordError> {
        Err(RecordError::Unsupported)
    }

    pub fn write(
        &mut self,
        _topic: &str,
        _schema: impl FnOnce() -> (String, String),
        _sequence: u64,
        _times_ns: [u64; 2],
        _bytes: &[u8],
    ) -> Result<(), RecordError> {
        match *self {}
    }

    pub fn flush(&mut self) -> Result<(), RecordError> {
        match *self {}
    }

    pub fn finish(&mut self) -> Result<(), RecordError> {
        match *self {}
    }

    pub fn written(&self) -> u64 {
        match *self {}
    }
}
