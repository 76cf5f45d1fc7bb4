//! What `process` is to do: the recordings that were named, where each one's results go, and which of them are this shard's.
//!
//! In: inputs as typed, files and folders. Out: [`Target`]s in the order of their names, the same on every machine that
//! sees the same files, in whatever order they were typed or listed. Never opens a recording.

use super::super::args::ProcessArguments;
use super::super::{Failure, exit};
use crate::io::recording_file::is_recording;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// One of `count` equal parts of the work, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: u32,
    count: u32,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refuse = || format!("found {text}, allowed: i/n with i from 1 to n, for example 1/4");
        let (index, count) = text.split_once('/').ok_or_else(refuse)?;
        // `parse` would take "+1" as well; a shard has one spelling.
        let number =
            |text: &str| text.bytes().all(|byte| byte.is_ascii_digit()).then(|| text.parse::<u32>().ok()).flatten();
        let (index, count) = number(index).zip(number(count)).ok_or_else(refuse)?;
        if (1..=count).contains(&index) { Ok(Self { index, count }) } else { Err(refuse()) }
    }
}

impl Shard {
    /// Every n-th target from the i-th on: parts differ by one target at most.
    fn keep(self, targets: Vec<Target>) -> Vec<Target> {
        targets.into_iter().skip(self.index as usize - 1).step_by(self.count as usize).collect()
    }
}

/// A recording and the folder that its results go to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Target {
    /// The recording.
    pub input: PathBuf,
    /// Where its results go.
    pub folder: PathBuf,
}

/// The recordings of this shard. One file writes into the output folder itself; several, or a folder of them, into a folder
/// each, named by their stems.
///
/// # Errors
/// Exit 2 when two recordings would write into the same folder, 65 for a folder without a recording, 74 or 77 for one that
/// cannot be read.
pub fn targets(arguments: &ProcessArguments) -> Result<Vec<Target>, Failure> {
    let out = &arguments.out;
    let mut targets = match arguments.inputs.as_slice() {
        [input] if !input.is_dir() => vec![Target { input: input.clone(), folder: out.clone() }],
        inputs => apart(inputs, out)?,
    };
    targets.sort_by(|a, b| a.folder.cmp(&b.folder));
    Ok(match arguments.shard {
        Some(shard) => shard.keep(targets),
        None => targets,
    })
}

fn apart(inputs: &[PathBuf], out: &Path) -> Result<Vec<Target>, Failure> {
    let mut files = Vec::new();
    for input in inputs {
        if input.is_dir() {
            files.extend(recordings_in(input)?);
        } else {
            files.push(input.clone());
        }
    }
    let mut taken: HashMap<PathBuf, PathBuf> = HashMap::new();
    let mut targets = Vec::new();
    for input in files {
        let stem =
            input.file_stem().ok_or_else(|| Failure::new(exit::USAGE, format!("{}: no file name", input.display())))?;
        let folder = out.join(stem);
        if let Some(other) = taken.insert(folder.clone(), input.clone()) {
            let message =
                format!("{} and {} would both write into {}", other.display(), input.display(), folder.display());
            return Err(Failure::new(exit::USAGE, message));
        }
        targets.push(Target { input, folder });
    }
    Ok(targets)
}

/// The recordings right in a folder; what is hidden, or in folders within, is left alone.
fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let failure = |error: std::io::Error| {
        let failure = Failure::from(error);
        Failure { message: format!("{}: {}", folder.display(), failure.message), ..failure }
    };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failure)? {
        let path = entry.map_err(failure)?.path();
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if is_recording(&path) && !hidden && !path.is_dir() {
            found.push(path);
        }
    }
    if found.is_empty() {
        let message = format!(
            "{}: found no recording, allowed: files that end in .npy, .npz, .wav, .bin or .mcap",
            folder.display()
        );
        return Err(Failure::new(exit::DATA, message));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_disjoint_complete_and_even() {
        let all: Vec<Target> = (0..23)
            .map(|index| Target { input: format!("{index:02}.npy").into(), folder: format!("{index:02}").into() })
            .collect();
        for count in [1, 2, 5, 23, 40] {
            let parts: Vec<Vec<Target>> = (1..=count).map(|index| Shard { index, count }.keep(all.clone())).collect();
            let lens = parts.iter().map(Vec::len);
            assert!(lens.clone().max().unwrap_or(0) - lens.min().unwrap_or(0) <= 1);
            let mut union: Vec<Target> = parts.into_iter().flatten().collect();
            union.sort_by(|a, b| a.folder.cmp(&b.folder));
            assert_eq!(union, all);
        }
    }

    #[test]
    fn a_shard_is_written_one_way_and_counted_from_one() {
        assert_eq!("2/3".parse(), Ok(Shard { index: 2, count: 3 }));
        for nonsense in ["", "1", "0/3", "4/3", "1/0", "0/0", "-1/3", "+1/3", "1/3/5", "a/b", "1 / 3", "1/99999999999"]
        {
            let error = nonsense.parse::<Shard>().expect_err(nonsense);
            assert!(error.contains("allowed: i/n"), "{error}");
        }
    }
}
