//! Energyscapes as `process` writes them: a folder, `energyscape.npy` beside its axes, or one `.npz`.

use super::no_ping;
use crate::cli::process::data_failure;
use crate::cli::{Failure, exit};
use crate::io::picture::{Picture, render_energyscape};
use crate::io::plot::rectangular;
use crate::io::recording_file::{RecordingFile, read_axis};
use crate::signal::{Direction, Energyscape, PolarGrid, Samples};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where the arrays are.
pub struct Results {
    /// The archive, or the file of energyscapes.
    path: PathBuf,
    archive: bool,
}

impl Results {
    /// The results that an input names; none where it is a raw recording.
    ///
    /// # Errors
    /// Exit 65 for a folder without results.
    pub fn find(input: &Path) -> Result<Option<Self>, Failure> {
        let of = |path: PathBuf, archive| Ok(Some(Self { path, archive }));
        if input.is_dir() {
            for (name, archive) in [("energyscape.npy", false), ("energyscape.npz", true)] {
                if input.join(name).is_file() {
                    return of(input.join(name), archive);
                }
            }
            let message = format!(
                "{}: found a folder without results, allowed: one that `noctule process` wrote (energyscape.npy or .npz), or a \
                 file",
                input.display()
            );
            return Err(Failure::new(exit::DATA, message));
        }
        let ends = |ending: &str| input.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending));
        if ends("npz") && RecordingFile::open_array(input, "energyscape").is_ok() {
            return of(input.to_owned(), true);
        }
        let named = input.file_name().is_some_and(|name| name == "energyscape.npy");
        if named { of(input.to_owned(), false) } else { Ok(None) }
    }

    /// Draws a ping in polar and in rectangular form.
    ///
    /// # Errors
    /// Exit 2, 65, 74, 77.
    pub fn draw(&self, ping: u64) -> Result<Vec<(&'static str, Picture)>, Failure> {
        let data = |error| data_failure(&error);
        let mut file = match self.archive {
            true => RecordingFile::open_array(&self.path, "energyscape"),
            false => RecordingFile::open(&self.path, 0),
        }
        .map_err(data)?;
        let axis = |name: &str| {
            let path = if self.archive { self.path.clone() } else { self.path.with_file_name(format!("{name}.npy")) };
            read_axis(&path, name).map_err(data)
        };
        let (directions, ranges_m) = (axis("directions_deg")?, axis("ranges_m")?);
        let shape = file.shape();
        let grid = self.grid(&directions, &ranges_m)?;
        if shape.channel_count != Some(grid.direction_count()) || shape.sample_count != grid.range_count() {
            return Err(self.bad(&format!(
                "{} directions by {} ranges, allowed: {} by {}, as the axes beside it say",
                shape.channel_count.unwrap_or(1),
                shape.sample_count,
                grid.direction_count(),
                grid.range_count()
            )));
        }
        if ping >= shape.ping_count as u64 {
            return Err(no_ping(&self.path, ping, shape.ping_count as u64));
        }
        let mut samples = Samples::zeros(shape.format, 0);
        for _ in 0..=ping {
            file.read_ping(&mut samples).map_err(data)?;
        }
        let Samples::PcmF32(values) = samples else { return Err(self.bad("no f32, allowed: energyscapes of f32")) };
        let energyscape = Energyscape { values, ..Energyscape::zeros(Arc::new(grid), 0) };
        let title = format!("{}, ping {ping}", self.path.display());
        let peak = energyscape.peak();
        let (direction, range) = energyscape.grid.direction_and_range(peak.0);
        let loudest = format!(
            "loudest {:.4} at {:.2} m, {:.1} degrees",
            peak.1,
            energyscape.grid.range_m(range),
            energyscape.grid.directions()[direction].azimuth_rad.to_degrees()
        );
        Ok(vec![
            ("energyscape_polar", render_energyscape(&energyscape)),
            ("energyscape_rectangular", rectangular([&title, &loudest], &energyscape)),
        ])
    }

    fn bad(&self, found: &str) -> Failure {
        Failure::new(exit::DATA, format!("{}: found {found}", self.path.display()))
    }

    fn grid(&self, directions_deg: &(Vec<f64>, usize), ranges_m: &(Vec<f64>, usize)) -> Result<PolarGrid, Failure> {
        let finite = directions_deg.0.iter().chain(&ranges_m.0).all(|value| value.is_finite());
        let (values, columns) = directions_deg;
        let ranges = &ranges_m.0;
        if !finite || values.is_empty() || ranges.len() < 2 || !(1..=2).contains(columns) || ranges[1] <= ranges[0] {
            return Err(
                self.bad("axes of no use, allowed: directions_deg [D] or [D, 2], and at least two rising ranges_m [R]")
            );
        }
        let directions = values.chunks_exact(*columns).map(|row| Direction {
            azimuth_rad: row[0].to_radians(),
            elevation_rad: row.get(1).copied().unwrap_or(0.0).to_radians(),
        });
        let step_m = (ranges[ranges.len() - 1] - ranges[0]) / (ranges.len() - 1) as f64;
        Ok(PolarGrid::new(directions.collect(), ranges[0], step_m, ranges.len()))
    }
}
