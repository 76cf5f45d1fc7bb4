//! What several test files share: scenes with known content, the textbook imaging in f64, comparisons.
#![allow(dead_code, reason = "every test file uses its own part of this")]

pub mod backends;
pub mod beamforming;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod lap;
pub mod oracle;
pub mod peaks;
pub mod scenes;
#[cfg(feature = "gpu")]
pub mod validation;

/// Relative L2 distance of `found` from `truth`; infinite when a value is not finite, when the lengths differ, or when there is no truth to
/// compare with.
pub fn relative_l2(found: &[f32], truth: &[f64]) -> f64 {
    if found.len() != truth.len() || !found.iter().all(|value| value.is_finite()) {
        return f64::INFINITY;
    }
    let error: f64 = found.iter().zip(truth).map(|(found, truth)| (f64::from(*found) - truth).powi(2)).sum();
    let power: f64 = truth.iter().map(|truth| truth * truth).sum();
    if power > 0.0 { (error / power).sqrt() } else { f64::INFINITY }
}

/// As [`relative_l2`], for complex values.
pub fn relative_l2_complex(found: &[[f32; 2]], truth: &[oracle::Complex]) -> f64 {
    let truth: Vec<f64> = truth.iter().flat_map(|value| [value.re, value.im]).collect();
    relative_l2(found.as_flattened(), &truth)
}

/// A small generator of random numbers (SplitMix64): tests must not change when a crate does.
#[derive(Debug, Clone)]
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [low, high).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in 0 .. count.
    pub fn index(&mut self, count: usize) -> usize {
        (self.bits() % count as u64) as usize
    }

    /// Normal, variance 1 (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform(0.0, 1.0)).ln()).sqrt();
        radius * (2.0 * std::f64::consts::PI * self.uniform(0.0, 1.0)).cos()
    }
}
