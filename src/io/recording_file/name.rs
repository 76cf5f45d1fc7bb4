//! What a file is, by its name: whether it is a recording, and of which kind.
//!
//! Opens nothing.

use std::path::Path;

/// How names of recordings end.
const ENDINGS: [&str; 5] = ["npy", "npz", "wav", "bin", "mcap"];

/// Whether a file is a recording, by its name.
#[must_use]
pub fn is_recording(path: &Path) -> bool {
    ending(path).is_some_and(|ending| ENDINGS.contains(&ending.as_str()))
}

/// Whether a file is a recorded run, by its name.
#[must_use]
pub fn is_mcap(path: &Path) -> bool {
    ending(path).as_deref() == Some("mcap")
}

/// Ending of a file's name, in small letters.
pub(super) fn ending(path: &Path) -> Option<String> {
    path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase())
}
