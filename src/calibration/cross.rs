//! Sensors that hear each other: a longer way, known from the mounts, tells more of the air than the short one to a sensor's own
//! microphones.
//!
//! In: two sensors as they stand on the robot. Out: the listener as a sensor whose emitter is the other's, for [`super::Observer`] and
//! [`super::measure()`] as ever, and what came of it. Sensors that look away from each other hear nothing, and then nothing comes of it.
//! Needs sensors that emit together; measures nothing itself.

use super::file::CrossCalibration;
use super::measure::{Tolerances, measure};
use super::observe::Observer;
use crate::sensor::SensorSetup;
use nalgebra::Vector3;
use std::sync::Arc;

/// Correlation coefficient from which another's emission counts as heard: the listener's own direct path lies over it, and side
/// lobes of that reach 0.05.
pub const HEARD_MIN: f64 = 0.1;
/// Share of the microphones that must hear it, and the largest rms by which their ways may differ from the array.
const MICROPHONES_SHARE: f64 = 0.66;
const RESIDUAL_MAX_M: f64 = 1.5e-3;
/// As good as nothing known of the air: what is known is added by whoever puts the estimates together.
const SPEED_SD_M_S: f64 = 100.0;

/// The listener with the other's emitter.
#[must_use]
pub fn hearing(listener: &SensorSetup, other: &SensorSetup) -> SensorSetup {
    let place_m = other.mount.pose().parent_from_local(other.emitter_m.xy());
    let local_m = listener.mount.pose().local_from_parent(place_m);
    let emitter_m = Vector3::new(local_m.x, local_m.y, other.emitter_m.z);
    SensorSetup { emitter_m, emission: Arc::clone(&other.emission), ..listener.clone() }
}

/// What the air is by what `observer` heard of [`hearing`]'s sensor; `mount_sd_m` is how well the distance between the two is known.
/// `None` where too few microphones heard it, or it does not fit.
#[must_use]
pub fn measure_cross(
    observer: &Observer,
    (listener, other): (&SensorSetup, &SensorSetup),
    speed_m_s: f64,
    (tolerances, mount_sd_m): (&Tolerances, f64),
) -> Option<CrossCalibration> {
    let tolerances = Tolerances { speed_m_s: SPEED_SD_M_S, emitter_m: mount_sd_m, ..*tolerances };
    let found = measure(observer, &hearing(listener, other), speed_m_s, &tolerances)?;
    let heard = found.microphones - found.unheard.len() - found.misplaced.len();
    let fits = heard as f64 >= MICROPHONES_SHARE * found.microphones as f64 && found.residual_m <= RESIDUAL_MAX_M;
    fits.then(|| CrossCalibration {
        from: other.name.clone(),
        to: listener.name.clone(),
        pings: found.pings,
        microphones: heard,
        residual_m: found.residual_m,
        speed_of_sound_m_s: found.speed_of_sound_m_s,
        speed_of_sound_sd_m_s: found.speed_of_sound_sd_m_s,
    })
}

/// A speed and its standard deviation, with what all pairs say of it. Pairs share their mounts: together they are as sure as the
/// surest.
#[must_use]
pub fn with_pairs((speed_m_s, sd_m_s): (f64, f64), pairs: &[CrossCalibration]) -> (f64, f64) {
    let weight = |sd: f64| sd.max(1e-3).powi(-2);
    let sum: f64 = pairs.iter().map(|pair| weight(pair.speed_of_sound_sd_m_s)).sum();
    let surest = pairs.iter().map(|pair| weight(pair.speed_of_sound_sd_m_s)).fold(0.0, f64::max);
    if !(sum > 0.0) {
        return (speed_m_s, sd_m_s);
    }
    let mean = pairs.iter().map(|pair| weight(pair.speed_of_sound_sd_m_s) * pair.speed_of_sound_m_s).sum::<f64>() / sum;
    let both = weight(sd_m_s) + surest;
    ((weight(sd_m_s) * speed_m_s + surest * mean) / both, both.powf(-0.5))
}
