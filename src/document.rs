//! TOML documents with errors that point: file, line, caret, what was found, what is allowed, the nearest valid key.
//!
//! Goes in: a path, or a path and its text, a type and a function that judges its values. Comes out: the value, or a
//! [`DocumentError`] that is the whole message for the user. Used by the configuration and by world files; knows nothing
//! of what the documents mean, and never panics whatever the bytes are.

mod explain;
mod place;
#[cfg(test)]
mod tests;

use crate::parameter::ParameterError;
use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};
use place::{Place, Tree};
use serde::de::DeserializeOwned;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Largest document that is read: twenty times a long configuration. Of a list as long as this every entry is parsed,
/// which takes 120 bytes of memory a byte of text, so a process stays below 64 MiB.
pub const SIZE_MAX_BYTES: u64 = 1 << 18;

/// What kind of thing is wrong with a document.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DocumentErrorKind {
    /// There is no such file.
    Missing,
    /// There is something of that name which cannot be read: a directory, no permission, a failing disk.
    Unreadable,
    /// The file was read and its content cannot be used.
    Content,
}

/// A document that cannot be used. `Display` is the whole message for the user, several lines long.
#[derive(Debug, thiserror::Error)]
#[error("{rendered}")]
pub struct DocumentError {
    /// What kind of thing is wrong.
    pub kind: DocumentErrorKind,
    /// The file, as the user named it.
    pub path: PathBuf,
    /// 1-based line, if one can be named.
    pub line: Option<usize>,
    /// Dotted key, if one can be named.
    pub key: Option<String>,
    /// The message in one line, without file and line: for logs.
    pub summary: String,
    /// The message with source line and caret.
    pub rendered: String,
}

impl DocumentError {
    /// An error about a file as a whole.
    #[must_use]
    pub fn of_file(kind: DocumentErrorKind, path: &Path, summary: impl Into<String>) -> Self {
        let summary = summary.into();
        let rendered = format!("error: {}: {summary}", path.display());
        Self { kind, path: path.to_owned(), line: None, key: None, summary, rendered }
    }
}

/// Reads and parses the file at `path`, then lets `validate` judge it.
///
/// # Errors
/// As [`read`] and [`parse`].
pub fn load<T: DeserializeOwned>(
    path: &Path,
    validate: impl FnOnce(&T) -> Result<(), ParameterError>,
) -> Result<T, DocumentError> {
    parse(path, &read(path)?, validate)
}

/// Reads the text of the file at `path`.
///
/// # Errors
/// [`DocumentError`] when there is no such file, when it is no regular file, may not be read, is larger than
/// [`SIZE_MAX_BYTES`], or is not UTF-8.
pub fn read(path: &Path) -> Result<String, DocumentError> {
    read_at_most(path, SIZE_MAX_BYTES)
}

