//! How the aligned channels of a cell become its value (specification, section 3, beyond the sum of delay-and-sum).
//!
//! In: `[imaging] beamformer`, `multiply_order`, `coherence`. Out: [`Combine`], which both twins follow, and the scales that go with a
//! ping's gains. Never touches a sample.

use crate::imaging::params::{Beamformer, Coherence, FOCUS_TO_MAX_M, ImagingParams};
use crate::parameter::{ParameterError, check_range};

/// Most channels multiplied with one another.
pub const ORDER_MAX: usize = 5;
/// A channel's sign turns over within 1 / this of the cosine about a right angle, 7 degrees, so that rounding decides nothing.
pub const SIGN_STEEPNESS: f32 = 8.0;

/// Neighbouring snapshots from which minimum variance learns what comes from elsewhere, and sub-bands in which it does; a snapshot is
/// as many ranges from the next as there are sub-bands, since that is what a sub-band resolves.
pub const SNAPSHOTS: usize = 5;
/// See [`SNAPSHOTS`].
pub const SUB_BANDS: usize = 4;
/// Diagonal loading: a share of the mean power of a channel.
pub const LOADING: f32 = 1.0;

/// What is done with the aligned channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Combine {
    /// Channels multiplied with one another; 1 for their sum.
    pub order: usize,
    /// Factor on the amplitude.
    pub coherence: Coherence,
    /// Sub-bands of minimum variance; 1 for the other beamformers.
    pub sub_bands: usize,
}

/// What goes with the gains of one ping.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Scale {
    /// Channels with a gain.
    pub count: f32,
    /// What products of a coherent echo of amplitude 1 are multiplied with to read 1; 0 where there are too few channels.
    pub products: f32,
}

impl Combine {
    /// What `params` ask for. The one place where these settings are judged together.
    ///
    /// # Errors
    /// If the order lies outside 2 to 5, or is given for another beamformer; if `focus_to_m` lies outside its limits; if smoothing, which
    /// runs along ranges that are all imaged alike, goes together with any of them.
    pub fn new(params: &ImagingParams) -> Result<Self, ParameterError> {
        let order = match (params.beamformer, params.multiply_order) {
            (Beamformer::DelayAndSum, None) => 1,
            (Beamformer::MinimumVariance, None) => 1,
            (Beamformer::DelayAndSum | Beamformer::MinimumVariance, Some(order)) => {
                let allowed = format!("2 to {ORDER_MAX}, with beamformer = \"delay-multiply-and-sum\" alone");
                return Err(ParameterError::new("imaging.multiply_order", order, allowed));
            }
            (Beamformer::DelayMultiplyAndSum, order) => order.unwrap_or(2),
        };
        if params.beamformer == Beamformer::DelayMultiplyAndSum && !(2..=ORDER_MAX).contains(&order) {
            let allowed = format!("2 to {ORDER_MAX} microphones multiplied");
            return Err(ParameterError::new("imaging.multiply_order", order, allowed));
        }
        if let Some(to_m) = params.focus_to_m {
            check_range("imaging.focus_to_m", to_m, 0.0, FOCUS_TO_MAX_M)?;
        }
        let sub_bands = if params.beamformer == Beamformer::MinimumVariance { SUB_BANDS } else { 1 };
        if sub_bands > 1 && params.coherence != Coherence::None {
            let allowed =
                "\"none\" with beamformer = \"minimum-variance\", which has no aligned channels left to compare";
            return Err(ParameterError::new("imaging.coherence", format!("{:?}", params.coherence), allowed));
        }
        let combine = Self { order, coherence: params.coherence, sub_bands };
        let focused = params.focus_to_m.is_some_and(|to_m| to_m > 0.0);
        match params.smoothing_hz {
            Some(cutoff_hz) if focused || !combine.is_sum() => {
                let allowed = "none together with focus_to_m, beamformer or coherence: smoothing runs along ranges that are all plain sums";
                Err(ParameterError::new("imaging.smoothing_hz", cutoff_hz, allowed))
            }
            _ => Ok(combine),
        }
    }

    /// Whether it is the plain sum, which needs no cell by itself.
    #[must_use]
    pub fn is_sum(&self) -> bool {
        self.order == 1 && self.coherence == Coherence::None && self.sub_bands == 1
    }

    /// Samples of a row that are read before the first range and behind the last.
    #[must_use]
    pub fn reach(&self) -> usize {
        if self.sub_bands > 1 { SNAPSHOTS / 2 * self.sub_bands } else { 0 }
    }

    /// Share of bin `bin` of `bin_count` in a sub-band; all shares of a bin make one.
    #[must_use]
    pub fn share(&self, sub_band: usize, bin: usize, bin_count: usize) -> f32 {
        let bands = self.sub_bands as f64;
        let place = (bin as f64 + 0.5) / bin_count as f64 * bands - 0.5;
        let distance = (place.clamp(0.0, bands - 1.0) - sub_band as f64).abs();
        if distance < 1.0 { (0.5 * std::f64::consts::PI * distance).cos().powi(2) as f32 } else { 0.0 }
    }

    /// The scales for the gains of a ping.
    #[must_use]
    pub fn scale(&self, gains: &[f32]) -> Scale {
        let count = gains.iter().filter(|gain| **gain > 0.0).count();
        // Elementary symmetric polynomial, one channel after another: additions alone, nothing cancels.
        let mut symmetric = [0.0_f64; ORDER_MAX + 1];
        symmetric[0] = 1.0;
        for gain in gains.iter().filter(|gain| **gain > 0.0) {
            let base = (count as f64 * f64::from(*gain)).powf(1.0 / self.order as f64);
            for k in (1..=self.order).rev() {
                symmetric[k] += symmetric[k - 1] * base;
            }
        }
        let whole = symmetric[self.order];
        Scale { count: count as f32, products: if whole > 0.0 { (1.0 / whole) as f32 } else { 0.0 } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_gains_scale_by_the_number_of_products_and_sub_bands_make_the_whole() {
        let gains: Vec<f32> = (0..32).map(|channel| if channel < 20 { 0.05 } else { 0.0 }).collect();
        for (order, products) in [(1, 20.0), (2, 190.0), (3, 1140.0), (4, 4845.0), (5, 15504.0)] {
            let scale = Combine { order, coherence: Coherence::None, sub_bands: 1 }.scale(&gains);
            assert_eq!(scale.count, 20.0);
            assert!((scale.products * products - 1.0).abs() < 1e-6, "order {order}: {scale:?}");
        }
        let bands = Combine { order: 1, coherence: Coherence::None, sub_bands: SUB_BANDS };
        for bin in 0..300 {
            let whole: f32 = (0..SUB_BANDS).map(|band| bands.share(band, bin, 300)).sum();
            assert!((whole - 1.0).abs() < 1e-6, "bin {bin}: {whole}");
        }
        assert_eq!(Combine { order: 3, coherence: Coherence::None, sub_bands: 1 }.scale(&[0.5, 0.5]).products, 0.0);
    }
}
