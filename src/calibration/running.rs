//! A mean that goes on over many pings and is not moved by a few wrong ones.
//!
//! In: one value a ping. Out: mean and its standard deviation. Values come in blocks; of each block those far from its median are left
//! out (an echo of a hand, a jammer's burst), and the means of blocks are averaged, over all of them or with a memory of a few. How far
//! the means of blocks scatter says how good their average is, slow disturbances included. Fixed size, allocates nothing.

/// Values of a block.
pub const BLOCK: usize = 16;
/// Values farther from the median, in standard deviations by the median of sizes, are left out.
const OUTLIER_SPREADS: f64 = 4.0;
/// Blocks from which on their own scatter says how good the mean is.
const SCATTER_BLOCKS: f64 = 4.0;

/// The running mean.
#[derive(Debug, Clone)]
pub struct Running {
    block: [f64; BLOCK],
    len: usize,
    blocks: f64,
    memory: f64,
    mean: f64,
    /// Of the means of blocks about the mean.
    variance: f64,
    /// Of values within blocks.
    within: f64,
}

impl Running {
    /// Starts empty; with `memory` blocks older ones fade, with infinity all count alike.
    #[must_use]
    pub fn new(memory: f64) -> Self {
        Self { block: [0.0; BLOCK], len: 0, blocks: 0.0, memory, mean: 0.0, variance: 0.0, within: 0.0 }
    }

    /// Takes a value; what is not finite is left out.
    pub fn push(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        self.block[self.len] = value;
        self.len += 1;
        if self.len == BLOCK {
            self.len = 0;
            let (mean, variance) = of_block(self.block, BLOCK);
            self.add(mean, variance);
        }
    }

    fn add(&mut self, mean: f64, variance: f64) {
        self.blocks += 1.0;
        let share = 1.0 / self.blocks.min(self.memory);
        let change = mean - self.mean;
        self.mean += share * change;
        self.within += share * (variance - self.within);
        // The first block has nothing to differ from.
        if self.blocks > 1.0 {
            let share = 1.0 / (self.blocks - 1.0).min(self.memory);
            self.variance += share * (change * change * (1.0 - 1.0 / self.blocks.min(self.memory)) - self.variance);
        }
    }

    /// Whole blocks so far.
    #[must_use]
    pub fn blocks(&self) -> u64 {
        self.blocks as u64
    }

    /// Mean and its standard deviation; of a beginning with at least three values before the first block is full, else `None`.
    #[must_use]
    pub fn mean(&self) -> Option<(f64, f64)> {
        if self.blocks < 1.0 {
            let (mean, variance) = (self.len >= 3).then(|| of_block(self.block, self.len))?;
            return Some((mean, (variance / self.len as f64).sqrt()));
        }
        // An average that fades weighs as twice its memory would.
        let count = self.blocks.min(2.0 * self.memory);
        let by_values = self.within / (BLOCK as f64 * count);
        let by_blocks = if self.blocks >= SCATTER_BLOCKS { self.variance / count } else { 0.0 };
        Some((self.mean, by_values.max(by_blocks).sqrt()))
    }
}

/// Mean and variance of the first `len` values but those far from their median.
fn of_block(mut values: [f64; BLOCK], len: usize) -> (f64, f64) {
    let values = &mut values[..len];
    values.sort_unstable_by(f64::total_cmp);
    let median = values[len / 2];
    let mut sizes = [0.0; BLOCK];
    for (size, value) in sizes.iter_mut().zip(values.iter()) {
        *size = (value - median).abs();
    }
    sizes[..len].sort_unstable_by(f64::total_cmp);
    let limit = OUTLIER_SPREADS * 1.48 * sizes[len / 2];
    let kept = || values.iter().filter(|value| (*value - median).abs() <= limit);
    let count = kept().count().max(1) as f64;
    let mean = kept().sum::<f64>() / count;
    (mean, kept().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sum of twelve uniform numbers, of mean 0 and variance 1.
    fn gaussian(state: &mut u64) -> f64 {
        let mut uniform = || {
            *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (*state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        (0..12).map(|_| uniform()).sum()
    }

    #[test]
    fn the_standard_deviation_told_is_the_one_that_means_have() {
        let mut state = 7;
        let (mut squares, runs) = (0.0, 400);
        for _ in 0..runs {
            let mut running = Running::new(f64::INFINITY);
            (0..160).for_each(|_| running.push(5.0 + gaussian(&mut state)));
            let (mean, sd) = running.mean().expect("blocks");
            squares += ((mean - 5.0) / sd).powi(2);
        }
        // Mean square of 400 standard normal numbers: 1 +- 0.07; the sd is itself estimated from ten blocks.
        let found = squares / f64::from(runs);
        assert!((0.75..1.3).contains(&found), "{found}");
    }

    #[test]
    fn a_quarter_of_wrong_values_moves_nothing_and_a_plain_mean_would_be_moved() {
        let mut state = 3;
        let mut running = Running::new(f64::INFINITY);
        let mut plain = 0.0;
        for index in 0..320 {
            let value = if index % 4 == 0 { 50.0 } else { gaussian(&mut state) };
            running.push(value);
            plain += value / 320.0;
        }
        let (mean, _) = running.mean().expect("blocks");
        assert!(mean.abs() < 0.3, "{mean}");
        assert!(plain > 10.0, "{plain}");
    }

    #[test]
    fn a_memory_forgets_and_nothing_comes_of_nothing() {
        let mut running = Running::new(4.0);
        (0..BLOCK * 40).for_each(|index| running.push(if index < BLOCK * 20 { 0.0 } else { 1.0 }));
        assert!(running.mean().expect("blocks").0 > 0.99);
        let mut empty = Running::new(4.0);
        empty.push(f64::NAN);
        empty.push(1.0);
        assert_eq!(empty.mean(), None);
    }
}
