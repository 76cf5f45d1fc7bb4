//! `--frames`: what the sensors of the first robot heard on its first drive, as polar pictures one below the other.
//!
//! Goes in: a proving ground. Comes out: a picture. The drive is repeated for it: it depends on world, layout and seed only, so what is
//! drawn is what was scored, and images need not be kept of drives that nobody wants to see.

use super::super::Failure;
use super::super::run::service_failure;
use super::Proving;
use crate::io::picture::Picture;
use crate::io::plot::frames;
use crate::service::trial::TrialOptions;
use crate::signal::Energyscape;

/// Simulated time between two rows.
const PAUSE_S: f64 = 10.0;
/// Most rows: a picture that a screen can still show.
const ROWS_MAX: usize = 12;

/// Draws the film.
///
/// # Errors
/// What ended the drive.
pub(super) fn film(proving: &Proving) -> Result<Picture, Failure> {
    let entrant = &proving.entrants[0];
    let options = TrialOptions {
        acoustics: proving.acoustics,
        seed: proving.arguments.seed,
        prefer: proving.prefer,
        losses: entrant.losses.clone(),
        slips: Vec::new(),
    };
    let sensors = &entrant.rig.setup().sensors;
    let mut kept: Vec<(String, Energyscape)> = Vec::new();
    let driven = entrant.rig.run(proving.world.clone(), &options, &mut |moment| {
        let rows = kept.len() / sensors.len();
        if moment.point.time_s >= PAUSE_S * rows as f64 {
            for (sensor, energyscape) in sensors.iter().zip(moment.energyscapes) {
                kept.push((format!("{} {:.0} s", sensor.name, moment.point.time_s), energyscape.clone()));
            }
        }
        rows < ROWS_MAX
    });
    driven.map_err(|error| service_failure(&error))?;
    kept.truncate(ROWS_MAX * sensors.len());
    let shown: Vec<(&str, &Energyscape)> = kept.iter().map(|(label, image)| (label.as_str(), image)).collect();
    Ok(frames(&shown, sensors.len()))
}