/// As [`read`], for a file of at most `size_max_bytes` that is no document, such as a table of numbers.
///
/// # Errors
/// As [`read`].
pub fn read_at_most(path: &Path, size_max_bytes: u64) -> Result<String, DocumentError> {
    use DocumentErrorKind::{Content, Missing, Unreadable};
    let refuse = |kind, summary: String| Err(DocumentError::of_file(kind, path, summary));
    let unreadable = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::NotFound => DocumentError::of_file(Missing, path, "found no such file"),
        std::io::ErrorKind::PermissionDenied => {
            DocumentError::of_file(Unreadable, path, "found a file that may not be read (permission denied)")
        }
        _ => DocumentError::of_file(Unreadable, path, format!("cannot be read: {error}")),
    };
    // Asked before opening: to open a pipe would wait for its other end.
    let metadata = std::fs::metadata(path).map_err(unreadable)?;
    if metadata.is_dir() {
        return refuse(Unreadable, "found a directory, allowed: a file".to_owned());
    }
    if !metadata.is_file() {
        return refuse(Unreadable, "found a device, pipe or socket, allowed: a regular file".to_owned());
    }
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(unreadable)?;
    file.take(size_max_bytes + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > size_max_bytes {
        let size = metadata.len().max(bytes.len() as u64);
        return refuse(Content, format!("found {size} bytes, allowed: at most {size_max_bytes} bytes"));
    }
    String::from_utf8(bytes).map_err(|error| {
        let (good, bytes) = (error.utf8_error().valid_up_to(), error.as_bytes());
        let line = 1 + bytes[..good].iter().filter(|byte| **byte == b'\n').count();
        let found = bytes.get(good).copied().unwrap_or_default();
        let summary = format!("line {line}: found the byte 0x{found:02x}, which is no UTF-8, allowed: UTF-8 text");
        DocumentError { line: Some(line), ..DocumentError::of_file(Content, path, summary) }
    })
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
    let deserializer = match toml::de::Deserializer::parse(text) {
        Ok(deserializer) => deserializer,
        Err(error) => {
            let told = explain::syntax(&error, text);
            return Err(render(path, text, &told.place, &told.summary, &told.help));
        }
    };
    let value = T::deserialize(deserializer).map_err(|error| {
        let tree = Tree::parse(text);
        let told = explain::refusal(&error, text, &tree);
        render(path, text, &told.place, &told.summary, &told.help)
    })?;
    validate(&value).map_err(|error| refuse(path, text, &error))?;
    Ok(value)
}

/// The error for a value of the document `text` that somebody refused after it was parsed.
#[must_use]
pub fn refuse(path: &Path, text: &str, error: &ParameterError) -> DocumentError {
    let place = Tree::parse(text).of_key(&error.key);
    // The key as the validator names it, even where the file leaves it out and the place is that of its table.
    let place = Place { key: Some(error.key.clone()), ..place };
    render(path, text, &place, &format!("found {}, allowed: {}", error.found, error.allowed), &[])
}

fn render(path: &Path, text: &str, place: &Place, statement: &str, help: &[String]) -> DocumentError {
    let summary = match &place.key {
        Some(key) if !key.is_empty() => format!("{key}: {statement}"),
        _ => statement.to_owned(),
    };
    let path_text = path.display().to_string();
    let mut group = annotate_snippets::Group::with_title(Level::ERROR.primary_title(clean(&summary)));
    let span = place.span.as_ref().map(|span| on_one_line(text, span));
    let line = span.as_ref().map(|(line, _, _)| *line);
    if let Some((line, source, within)) = span {
        let annotation = AnnotationKind::Primary.span(within);
        group = group.element(Snippet::source(source).line_start(line).path(&path_text).annotation(annotation));
    } else {
        group = group.element(annotate_snippets::Origin::path(&path_text));
    }
    let group = group.elements(help.iter().map(|text| Level::HELP.message(clean(text))));
    let rendered = Renderer::plain().render(&[group]);
    DocumentError {
        kind: DocumentErrorKind::Content,
        path: path.to_owned(),
        line,
        key: place.key.clone(),
        summary,
        rendered,
    }
}

/// Text from a file, fit for a terminal: no control characters, no line breaks.
fn clean(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect()
}

/// The line in which a span begins: its 1-based number, its text, and the part of the span that lies on it.
fn on_one_line<'t>(text: &'t str, span: &Range<usize>) -> (usize, &'t str, Range<usize>) {
    let mut start = span.start.min(text.len());
    while !text.is_char_boundary(start) {
        start -= 1;
    }
    let line_start = text[..start].rfind('\n').map_or(0, |newline| newline + 1);
    let line_end = text[start..].find('\n').map_or(text.len(), |newline| start + newline);
    let source = text[line_start..line_end].trim_end_matches('\r');
    let mut end = span.end.clamp(start, line_end);
    while !text.is_char_boundary(end) {
        end += 1;
    }
    let number = 1 + text[..line_start].bytes().filter(|byte| *byte == b'\n').count();
    let within = (start - line_start).min(source.len())..(end - line_start).min(source.len());
    (number, source, within)
}
