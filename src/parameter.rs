//! What a module says of a parameter value it refuses.
//!
//! Modules own their parameters and check them (`validate`); [`crate::config`] composes them and turns a
//! [`ParameterError`] into a message with file, line and caret. This file knows neither files nor TOML.

use std::fmt;

/// A parameter value that is not allowed.
///
/// `key` is the dotted path relative to the module's own table, for example `collision_avoidance.threshold` or
/// `regions[1].radius_m`; whoever composes tables puts its own part in front with [`ParameterError::within`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}: found {found}, allowed: {allowed}")]
pub struct ParameterError {
    /// Dotted path of the key.
    pub key: String,
    /// The value found, as a person would write it.
    pub found: String,
    /// What is allowed, as a person would say it.
    pub allowed: String,
}

impl ParameterError {
    /// Makes an error for `key` with the value found and the values allowed.
    pub fn new(key: impl Into<String>, found: impl fmt::Display, allowed: impl Into<String>) -> Self {
        Self { key: key.into(), found: found.to_string(), allowed: allowed.into() }
    }

    /// Puts the name of the enclosing table in front of the key.
    #[must_use]
    pub fn within(mut self, table: &str) -> Self {
        self.key = if self.key.is_empty() { table.to_owned() } else { format!("{table}.{}", self.key) };
        self
    }
}

/// Accepts a finite value in `[min, max]`, both ends included. NaN is refused.
pub fn check_range(key: &str, value: f64, min: f64, max: f64) -> Result<(), ParameterError> {
    if value >= min && value <= max {
        Ok(())
    } else {
        Err(ParameterError::new(key, value, format!("a number from {min} to {max}")))
    }
}

/// Accepts a finite value greater than zero and at most `max`. NaN is refused.
pub fn check_positive(key: &str, value: f64, max: f64) -> Result<(), ParameterError> {
    if value > 0.0 && value <= max {
        Ok(())
    } else {
        Err(ParameterError::new(key, value, format!("a number above 0, at most {max}")))
    }
}

/// The allowed name most like `found`, if one is like it at all: "did you mean".
pub fn nearest<'a>(found: &str, allowed: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // Long rubbish is like nothing, and comparing it would take long.
    if found.chars().count() > 64 {
        return None;
    }
    let flat = |name: &str| name.to_lowercase().replace('-', "_");
    let found = flat(found);
    let likeness = |name: &&str| {
        let name = flat(name);
        let prefixed = name.starts_with(&found) && found.chars().count() >= 3;
        strsim::jaro_winkler(&found, &name).max(if prefixed { 0.9 } else { 0.0 })
    };
    let best = allowed.into_iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
    best.filter(|name| likeness(name) >= 0.75)
}

/// `; did you mean NAME?`, or nothing.
pub fn did_you_mean<'a>(found: &str, allowed: impl IntoIterator<Item = &'a str>) -> String {
    nearest(found, allowed).map_or(String::new(), |name| format!("; did you mean {name}?"))
}
