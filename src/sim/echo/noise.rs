//! White noise of the microphones, reproducible sample by sample whatever is computed in which order.
//!
//! One generator (xoshiro128++, eight interleaved lanes) a microphone and ping, keyed by seed, ping, sensor and
//! microphone. Samples are sums of four uniform bytes, one word each: excess kurtosis -0.3, tails end at 3.4 standard
//! deviations; any filter or beam over them is Gaussian. Whole arrays are computed on, so that the compiler makes
//! vectors of them: noise is most of what a ping costs.

const LANES: usize = 8;
/// Mean and standard deviation of the sum of four uniform bytes.
const BYTES_MEAN: f32 = 510.0;
const BYTES_SD: f32 = 147.800_54;

type Words = [u32; LANES];

/// A stream of noise.
#[derive(Debug, Clone)]
pub(super) struct Noise {
    state: [Words; 4],
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

    /// Fills `samples` with noise of standard deviation `rms`.
    pub(super) fn fill(&mut self, samples: &mut [f32], rms: f64) {
        if rms == 0.0 {
            samples.fill(0.0);
            return;
        }
        let scale = rms as f32 / BYTES_SD;
        let mut state = self.state;
        let (blocks, rest) = samples.as_chunks_mut::<LANES>();
        for block in blocks {
            *block = amplitudes(next(&mut state), scale);
        }
        if !rest.is_empty() {
            rest.copy_from_slice(&amplitudes(next(&mut state), scale)[..rest.len()]);
        }
        self.state = state;
    }

    /// One number of the stream, uniform in [-0.5, 0.5).
    pub(super) fn uniform(&mut self) -> f32 {
        (next(&mut self.state)[0] >> 8) as f32 / (1 << 24) as f32 - 0.5
    }

    /// One number of the stream, of mean 0 and standard deviation 1: a sum of twelve uniform ones, which is Gaussian
    /// enough and ends at 6.
    pub(super) fn gaussian(&mut self) -> f64 {
        (0..12).map(|_| f64::from(self.uniform())).sum()
    }
}

/// A step of every lane's generator.
#[inline(always)]
fn next(state: &mut [Words; 4]) -> Words {
    let [a, b, c, d] = *state;
    let result = zip(rotated::<7>(zip(a, d, u32::wrapping_add)), a, u32::wrapping_add);
    let shifted = b.map(|word| word << 9);
    let c = zip(c, a, xor);
    let d = zip(d, b, xor);
    *state = [zip(a, d, xor), zip(b, c, xor), zip(c, shifted, xor), rotated::<11>(d)];
    result
}

/// The sums of each word's bytes, centred and scaled.
#[inline(always)]
fn amplitudes(words: Words, scale: f32) -> [f32; LANES] {
    words.map(|word| {
        let pairs = (word & 0x00FF_00FF) + ((word >> 8) & 0x00FF_00FF);
        let sum = (pairs & 0xFFFF) + (pairs >> 16);
        (sum.cast_signed() as f32 - BYTES_MEAN) * scale
    })
}

#[inline(always)]
fn zip(first: Words, second: Words, operation: impl Fn(u32, u32) -> u32) -> Words {
    std::array::from_fn(|lane| operation(first[lane], second[lane]))
}

#[inline(always)]
fn rotated<const BITS: u32>(words: Words) -> Words {
    words.map(|word| word.rotate_left(BITS))
}

#[inline(always)]
fn xor(first: u32, second: u32) -> u32 {
    first ^ second
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
