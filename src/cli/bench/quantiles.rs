//! Times of one thing measured many times, and what is said of them.

use serde_json::{Value, json};

/// Sorted times in milliseconds.
#[derive(Debug, Clone, Default)]
pub struct Quantiles(Vec<f64>);

impl Quantiles {
    /// Sorts.
    #[must_use]
    pub fn of(mut times_ms: Vec<f64>) -> Self {
        times_ms.sort_by(f64::total_cmp);
        Self(times_ms)
    }

    /// The smallest time that at least this share does not exceed (nearest rank); zero for none.
    #[must_use]
    pub fn at(&self, share: f64) -> f64 {
        let rank = (share * self.0.len() as f64).ceil() as usize;
        self.0.get(rank.clamp(1, self.0.len().max(1)) - 1).copied().unwrap_or(0.0)
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Median, tails and worst, with the number that they rest on.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "count": self.count(),
            "p50_ms": self.at(0.5),
            "p99_ms": self.at(0.99),
            "p99_9_ms": self.at(0.999),
            "max_ms": self.at(1.0),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_nearest_ranks_and_nothing_is_zero() {
        let thousand = Quantiles::of((1..=1000).rev().map(f64::from).collect());
        let of = [0.5, 0.99, 0.999, 1.0].map(|share| thousand.at(share));
        assert_eq!(of, [500.0, 990.0, 999.0, 1000.0]);
        assert_eq!(Quantiles::default().at(0.5), 0.0);
    }
}
