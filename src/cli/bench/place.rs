//! A private place for processes that are measured: a configuration of their own with an IPC root and prefix of their own.
//!
//! In: the user's configuration. Out: the same robot where nobody else's topics are. Everything is removed when it is dropped.

use super::super::run::prefer_pcm;
use super::super::{Failure, exit};
use crate::config::Config;
use crate::sensor::ERTIS_V3D1;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// A directory with configuration and IPC root.
pub struct Place {
    /// The configuration that the processes are given.
    pub config: Config,
    directory: PathBuf,
}

impl Place {
    /// Makes the directory and writes the configuration.
    ///
    /// # Errors
    /// Exit 73, 74 or 77.
    pub fn new(config: &Config) -> Result<Self, Failure> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let name = format!("nb{}x{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let directory = std::env::temp_dir().join(format!("noctule-bench-{name}"));
        std::fs::DirBuilder::new()
            .mode(0o700)
            .create(&directory)
            .map_err(|error| super::super::output::cannot_create(&directory, &error))?;
        let mut config = config.clone();
        prefer_pcm(&mut config);
        config.ipc.root = Some(directory.join("ipc"));
        config.ipc.prefix = format!("{name}_");
        let place = Self { config: with_absolute_paths(config), directory };
        std::fs::write(place.file(), place.config.to_toml())?;
        Ok(place)
    }

    /// The configuration file.
    #[must_use]
    pub fn file(&self) -> PathBuf {
        self.directory.join("robot.toml")
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        // The transport leaves a small management file for each prefix, and this prefix will not come again. What cannot be
        // removed stays, under a name that says whose it is.
        for entry in std::fs::read_dir("/dev/shm").into_iter().flatten().flatten() {
            if entry.file_name().to_string_lossy().starts_with(&self.config.ipc.prefix) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
        let _ = std::fs::remove_dir_all(&self.directory);
    }
}

/// The files that a configuration names, found from anywhere.
fn with_absolute_paths(mut config: Config) -> Config {
    let base = std::path::absolute(&config.base_dir).unwrap_or_else(|_| config.base_dir.clone());
    let absolute = |path: &Path| base.join(path);
    for sensor in config.sensor.iter_mut().filter(|sensor| sensor.array != ERTIS_V3D1) {
        sensor.array = absolute(Path::new(&sensor.array)).display().to_string();
    }
    config.imaging.directions.file = config.imaging.directions.file.as_deref().map(absolute);
    config.emission.file = config.emission.file.as_deref().map(absolute);
    config
}

/// The failure for a measurement that did not come about.
pub fn not_measured(message: &str) -> Failure {
    Failure::new(exit::UNAVAILABLE, message)
}
