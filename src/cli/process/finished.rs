//! How `process` knows a recording that it has finished before, and passes over it.
//!
//! The last thing written for a recording is its `meta.json`, complete or not at all. It holds a [`Fingerprint`] of what the
//! results were made from: while that is the same and the arrays stand beside it, there is nothing to do.

use super::super::args::ExportFormat;
use crate::config::Config;
use crate::signal::Direction;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::Path;
use std::time::UNIX_EPOCH;

/// Everything that the results follow from: the recording, as its size and time of change, and the settings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprint {
    input_bytes: u64,
    input_modified_ns: u64,
    settings: String,
}

impl Fingerprint {
    /// The fingerprint of a recording as it is now.
    ///
    /// # Errors
    /// When the file is not there or cannot be looked at.
    pub fn of(input: &Path, settings: &str) -> std::io::Result<Self> {
        let metadata = std::fs::metadata(input)?;
        // A file system without times, or a file from before 1970: the size must do.
        let modified = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        Ok(Self {
            input_bytes: metadata.len(),
            input_modified_ns: modified.map_or(0, |time| time.as_nanos() as u64),
            settings: settings.to_owned(),
        })
    }

    /// Whether `folder` holds the finished results for this fingerprint.
    #[must_use]
    pub fn is_finished_in(&self, folder: &Path) -> bool {
        let Ok(file) = std::fs::File::open(folder.join("meta.json")) else { return false };
        let Ok(meta) = serde_json::from_reader::<_, Meta>(std::io::BufReader::new(file)) else { return false };
        let size = |name: &str| std::fs::metadata(folder.join(name)).map_or(0, |metadata| metadata.len());
        let of_npy = ["directions_deg.npy", "ranges_m.npy"].iter().all(|name| size(name) > 0)
            && meta.energyscape_bytes == size("energyscape.npy");
        let arrays = of_npy || meta.energyscape_bytes == size("energyscape.npz");
        let pictures = (0..meta.pictures).all(|index| size(&picture_name(index)) > 0);
        meta.complete && meta.fingerprint == *self && arrays && pictures
    }
}

/// What of `meta.json` is looked at; the rest, a line a ping, is passed over as it is read.
#[derive(Deserialize)]
struct Meta {
    complete: bool,
    fingerprint: Fingerprint,
    energyscape_bytes: u64,
    pictures: u64,
}

/// Name of the picture of a ping.
#[must_use]
pub fn picture_name(ping_index: u64) -> String {
    format!("energyscape_{ping_index:05}.png")
}

/// A checksum over everything but the recording that the results depend on: version, backend asked for, pictures, kind of files, and the
/// parts of the configuration that imaging knows, with the content of the files that it names.
///
/// # Errors
/// What is wrong with the configuration's files.
pub fn settings(
    config: &Config,
    sensor_index: usize,
    backend: &str,
    (png, format): (bool, ExportFormat),
) -> Result<String, crate::parameter::ParameterError> {
    let sensors = config.sensor_setups()?;
    let directions: Vec<Direction> = config.directions()?;
    let zones = config.dead_zones(&sensors, &directions);
    let hidden = &zones[sensor_index].hidden;
    let imaging = &config.imaging;
    let mut sum = Checksum::default();
    // A checksum takes anything; formatting into it cannot fail.
    let _ = write!(
        sum,
        "{} {backend} {png} {format:?} {:?} {:?} {} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {directions:?} {hidden:?}",
        env!("CARGO_PKG_VERSION"),
        config.recording,
        config.emission,
        config.speed_of_sound_m_s(),
        imaging.range_min_m,
        imaging.range_max_m,
        imaging.range_step_m,
        imaging.weighting,
        imaging.smoothing_hz,
        imaging.focus_to_m,
        imaging.beamformer,
        imaging.multiply_order,
        imaging.coherence,
        imaging.apodization,
        imaging.clean_rounds,
        sensors[sensor_index],
    );
    Ok(format!("{:08x}-{}", sum.hasher.finalize(), sum.len))
}

/// CRC32 and length of a text that is never held as a whole.
#[derive(Default)]
struct Checksum {
    hasher: crc32fast::Hasher,
    len: u64,
}

impl Write for Checksum {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        self.hasher.update(text.as_bytes());
        self.len += text.len() as u64;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_settings_change_with_whatever_the_image_depends_on_and_with_nothing_else() {
        let of = |change: fn(&mut Config)| {
            let mut config = Config::default();
            change(&mut config);
            settings(&config, 0, "auto", (false, ExportFormat::Npy)).expect("the built-in configuration")
        };
        let plain = of(|_| {});
        assert_eq!(plain, of(|config| config.control.rate_hz = 5.0), "the controller does not image");
        assert_eq!(plain, of(|config| config.ipc.prefix = "other_".to_owned()));
        let changes: [fn(&mut Config); 6] = [
            |config| config.speed_of_sound_given_m_s = Some(343.1),
            |config| config.imaging.range_max_m = 4.0,
            |config| config.imaging.directions.count = 179,
            |config| config.emission.end_hz = 26_000.0,
            |config| config.sensor[0].disabled_mics = vec![3],
            |config| config.recording.samples = Some(81_920),
        ];
        for change in changes {
            assert_ne!(plain, of(change));
        }
        let other =
            |backend, png| settings(&Config::default(), 0, backend, (png, ExportFormat::Npy)).expect("built in");
        assert_ne!(plain, other("cpu", false));
        assert_ne!(plain, other("auto", true));
    }
}
