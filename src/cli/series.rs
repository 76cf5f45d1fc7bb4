//! What commands that make many runs have in common: seeds that suffice, places that can be written to, threads.

use super::output::NewFile;
use super::{Failure, exit};
use std::path::Path;

/// Refuses a first seed without room for the others above it.
///
/// # Errors
/// Exit 2.
pub fn check_seeds(first: u64, runs: u64) -> Result<(), Failure> {
    if first.checked_add(runs - 1).is_some() {
        return Ok(());
    }
    let message = format!("--seed: found {first}, allowed: a seed with room for --runs above it");
    Err(Failure::new(exit::USAGE, message))
}

/// Refuses places that cannot be written to: better known before long work than after it.
///
/// # Errors
/// Exit 73, or 77 without permission.
pub fn check_places<'a>(paths: impl IntoIterator<Item = &'a Path>) -> Result<(), Failure> {
    paths.into_iter().try_for_each(|path| NewFile::create(path).map(drop))
}

/// Cores that this process may use.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}
