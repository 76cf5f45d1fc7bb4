//! What the times of the direct path say of the air and of the sensor's geometry, and what they cannot say.
//!
//! In: how long the sound's way to each microphone seemed, and what is known beforehand. Out: speed of sound, lateness and emitter as
//! the most probable values under both, with standard deviations; of each microphone by how much its way is longer; how many
//! directions of these five unknowns the data tell anything of. Pure, double precision, allocates nothing. Measures nothing itself.
//!
//! Model (maximum a posteriori, all Gaussian): c_ref t_i = (1 + s) |p_i - e| + o + d_i + noise, with s = c_ref / c - 1, o the common
//! lateness, e the emitter, d_i what microphone i is farther away than its place says. The row of the Jacobian is
//! (|p_i - e|, 1, -u_i) with u_i the unit vector from the emitter to the microphone. For an array in a plane through the emitter
//! its x column is zero: rank 4 of 5. The other columns are nearly dependent (the ways of an array of 8 cm seen from 6 cm
//! differ little), and the d_i hide in all of them: hence the prior knowledge, and the honest standard deviations.

use nalgebra::{SMatrix, SVector, Vector3};

/// Unknowns that all microphones share: scale, lateness, emitter x, y, z.
pub const SHARED: usize = 5;
/// Fewest microphones for a solution.
pub const MICROPHONES_MIN: usize = 6;
/// Rounds of linearizing, and of leaving out microphones that do not fit.
const ROUNDS: usize = 8;
/// A microphone whose residual is larger, in its standard deviations, does not take part.
const OUTLIER_SPREADS: f64 = 4.5;
/// Largest share of the microphones that may be left out.
const OUTLIER_SHARE: f64 = 0.34;

type Shared = SVector<f64, SHARED>;
type Square = SMatrix<f64, SHARED, SHARED>;

/// One microphone's direct path.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Heard {
    /// Place of the microphone as it is known, sensor frame.
    pub place_m: Vector3<f64>,
    /// Time of arrival times [`Known::speed_of_sound_m_s`].
    pub way_m: f64,
    /// Standard deviation of that.
    pub sd_m: f64,
    /// Not to be used.
    pub unheard: bool,
}

/// What is known beforehand, and how well (standard deviations).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// Speed of sound.
    pub speed_of_sound_m_s: f64,
    /// Of the speed of sound.
    pub speed_sd_m_s: f64,
    /// Of the lateness, which is expected to be none.
    pub late_sd_s: f64,
    /// Emitter, sensor frame.
    pub emitter_m: Vector3<f64>,
    /// Of each of its coordinates.
    pub emitter_sd_m: f64,
    /// Of a microphone's place along the line from the emitter.
    pub place_sd_m: f64,
}

/// One microphone's way.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Way {
    /// By how much it is longer than place and emitter say.
    pub longer_m: f64,
    /// Standard deviation of that.
    pub sd_m: f64,
    /// Did not fit the others and took no part; its own values are those that the others leave for it.
    pub outlier: bool,
}

/// The most probable values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// Speed of sound.
    pub speed_of_sound_m_s: f64,
    /// Its standard deviation.
    pub speed_sd_m_s: f64,
    /// How much later than expected the emission begins.
    pub late_s: f64,
    /// Its standard deviation.
    pub late_sd_s: f64,
    /// Emitter, sensor frame.
    pub emitter_m: Vector3<f64>,
    /// Standard deviation of each of its coordinates.
    pub emitter_sd_m: Vector3<f64>,
    /// Rms of what is left of the microphones' ways before any is explained by their places.
    pub residual_m: f64,
    /// Microphones that took part.
    pub used: usize,
    /// Independent combinations of the five shared unknowns of which the data say more than was known.
    pub told: usize,
    /// Covariance of scale, lateness in metres, emitter x, y, z.
    pub covariance: Square,
}

