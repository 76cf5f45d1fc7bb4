//! The adaptive beamformer of least output power (Capon 1969, "High-resolution frequency-wavenumber spectrum analysis", Proc. IEEE 57; Synnevag et
//! al. 2007 for broadband arrays): what comes from elsewhere is nulled as far as the snapshots show it.
//!
//! With the aligned snapshots S (channels by [`SNAPSHOTS`]), R = S S^H + d I and w = R^-1 1 / (1^H R^-1 1). S has fewer columns than rows, so
//! R^-1 follows from the small matrix A = d I + S^H S (Woodbury): with A x = S^H 1 the output for snapshot m is
//! d conj(x_m) / (N - 1^H S x). In: S^H S and S^H 1 of neighbouring ranges, one a lane. Out: the complex output. Twin of
//! `minimum_variance` in `shaders/focus.wgsl`.

use super::simd::Vector;
use crate::imaging::plan::combine::{LOADING, SNAPSHOTS};

type Pair<V> = [V; 2];

/// S^H S, its upper half, and S^H 1.
pub(super) struct Snapshots<V> {
    gram: [[Pair<V>; SNAPSHOTS]; SNAPSHOTS],
    sums: [Pair<V>; SNAPSHOTS],
}

/// conj(a) b added to c.
#[inline(always)]
fn add_conjugate_product<V: Vector>(a: Pair<V>, b: Pair<V>, c: Pair<V>) -> Pair<V> {
    [a[1].mul_add(b[1], a[0].mul_add(b[0], c[0])), a[1].neg_mul_add(b[0], a[0].mul_add(b[1], c[1]))]
}

/// a b taken from c.
#[inline(always)]
fn less_product<V: Vector>(a: Pair<V>, b: Pair<V>, c: Pair<V>) -> Pair<V> {
    [a[1].mul_add(b[1], a[0].neg_mul_add(b[0], c[0])), a[1].neg_mul_add(b[0], a[0].neg_mul_add(b[1], c[1]))]
}

impl<V: Vector> Snapshots<V> {
    #[inline(always)]
    pub(super) fn new() -> Self {
        let zero = V::splat(0.0);
        Self { gram: [[[zero; 2]; SNAPSHOTS]; SNAPSHOTS], sums: [[zero; 2]; SNAPSHOTS] }
    }

    /// Adds a channel's value in every snapshot.
    #[inline(always)]
    pub(super) fn add(&mut self, values: &[Pair<V>; SNAPSHOTS]) {
        for row in 0..SNAPSHOTS {
            for column in row..SNAPSHOTS {
                self.gram[row][column] = add_conjugate_product(values[row], values[column], self.gram[row][column]);
            }
            let [re, im] = values[row];
            let [sum_re, sum_im] = self.sums[row];
            self.sums[row] = [sum_re.add(re), sum_im.sub(im)];
        }
    }

    /// The output for the middle snapshot; `channels` is N.
    #[inline(always)]
    pub(super) fn output(&self, channels: f32) -> Pair<V> {
        let zero = V::splat(0.0);
        let mut trace = zero;
        for index in 0..SNAPSHOTS {
            trace = trace.add(self.gram[index][index][0]);
        }
        let load = trace.mul(V::splat(LOADING / channels.max(1.0)));
        // A = L D L^H, in place: rows of the upper half are D L^H.
        let mut upper = self.gram;
        let mut solved = self.sums;
        let mut inverse = [zero; SNAPSHOTS];
        for pivot in 0..SNAPSHOTS {
            let diagonal = upper[pivot][pivot][0].add(load);
            inverse[pivot] = zero.where_less(diagonal, V::splat(1.0).div(diagonal), zero);
            for row in pivot + 1..SNAPSHOTS {
                // L[row][pivot] = conj(upper[pivot][row]) / D.
                let [re, im] = upper[pivot][row];
                let factor = [re.mul(inverse[pivot]), zero.sub(im.mul(inverse[pivot]))];
                // The diagonal's load is added when its turn comes.
                let top = upper[pivot];
                for (value, top) in upper[row].iter_mut().zip(top).skip(row) {
                    *value = less_product(factor, top, *value);
                }
                solved[row] = less_product(factor, solved[pivot], solved[row]);
            }
        }
        for row in (0..SNAPSHOTS).rev() {
            let mut rest = solved[row];
            for column in row + 1..SNAPSHOTS {
                rest = less_product(upper[row][column], solved[column], rest);
            }
            solved[row] = rest.map(|part| part.mul(inverse[row]));
        }
        // 1^H S x is real: it is x^H A x.
        let mut within = zero;
        for (sum, x) in self.sums.iter().zip(&solved) {
            within = sum[1].mul_add(x[1], sum[0].mul_add(x[0], within));
        }
        let rest = V::splat(channels).sub(within);
        let [re, im] = solved[SNAPSHOTS / 2];
        let scale = zero.where_less(rest, load.div(rest), zero);
        [re.mul(scale), zero.sub(im.mul(scale))]
    }
}
