//! Choice of the transform lengths: D, N1 and M of the plan, by a small model of what they cost.
//!
//! In: rate, band, least transform length, bounds on the range step. Out: the cheapest sizes whose prime factors are 2, 3, 5 and
//! 7. The model knows cycles of a vector unit only roughly; it decides between sizes, never about results.

use super::filters::kaiser_length;

/// Longest transform that fits the 16 KiB of workgroup memory that every adapter has; longer ones are chosen less readily.
const WORKGROUP_TRANSFORM_MAX: usize = 2048;

/// Largest decimation that is looked at: transforms of a hundredth of the samples cost next to nothing already, and a band of a
/// few hertz would allow a million of them.
const DECIMATION_MAX: usize = 128;

/// What the sizes must satisfy.
pub(super) struct Wanted {
    pub sample_rate_hz: f64,
    /// Width of the band, edges included.
    pub width_hz: f64,
    /// Least N.
    pub span_min: usize,
    /// M / N for the largest range step allowed; the smallest is 1 % below.
    pub inverse_per_span: f64,
    pub channels: usize,
    pub directions: usize,
    pub attenuation_db: f64,
}

/// What was chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sizes {
    pub decimation: usize,
    pub forward_len: usize,
    pub inverse_len: usize,
}

/// Whether no prime factor but 2, 3, 5 and 7 remains: whether both backends have a transform of this length.
pub(in crate::imaging) fn is_smooth(len: usize) -> bool {
    transform_cycles(len).is_some()
}

/// Cycles of one transform, or `None` where a prime factor above 7 remains, as of nothing, which every factor divides.
fn transform_cycles(len: usize) -> Option<f64> {
    if len == 0 {
        return None;
    }
    let mut rest = len;
    let mut levels = 0.0;
    for (factor, level) in [(2, 1.0), (3, 1.8), (5, 2.8), (7, 4.0)] {
        while rest.is_multiple_of(factor) {
            rest /= factor;
            levels += level;
        }
    }
    let memory = if len > WORKGROUP_TRANSFORM_MAX { 1.3 } else { 1.0 };
    (rest == 1).then_some(0.8 * levels * memory * len as f64)
}

/// The cheapest length in `[min, max]` with its cost.
fn cheapest_transform(min: f64, max: f64) -> Option<(usize, f64)> {
    let (min, max) = ((min - 1e-9).ceil().max(2.0) as usize, (max + 1e-9).floor() as usize);
    (min..=max).filter_map(|len| transform_cycles(len).map(|cycles| (len, cycles))).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// The cheapest sizes, or `None` where the band does not fit the sample rate or no length fits the step.
pub(super) fn choose(wanted: &Wanted) -> Option<Sizes> {
    let mut best: Option<(f64, Sizes)> = None;
    let decimation_max = ((wanted.sample_rate_hz / wanted.width_hz).ceil() as usize).min(DECIMATION_MAX);
    for decimation in 1..=decimation_max {
        let transition = 1.0 / decimation as f64 - wanted.width_hz / wanted.sample_rate_hz;
        if !(transition > 0.01 / decimation as f64) {
            break;
        }
        let taps = if decimation == 1 { 0 } else { kaiser_length(wanted.attenuation_db, transition) };
        let least = wanted.span_min.div_ceil(decimation);
        for forward_len in least..=least + least / 5 + 8 {
            let span = forward_len * decimation;
            let Some(forward_cycles) = transform_cycles(forward_len).filter(|_| taps < span / 2) else { continue };
            let inverse_min = wanted.inverse_per_span * span as f64;
            let Some((inverse_len, inverse_cycles)) = cheapest_transform(inverse_min, inverse_min / 0.99) else {
                continue;
            };
            let bins = span as f64 * wanted.width_hz / wanted.sample_rate_hz;
            let (channels, directions) = (wanted.channels as f64, wanted.directions as f64);
            let filter_cycles = forward_len as f64 * (10.0 + taps as f64 / 8.0);
            let cost = channels * (filter_cycles + forward_cycles)
                + directions * inverse_cycles
                + 0.17 * bins * channels * directions;
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, Sizes { decimation, forward_len, inverse_len }));
            }
        }
    }
    best.map(|(_, sizes)| sizes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_smooth_long_enough_and_keep_the_step_within_one_percent() {
        for (rate, width, span_min, step_m) in [
            (450e3, 30e3, 16384, 0.005),
            (450e3, 72e3, 26000, 0.0023),
            (192e3, 30e3, 7000, 0.005),
            (1e6, 30e3, 40000, 0.02),
            (450e3, 30e3, 16384, 0.3),
        ] {
            let inverse_per_span = 343.0 / (2.0 * rate * step_m);
            let wanted = Wanted {
                sample_rate_hz: rate,
                width_hz: width,
                span_min,
                inverse_per_span,
                channels: 32,
                directions: 180,
                attenuation_db: 110.0,
            };
            let sizes = choose(&wanted).unwrap();
            let span = sizes.forward_len * sizes.decimation;
            assert!(span >= span_min && rate / sizes.decimation as f64 > width, "{sizes:?}");
            let step = 343.0 * span as f64 / (2.0 * rate * sizes.inverse_len as f64);
            assert!(step <= step_m * (1.0 + 1e-9) && step >= 0.99 * step_m * (1.0 - 1e-9), "{step} for {step_m}");
            assert!(transform_cycles(sizes.forward_len).is_some() && transform_cycles(sizes.inverse_len).is_some());
        }
    }
}
