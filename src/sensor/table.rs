//! Tables of numbers in CSV files: arrays and emissions.
//!
//! Goes in: text. Comes out: rows of finite numbers with their lines. Errors name the line, what was found and what is
//! allowed; the key is left empty for the caller to put its own in front.

use crate::document;
use crate::parameter::ParameterError;
use std::path::Path;

/// Largest table that is read: a long grid or emission with all digits.
const SIZE_MAX_BYTES: u64 = 4 << 20;

/// One row of numbers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    /// 1-based line in the file.
    pub(super) line: u64,
    /// The numbers, all finite.
    pub(super) values: Vec<f64>,
}

impl Row {
    /// An error about a value of this row.
    pub(super) fn refuse(&self, found: impl std::fmt::Display, allowed: impl Into<String>) -> ParameterError {
        ParameterError::new("", format!("line {}: {found}", self.line), allowed)
    }
}

/// The text of a table's file.
pub(super) fn read(path: &Path) -> Result<String, ParameterError> {
    document::read_at_most(path, SIZE_MAX_BYTES)
        .map_err(|error| ParameterError::new("", unread(path, &error), "a CSV file"))
}

/// What was found instead of a table.
fn unread(path: &Path, error: &document::DocumentError) -> String {
    let what = error.summary.strip_prefix("found ").unwrap_or(&error.summary);
    format!("{}: {what}", path.display())
}

/// Puts a file's name in front of what was found in it.
pub(super) fn in_file(path: &Path, error: ParameterError) -> ParameterError {
    ParameterError { found: format!("{} {}", path.display(), error.found), ..error }
}

/// All rows of `text` that are not a comment (`#`); the first may be a header, which is `Some(fields)`.
pub(super) fn rows(text: &str, has_header: bool) -> Result<(Option<Vec<String>>, Vec<Row>), ParameterError> {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(text.as_bytes());
    let (mut header, mut rows) = (None, Vec::new());
    for record in reader.records() {
        let record = record.map_err(|error| ParameterError::new("", error, "comma-separated numbers"))?;
        if has_header && header.is_none() {
            header = Some(record.iter().map(str::to_owned).collect());
            continue;
        }
        let line = record.position().map_or(0, csv::Position::line);
        let values = record.iter().map(|field| match field.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(ParameterError::new("", format!("line {line}: {field:?}"), "a finite number")),
        });
        rows.push(Row { line, values: values.collect::<Result<_, _>>()? });
    }
    Ok((header, rows))
}