/// The most probable values under the data and what was known. `ways` is filled with one entry a microphone, and must have room.
/// `None` with too few microphones, or numbers that are none.
#[must_use]
pub fn solve(heard: &[Heard], known: &Known, ways: &mut Vec<Way>) -> Option<Solution> {
    ways.clear();
    ways.extend(heard.iter().map(|one| Way { outlier: one.unheard || !one.way_m.is_finite(), ..Way::default() }));
    let reference_m_s = known.speed_of_sound_m_s;
    let prior_sd = Shared::from_column_slice(&[
        known.speed_sd_m_s / reference_m_s,
        known.late_sd_s * reference_m_s,
        known.emitter_sd_m,
        known.emitter_sd_m,
        known.emitter_sd_m,
    ]);
    let mut found = Shared::zeros();
    let mut normal = Square::zeros();
    for round in 0..ROUNDS {
        normal = Square::from_diagonal(&prior_sd.map(|sd| sd.powi(-2)));
        let mut right = -normal * found;
        for (one, _) in heard.iter().zip(ways.iter()).filter(|(_, way)| !way.outlier) {
            let (row, left_m) = linear(one, known, &found);
            let weight = 1.0 / (one.sd_m.powi(2) + known.place_sd_m.powi(2));
            normal += row * row.transpose() * weight;
            right += row * (left_m * weight);
        }
        found += normal.cholesky()?.solve(&right);
        // Who does not fit is asked twice: the first fit is bent by whoever does not.
        if round == 1 || round == 3 || round == 5 {
            leave_out(heard, known, &found, ways);
        }
    }
    let covariance = normal.try_inverse()?;
    let (used, residual_m) = explain(heard, known, &found, &covariance, ways);
    let sd = covariance.diagonal().map(f64::sqrt);
    let speed_of_sound_m_s = reference_m_s / (1.0 + found[0]);
    (used >= MICROPHONES_MIN && found.iter().chain(sd.iter()).all(|value| value.is_finite())).then(|| Solution {
        speed_of_sound_m_s,
        speed_sd_m_s: sd[0] * speed_of_sound_m_s / (1.0 + found[0]),
        late_s: found[1] / reference_m_s,
        late_sd_s: sd[1] / reference_m_s,
        emitter_m: known.emitter_m + Vector3::new(found[2], found[3], found[4]),
        emitter_sd_m: Vector3::new(sd[2], sd[3], sd[4]),
        residual_m,
        used,
        told: told(&normal, &prior_sd),
        covariance,
    })
}

/// Row of the Jacobian and what is left of a measured way.
fn linear(one: &Heard, known: &Known, found: &Shared) -> (Shared, f64) {
    let apart_m = one.place_m - known.emitter_m - Vector3::new(found[2], found[3], found[4]);
    let distance_m = apart_m.norm().max(1e-6);
    let stretch = 1.0 + found[0];
    let along = apart_m * (-stretch / distance_m);
    let row = Shared::from_column_slice(&[distance_m, 1.0, along.x, along.y, along.z]);
    (row, one.way_m - found[1] - stretch * distance_m)
}

/// Marks who does not fit, worst first, but never more than a third.
fn leave_out(heard: &[Heard], known: &Known, found: &Shared, ways: &mut [Way]) {
    let most = (OUTLIER_SHARE * heard.iter().filter(|one| !one.unheard).count() as f64) as usize;
    let spread = |one: &Heard| {
        let (_, left_m) = linear(one, known, found);
        left_m.abs() / one.sd_m.hypot(known.place_sd_m)
    };
    for (one, way) in heard.iter().zip(ways.iter_mut()) {
        way.outlier = one.unheard || !one.way_m.is_finite();
    }
    for _ in 0..most {
        let kept = heard.iter().zip(ways.iter_mut()).filter(|(_, way)| !way.outlier);
        let worst = kept.max_by(|(a, _), (b, _)| spread(a).total_cmp(&spread(b)));
        match worst {
            Some((one, way)) if spread(one) > OUTLIER_SPREADS => way.outlier = true,
            _ => return,
        }
    }
}

/// What of each residual is the microphone's own, and how sure that is; how many took part, and their rms residual.
fn explain(heard: &[Heard], known: &Known, found: &Shared, covariance: &Square, ways: &mut [Way]) -> (usize, f64) {
    let place_m2 = known.place_sd_m.powi(2);
    let (mut used, mut squares_m2) = (0_usize, 0.0);
    for (one, way) in heard.iter().zip(ways) {
        if one.unheard || !one.way_m.is_finite() {
            *way = Way { longer_m: 0.0, sd_m: known.place_sd_m, outlier: true };
            continue;
        }
        let (row, left_m) = linear(one, known, found);
        let shared_m2 = (row.transpose() * covariance * row)[0];
        let noise_m2 = one.sd_m.powi(2);
        if way.outlier {
            // It did not shape the fit, and nothing is believed of its place beforehand.
            (way.longer_m, way.sd_m) = (left_m, (noise_m2 + shared_m2).sqrt());
            continue;
        }
        let share = place_m2 / (place_m2 + noise_m2);
        way.longer_m = share * left_m;
        way.sd_m = (share * noise_m2 + share * share * shared_m2).sqrt();
        squares_m2 += left_m * left_m;
        used += 1;
    }
    (used, (squares_m2 / used.max(1) as f64).sqrt())
}

/// Eigenvalues above 1 of the data's information in units of what was known.
fn told(normal: &Square, prior_sd: &Shared) -> usize {
    let scaled = Square::from_diagonal(prior_sd) * normal * Square::from_diagonal(prior_sd) - Square::identity();
    scaled.symmetric_eigenvalues().iter().filter(|value| **value > 1.0).count()
}
