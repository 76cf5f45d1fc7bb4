//! A transform length as the passes of `shaders/common/fft.wgsl`.
//!
//! In: a length of factors 2, 3, 5 and 7. Out: the radices of the passes, each a product of rows and columns that one thread
//! holds in registers. Never transforms anything.

use crate::imaging::plan::is_smooth;

/// One pass: `rows * columns` values a butterfly, after passes of product `span`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Pass {
    pub rows: u32,
    pub columns: u32,
    pub span: u32,
}

impl Pass {
    pub(super) fn radix(self) -> u32 {
        self.rows * self.columns
    }

    /// Constants of its pipeline in a transform of `len`.
    pub(super) fn constants(self, len: usize) -> [(&'static str, f64); 4] {
        [
            ("RADIX_ROWS", f64::from(self.rows)),
            ("RADIX_COLUMNS", f64::from(self.columns)),
            ("LEN", len as f64),
            ("SPAN", f64::from(self.span)),
        ]
    }
}

/// Radices a thread can hold, with their rows and columns. RADIX_MAX of the shader is the largest.
const RADICES: [(u32, u32, u32); 18] = [
    (1, 1, 1),
    (2, 2, 1),
    (3, 3, 1),
    (4, 4, 1),
    (5, 5, 1),
    (6, 3, 2),
    (7, 7, 1),
    (8, 4, 2),
    (9, 3, 3),
    (10, 5, 2),
    (12, 4, 3),
    (14, 7, 2),
    (15, 5, 3),
    (16, 4, 4),
    (20, 5, 4),
    (21, 7, 3),
    (25, 5, 5),
    (28, 7, 4),
];

/// The passes of a transform of `len`, at least two, or `None` where it has a prime factor above 7. Fewest passes first, since each
/// goes once through memory; then the smallest sum of radices, since a large butterfly holds few threads busy.
pub(super) fn passes(len: usize) -> Option<Vec<Pass>> {
    let len = u32::try_from(len).ok().filter(|_| is_smooth(len))?;
    let radices = (2..=10).find_map(|count| cheapest(len, count))?.1;
    let mut span = 1;
    let mut passes = Vec::with_capacity(radices.len());
    for radix in radices {
        let (_, rows, columns) = *RADICES.iter().find(|entry| entry.0 == radix)?;
        passes.push(Pass { rows, columns, span });
        span *= radix;
    }
    Some(passes)
}

/// `count` radices, largest first, of product `len`, with their sum.
fn cheapest(len: u32, count: usize) -> Option<(u32, Vec<u32>)> {
    if count == 0 {
        return (len == 1).then(|| (0, Vec::new()));
    }
    let candidates = RADICES.iter().map(|entry| entry.0).filter(|radix| len.is_multiple_of(*radix));
    candidates
        .filter_map(|radix| {
            let (sum, mut rest) = cheapest(len / radix, count - 1)?;
            rest.push(radix);
            rest.sort_unstable_by(|a, b| b.cmp(a));
            Some((sum + radix, rest))
        })
        .min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_multiply_to_the_length_and_know_what_came_before() {
        for len in [1, 2, 7, 48, 128, 1250, 1372, 2048, 2560, 3456, 16384, 117_649] {
            let passes = passes(len).unwrap();
            assert!(passes.len() >= 2);
            let mut span = 1;
            for pass in &passes {
                assert_eq!(pass.span, span);
                span *= pass.radix();
            }
            assert_eq!(span as usize, len);
        }
    }

    #[test]
    fn usual_lengths_need_three_passes() {
        for len in [1250, 1372, 2048, 2560, 4096] {
            assert_eq!(passes(len).unwrap().len(), 3, "{len}");
        }
    }

    #[test]
    fn a_prime_factor_above_7_is_refused() {
        assert!(passes(11).is_none() && passes(2 * 13).is_none() && passes(0).is_none());
    }
}
