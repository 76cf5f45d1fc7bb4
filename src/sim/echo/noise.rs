//! White noise of the microphones, reproducible sample by sample whatever is computed in which order.
//!
//! One generator (xoshiro128++, eight interleaved lanes) a microphone and ping, keyed by seed, ping, sensor and
//! microphone. Samples are sums of eight uniform bytes: excess kurtosis -0.15, tails end at 4.9 standard deviations; any
//! filter or beam over them is Gaussian.

const LANES: usize = 8;
/// Mean and standard deviation of the sum of eight uniform bytes.
const BYTES_MEAN: f32 = 1020.0;
const BYTES_SD: f32 = 209.022_73;

/// A stream of noise.
#[derive(Debug, Clone)]
pub(super) struct Noise {
    state: [[u32; LANES]; 4],
}

impl Noise {
    /// The stream that belongs to `key`; equal keys give equal streams.
    pub(super) fn new(key: [u64; 4]) -> Self {
        let mut mixed = 0x6A09_E667_F3BC_C908;
        for part in key {
            mixed = split_mix(mixed ^ part);
        }
        let mut state = [[0; LANES]; 4];
        for word in state.iter_mut().flatten() {
            mixed = split_mix(mixed);
            *word = (mixed >> 32) as u32;
        }
        // A lane of zeros would stay zero for ever.
        state[0].iter_mut().for_each(|word| *word |= 1);
        Self { state }
    }

    fn next(&mut self) -> [u32; LANES] {
        let [a, b, c, d] = &mut self.state;
        std::array::from_fn(|lane| {
            let result = a[lane].wrapping_add(d[lane]).rotate_left(7).wrapping_add(a[lane]);
            let shifted = b[lane] << 9;
            c[lane] ^= a[lane];
            d[lane] ^= b[lane];
            b[lane] ^= c[lane];
            a[lane] ^= d[lane];
            c[lane] ^= shifted;
            d[lane] = d[lane].rotate_left(11);
            result
        })
    }

    /// Fills `samples` with noise of standard deviation `rms`.
    pub(super) fn fill(&mut self, samples: &mut [f32], rms: f64) {
        if rms == 0.0 {
            samples.fill(0.0);
            return;
        }
        let scale = rms as f32 / BYTES_SD;
        for block in samples.chunks_mut(LANES) {
            let (first, second) = (self.next(), self.next());
            let values: [f32; LANES] = std::array::from_fn(|lane| {
                let pairs = (first[lane] & 0x00FF_00FF)
                    + ((first[lane] >> 8) & 0x00FF_00FF)
                    + (second[lane] & 0x00FF_00FF)
                    + ((second[lane] >> 8) & 0x00FF_00FF);
                let sum = (pairs & 0xFFFF) + (pairs >> 16);
                (sum as i32 as f32 - BYTES_MEAN) * scale
            });
            block.copy_from_slice(&values[..block.len()]);
        }
    }

    /// One number of the stream, uniform in [-0.5, 0.5), for starting states.
    pub(super) fn uniform(&mut self) -> f32 {
        (self.next()[0] >> 8) as f32 / (1 << 24) as f32 - 0.5
    }
}

fn split_mix(state: u64) -> u64 {
    let mut z = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_white_centred_and_of_the_rms_asked_for() {
        let mut samples = vec![0.0; 1 << 18];
        Noise::new([1, 2, 3, 4]).fill(&mut samples, 0.5);
        let count = samples.len() as f64;
        let moment = |lag: usize| {
            samples.iter().zip(&samples[lag..]).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>() / count
        };
        let mean = samples.iter().map(|value| f64::from(*value)).sum::<f64>() / count;
        // One standard error of the mean and of a correlation is 0.5/512 and 0.25/512.
        assert!(mean.abs() < 4.0 * 0.5 / 512.0);
        assert!((moment(0) - 0.25).abs() < 4.0 * 0.36 / 512.0);
        for lag in [1, 2, 7, 8, 9, 16, 64] {
            assert!(moment(lag).abs() < 4.0 * 0.25 / 512.0, "lag {lag}: {}", moment(lag));
        }
    }

    #[test]
    fn keys_that_differ_in_one_bit_give_unrelated_streams() {
        let mut first = vec![0.0; 4096];
        let mut second = first.clone();
        Noise::new([7, 0, 0, 0]).fill(&mut first, 1.0);
        Noise::new([7, 0, 0, 1]).fill(&mut second, 1.0);
        let correlation = first.iter().zip(&second).map(|(a, b)| a * b).sum::<f32>() / 4096.0;
        assert!(correlation.abs() < 4.0 / 64.0, "{correlation}");
    }
}
