//! Weights of the microphones that make the least of what comes from beside the main lobe.
//!
//! In: an array, the directions that are imaged, the band. Out: weights, not negative, of mean 1 over the microphones in use. The power
//! beside the main lobe of the array, steered to some of the directions and averaged over the band, is a quadratic form of the
//! weights; with their sum held it has one least (Trees 2002, "Optimum array processing", section 3.10), which is found with weights
//! below zero taken away one after another. A load on the diagonal keeps noise from growing.

use super::Band;
use crate::sensor::SensorSetup;
use crate::signal::Direction;
use nalgebra::{DMatrix, DVector, Vector3};
use std::f64::consts::PI;

/// Frequencies over the band, directions steered to, and directions from which something may come.
const FREQUENCIES: usize = 6;
const STEERED: usize = 24;
const HEARD: usize = 240;
/// Half the main lobe in wavelengths over the array's width: to the first zero of an evenly filled line.
const MAIN_LOBE: f64 = 1.1;
/// Load on the diagonal, a share of a microphone's own power: noise may grow by about a decibel.
const LOAD: f64 = 0.03;

/// The weights of one sensor's microphones, times those of its array file.
#[must_use]
pub(super) fn low_side_lobes(
    sensor: &SensorSetup,
    directions: &[Direction],
    band: &Band,
    speed_of_sound_m_s: f64,
) -> Vec<f32> {
    let array = &sensor.array;
    let mut used: Vec<usize> =
        (0..array.channel_count()).filter(|channel| array.enabled[*channel] && array.weights[*channel] > 0.0).collect();
    let power = side_lobe_power(sensor, directions, band, speed_of_sound_m_s);
    let mut weights = vec![0.0; array.channel_count()];
    while !used.is_empty() {
        let count = used.len();
        let system = DMatrix::from_fn(count, count, |row, column| {
            power[(used[row], used[column])] + if row == column { LOAD * power[(used[row], used[row])] } else { 0.0 }
        });
        let ones = DVector::from_element(count, 1.0);
        let Some(found) = system.cholesky().map(|factors| factors.solve(&ones)) else { break };
        let mean = found.mean();
        if found.iter().all(|weight| *weight >= 0.0) {
            used.iter().zip(&found).for_each(|(channel, weight)| weights[*channel] = weight / mean);
            break;
        }
        let least = (0..count).min_by(|a, b| found[*a].total_cmp(&found[*b])).unwrap_or(0);
        used.remove(least);
    }
    if weights.iter().all(|weight| *weight == 0.0) {
        return array.weights.clone();
    }
    weights.iter().zip(&array.weights).map(|(weight, own)| *weight as f32 * own).collect()
}

/// Mean of v v^H beside the main lobe, v being the array steered one way and hearing from another: its real part, since the weights are real.
fn side_lobe_power(
    sensor: &SensorSetup,
    directions: &[Direction],
    band: &Band,
    speed_of_sound_m_s: f64,
) -> DMatrix<f64> {
    let places = &sensor.array.positions_m;
    let width_m = 2.0 * places.iter().map(|place| place.norm()).fold(1e-6, f64::max);
    let some = |count: usize| -> Vec<Vector3<f64>> {
        directions.iter().step_by(directions.len().div_ceil(count)).map(Direction::unit).collect()
    };
    let (steered, heard) = (some(STEERED), some(HEARD));
    let mut power = DMatrix::zeros(places.len(), places.len());
    for index in 0..FREQUENCIES {
        let share = (index as f64 + 0.5) / FREQUENCIES as f64;
        let waves_per_m = (band.low_hz + share * (band.high_hz - band.low_hz)) / speed_of_sound_m_s;
        for to in &steered {
            for from in heard.iter().filter(|from| (*from - to).norm() * waves_per_m * width_m > MAIN_LOBE) {
                let angles: Vec<(f64, f64)> =
                    places.iter().map(|place| (2.0 * PI * waves_per_m * place.dot(&(from - to))).sin_cos()).collect();
                for (row, a) in angles.iter().enumerate() {
                    for (column, b) in angles.iter().enumerate().take(row + 1) {
                        power[(row, column)] += a.0 * b.0 + a.1 * b.1;
                    }
                }
            }
        }
    }
    power.fill_upper_triangle_with_lower_triangle();
    power
}
