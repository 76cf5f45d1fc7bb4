//! The files of one recording: which is open, when the next part begins, which old ones go, and how much room is left.
//!
//! A part ends by size or age. With a budget the oldest parts of this recording are removed, as in a flight recorder; files of
//! others, earlier recordings among them, are never touched. Where less than the reserve is free, recording ends.

use super::file::OutFile;
use super::{RecordError, RecordOptions};
use crate::io::free_bytes_of;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Parts that a budget is shared among where no size of a part is given.
const PARTS_OF_BUDGET: u64 = 8;
/// Tries to find a name that is not taken.
const NAMES_MAX: u32 = 10_000;

/// The recording's files.
pub(super) struct Volume {
    options: RecordOptions,
    config_toml: String,
    file: OutFile,
    opened_at: Instant,
    part: u32,
    /// Closed parts and their bytes, oldest first.
    closed: VecDeque<(PathBuf, u64)>,
    closed_bytes: u64,
    path: PathBuf,
}

/// The path of a part; part 0 is the path itself.
pub(super) fn part_path(path: &Path, part: u32) -> PathBuf {
    if part == 0 { path.to_owned() } else { with_suffix(path, &format!("_{part:03}")) }
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().map(|ending| format!(".{}", ending.to_string_lossy())).unwrap_or_default();
    path.with_file_name(format!("{stem}{suffix}{ending}"))
}

impl Volume {
    pub fn create(options: &RecordOptions, config_toml: String, wall_ns: u64) -> Result<Self, RecordError> {
        let mut options = options.clone();
        if let Some(budget) = options.budget_bytes {
            let part = (budget / PARTS_OF_BUDGET).max(1);
            options.split_bytes = Some(options.split_bytes.unwrap_or(part).min(part.max(budget / 2)));
        }
        check_room(&options.path, options.reserve_bytes)?;
        let taken = |path: &PathBuf| std::fs::symlink_metadata(path).is_ok();
        let names = (2..NAMES_MAX).map(|number| with_suffix(&options.path, &format!("-{number}")));
        let path = std::iter::once(options.path.clone()).chain(names).find(|path| !taken(path));
        options.path = path.unwrap_or(options.path);
        let file = OutFile::create(&options.path, &config_toml, wall_ns)?;
        log::info!("recording to {}", options.path.display());
        let path = options.path.clone();
        Ok(Self {
            options,
            config_toml,
            file,
            opened_at: Instant::now(),
            part: 0,
            closed: VecDeque::new(),
            closed_bytes: 0,
            path,
        })
    }

    /// The open part.
    pub fn file(&mut self) -> &mut OutFile {
        &mut self.file
    }

    /// Bytes of all parts, those that were removed included.
    pub fn written(&self) -> u64 {
        self.closed_bytes + self.file.written()
    }

    /// Closes the chunk; looks at the disk.
    ///
    /// # Errors
    /// [`RecordError::Full`] where the reserve is reached.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.file.flush()?;
        check_room(&self.path, self.options.reserve_bytes)
    }

    /// Begins the next part if it is time; true when a new one is open.
    pub fn split(&mut self, wall_ns: u64) -> Result<bool, RecordError> {
        let full = self.options.split_bytes.is_some_and(|limit| self.file.written() >= limit);
        let old = self.options.split_after.is_some_and(|limit| self.opened_at.elapsed() >= limit);
        if !full && !old {
            return Ok(false);
        }
        self.file.finish()?;
        let bytes = self.file.written();
        self.closed_bytes += bytes;
        self.closed.push_back((self.path.clone(), bytes));
        self.part += 1;
        self.path = part_path(&self.options.path, self.part);
        self.file = OutFile::create(&self.path, &self.config_toml, wall_ns)?;
        self.opened_at = Instant::now();
        self.keep_budget();
        Ok(true)
    }

    /// Removes the oldest parts until those that are left, with room for the open one, are within the budget.
    fn keep_budget(&mut self) {
        let Some(budget) = self.options.budget_bytes else { return };
        let open = self.options.split_bytes.unwrap_or(0);
        let mut kept: u64 = self.closed.iter().map(|(_, bytes)| bytes).sum();
        while kept + open > budget {
            let Some((path, bytes)) = self.closed.pop_front() else { return };
            match std::fs::remove_file(&path) {
                Ok(()) => log::info!("{} removed: the recording's budget is reached", path.display()),
                Err(error) => log::warn!("{} cannot be removed: {error}", path.display()),
            }
            kept -= bytes;
        }
    }

    pub fn finish(&mut self) -> Result<(), RecordError> {
        self.file.finish()
    }
}

/// Refuses where less than the reserve is free.
fn check_room(path: &Path, reserve_bytes: u64) -> Result<(), RecordError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // A file system that does not say is asked by writing.
    let Some(free) = free_bytes_of(folder) else { return Ok(()) };
    if free >= reserve_bytes {
        return Ok(());
    }
    Err(RecordError::Full { path: path.to_owned(), free_mib: free >> 20, reserve_mib: reserve_bytes >> 20 })
}
