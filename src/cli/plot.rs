//! `noctule plot`: energyscapes that `process` wrote, and what the microphones of a raw recording heard, as pictures.
//!
//! In: a folder or file. Out: PNG files, whose paths are printed. What is heard is computed by the CPU backend's own first two
//! stages, so that the picture shows what the imaging works on.

mod heard;
mod results;

use super::args::PlotArguments;
use super::output::{make_folder, print_line, write_picture};
use super::{Failure, exit};
use crate::io::picture::Picture;
use std::path::{Path, PathBuf};

/// Draws every input.
///
/// # Errors
/// Exit 2 for a ping that there is not, 65 for files of no use, 73, 74, 77, 78.
pub fn plot(arguments: &PlotArguments) -> Result<(), Failure> {
    let mut drawn: Vec<(PathBuf, Picture)> = Vec::new();
    for input in &arguments.inputs {
        let pictures = match results::Results::find(input)? {
            Some(results) => results.draw(arguments.ping)?,
            None => {
                let config = super::record::config_of_recording(input, &arguments.choice)?;
                let sensor_index = super::process::find_sensor(&config, arguments.sensor.as_deref())?;
                heard::draw(&config, sensor_index, input, arguments.ping)?
            }
        };
        let stem = stem(input, arguments.inputs.len() > 1);
        for (name, picture) in pictures {
            drawn.push((arguments.out.join(format!("{stem}{name}_{:05}.png", arguments.ping)), picture));
        }
    }
    make_folder(&arguments.out)?;
    for (path, picture) in drawn {
        write_picture(&path, &picture)?;
        print_line(&path.display().to_string())?;
    }
    Ok(())
}

/// What tells the pictures of several inputs apart.
fn stem(input: &Path, several: bool) -> String {
    let name = input.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    name.filter(|_| several).map_or(String::new(), |name| format!("{name}_"))
}

/// The failure for a ping beyond the last.
fn no_ping(input: &Path, ping: u64, count: u64) -> Failure {
    let message = format!("{}: --ping: found {ping}, allowed: 0 to {}", input.display(), count.saturating_sub(1));
    Failure::new(exit::USAGE, message)
}
