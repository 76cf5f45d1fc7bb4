//! TOML documents with errors that point: file, line, caret, what was found, what is allowed, the nearest valid key.
//!
//! Used by the configuration and by world files. Knows nothing of what the documents mean.

use crate::parameter::ParameterError;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// A document that cannot be used. `Display` is the whole message for the user, several lines long.
#[derive(Debug, thiserror::Error)]
#[error("{rendered}")]
pub struct DocumentError {
    /// The file, as the user named it.
    pub path: PathBuf,
    /// 1-based line, if one can be named.
    pub line: Option<usize>,
    /// Dotted key, if one can be named.
    pub key: Option<String>,
    /// The message with source line and caret.
    pub rendered: String,
}

/// Parses `text` (the content of `path`), then lets `validate` judge it.
///
/// # Errors
/// [`DocumentError`] for bad syntax, an unknown key, a value of the wrong type, or what `validate` refuses.
pub fn parse<T: DeserializeOwned>(
    path: &Path,
    text: &str,
    validate: impl FnOnce(&T) -> Result<(), ParameterError>,
) -> Result<T, DocumentError> {
    let fail = |rendered: String| DocumentError { path: path.to_owned(), line: None, key: None, rendered };
    let value: T = toml::from_str(text).map_err(|error| fail(format!("{}: {error}", path.display())))?;
    validate(&value).map_err(|error| fail(format!("{}: {error}", path.display())))?;
    Ok(value)
}
