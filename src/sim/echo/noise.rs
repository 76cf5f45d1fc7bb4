//! White noise of the microphones, reproducible sample by sample whatever is computed in which order.
//!
//! One generator (xoshiro128++, eight interleaved lanes) a microphone and ping, keyed by seed, ping, sensor and
//! microphone. A sample is the sum of four uniform bytes with signs (excess kurtosis -0.3, tails end at 3.4 standard
//! deviations), and the four bytes of a word give four samples with the signs of a Hadamard matrix: uncorrelated, so the
//! noise is white; any filter or beam over it is Gaussian. Noise is most of what a ping costs: whole arrays are computed
//! on, so that the compiler makes vectors of them.

const LANES: usize = 8;
/// Samples made of a step of all lanes.
const BLOCK: usize = 4 * LANES;
/// Mean of two uniform bytes, and standard deviation of four.
const PAIR_MEAN: i32 = 255;
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
        let (blocks, rest) = samples.as_chunks_mut::<BLOCK>();
        for block in blocks {
            fill_block(block, next(&mut state), scale);
        }
        if !rest.is_empty() {
            let mut block = [0.0; BLOCK];
            fill_block(&mut block, next(&mut state), scale);
            rest.copy_from_slice(&block[..rest.len()]);
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

/// The bytes a, b, c, d of each word as a + b + c + d, a - b + c - d, a + b - c - d and a - b - c + d, centred and scaled.
#[inline(always)]
fn fill_block(block: &mut [f32; BLOCK], words: Words, scale: f32) {
    // Two sums or differences of bytes a word, each in a half of it; 255 keeps the differences positive.
    let even = words.map(|word| word & 0x00FF_00FF);
    let odd = words.map(|word| (word >> 8) & 0x00FF_00FF);
    let sums = zip(even, odd, u32::wrapping_add);
    let differences = zip(even, odd, |even, odd| (even + 0x00FF_00FF).wrapping_sub(odd));
    let (quarters, _) = block.as_chunks_mut::<LANES>();
    for (pair, halves) in quarters.chunks_exact_mut(2).zip([sums, differences]) {
        let low = halves.map(|half| (half & 0xFFFF).cast_signed());
        let high = halves.map(|half| (half >> 16).cast_signed());
        pair[0] = std::array::from_fn(|lane| (low[lane] + high[lane] - 2 * PAIR_MEAN) as f32 * scale);
        pair[1] = std::array::from_fn(|lane| (low[lane] - high[lane]) as f32 * scale);
    }
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
        for lag in (1..=40).chain([64, 96, 128]) {
            assert!(moment(lag).abs() < 4.0 * 0.25 / 512.0, "lag {lag}: {}", moment(lag));
        }
        // Sums of four uniform numbers: the fourth moment is 2.7 times the square of the second, and no value is far out.
        let fourth = samples.iter().map(|value| f64::from(*value).powi(4)).sum::<f64>() / count;
        assert!((fourth / moment(0).powi(2) - 2.7).abs() < 0.05, "{fourth}");
        let largest = samples.iter().fold(0f32, |largest, value| largest.max(value.abs()));
        assert!((1.5..0.5 * 3.46).contains(&largest), "{largest}");
    }

    #[test]
    fn what_a_filter_makes_of_it_is_gaussian_and_every_length_is_filled() {
        let mut samples = vec![0.0; 1 << 20];
        Noise::new([5, 6, 7, 8]).fill(&mut samples, 1.0);
        // Sums of 64 samples with signs that repeat every block, the worst case for the four samples of a word.
        let sums: Vec<f64> = samples
            .chunks_exact(64)
            .map(|part| {
                part.iter().enumerate().map(|(i, v)| if i % 3 == 0 { -f64::from(*v) } else { f64::from(*v) }).sum()
            })
            .collect();
        let count = sums.len() as f64;
        let second = sums.iter().map(|sum| sum.powi(2)).sum::<f64>() / count;
        let fourth = sums.iter().map(|sum| sum.powi(4)).sum::<f64>() / count;
        // One standard error is 1.1 % and 0.04.
        assert!((second / 64.0 - 1.0).abs() < 0.05, "{second}");
        assert!((fourth / second.powi(2) - 3.0).abs() < 0.16, "{fourth}");
        for len in [1, 7, 31, 33, 95] {
            let mut short = vec![f32::NAN; len];
            Noise::new([5, 6, 7, 8]).fill(&mut short, 1.0);
            assert_eq!(short, samples[..len]);
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
