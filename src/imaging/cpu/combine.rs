//! Aligned channels to one value a cell (plan, `combine`): products instead of the sum, and coherence factors.
//!
//! In: what every channel adds to a vector of neighbouring ranges, its gain in it, and the gains. Out: amplitudes, scaled so that an
//! echo of amplitude A, coherent over the array, reads A whatever the rule. Twin of `combined` in `shaders/focus.wgsl`.

use super::simd::Vector;
use crate::imaging::params::Coherence;
use crate::imaging::plan::combine::{Combine, ORDER_MAX, SIGN_STEEPNESS, Scale};

/// A complex vector.
type Pair<V> = [V; 2];

#[inline(always)]
fn times<V: Vector>(a: Pair<V>, b: Pair<V>) -> Pair<V> {
    [a[1].neg_mul_add(b[1], a[0].mul(b[0])), a[1].mul_add(b[0], a[0].mul(b[1]))]
}

#[inline(always)]
fn power<V: Vector>(a: Pair<V>) -> V {
    a[0].mul_add(a[0], a[1].mul(a[1]))
}

/// `value / by`, zero where `by` is not above zero.
#[inline(always)]
fn over<V: Vector>(value: V, by: V) -> V {
    let zero = V::splat(0.0);
    zero.where_less(by, value.div(by), zero)
}

/// Amplitudes of a vector of cells. `aligned` is `[channel][re, im]`; a channel whose gain is zero holds zeros.
#[inline(always)]
pub(super) fn combine<V: Vector>(combine: &Combine, scale: &Scale, aligned: &[[V::Row; 2]], gains: &[f32]) -> V {
    let zero = V::splat(0.0);
    let mut sum = [zero; 2];
    for channel in aligned {
        sum = [sum[0].add(V::load(&channel[0])), sum[1].add(V::load(&channel[1]))];
    }
    let amplitude = if combine.order > 1 { products::<V>(combine.order, scale, aligned) } else { power(sum).sqrt() };
    let factor = match combine.coherence {
        Coherence::None => return amplitude,
        Coherence::Amplitude => amplitude_coherence::<V>(sum, aligned, gains),
        Coherence::Phase => phase_coherence::<V>(aligned, gains),
        Coherence::Sign => sign_coherence::<V>(sum, aligned, gains),
    };
    amplitude.mul(factor)
}

/// |sum|^2 over what it could be: see [`Coherence::Amplitude`].
#[inline(always)]
fn amplitude_coherence<V: Vector>(sum: Pair<V>, aligned: &[[V::Row; 2]], gains: &[f32]) -> V {
    let mut powers = V::splat(0.0);
    for (channel, gain) in aligned.iter().zip(gains).filter(|(_, gain)| **gain > 0.0) {
        let value = [V::load(&channel[0]), V::load(&channel[1])];
        powers = power(value).mul_add(V::splat(1.0 / gain), powers);
    }
    over(power(sum), powers)
}

/// One less the scatter about a mean: sqrt(1 - mean^2).
#[inline(always)]
fn less_scatter<V: Vector>(mean_square: V) -> V {
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let rest = one.sub(mean_square);
    one.sub(zero.where_less(rest, rest, zero).sqrt())
}

/// See [`Coherence::Phase`].
#[inline(always)]
fn phase_coherence<V: Vector>(aligned: &[[V::Row; 2]], gains: &[f32]) -> V {
    let mut mean = [V::splat(0.0); 2];
    for (channel, gain) in aligned.iter().zip(gains) {
        let value = [V::load(&channel[0]), V::load(&channel[1])];
        let weight = over(V::splat(*gain), power(value).sqrt());
        mean = [value[0].mul_add(weight, mean[0]), value[1].mul_add(weight, mean[1])];
    }
    less_scatter(power(mean))
}

/// See [`Coherence::Sign`].
#[inline(always)]
fn sign_coherence<V: Vector>(sum: Pair<V>, aligned: &[[V::Row; 2]], gains: &[f32]) -> V {
    let (one, minus_one) = (V::splat(1.0), V::splat(-1.0));
    let length = power(sum).sqrt();
    let mut mean = V::splat(0.0);
    for (channel, gain) in aligned.iter().zip(gains) {
        let value = [V::load(&channel[0]), V::load(&channel[1])];
        let along = value[0].mul_add(sum[0], value[1].mul(sum[1]));
        let cosine = over(along, power(value).sqrt().mul(length)).mul(V::splat(SIGN_STEEPNESS));
        let above = cosine.where_less(one, cosine, one);
        let sign = above.where_less(minus_one, minus_one, above);
        mean = sign.mul_add(V::splat(*gain), mean);
    }
    less_scatter(mean.mul(mean))
}

/// Sum of the products of all different channels, `order` at a time, each channel with its root for amplitude: the elementary symmetric
/// polynomial by Newton's identities.
#[inline(always)]
fn products<V: Vector>(order: usize, scale: &Scale, aligned: &[[V::Row; 2]]) -> V {
    let zero = V::splat(0.0);
    let mut power_sums = [[zero; 2]; ORDER_MAX];
    for channel in aligned {
        let value = [V::load(&channel[0]), V::load(&channel[1])].map(|part| part.mul(V::splat(scale.count)));
        let magnitude = power(value).sqrt();
        let shrunk = over(root(magnitude, order), magnitude);
        let base = [value[0].mul(shrunk), value[1].mul(shrunk)];
        let mut raised = base;
        for (index, sum) in power_sums.iter_mut().enumerate().take(order) {
            if index > 0 {
                raised = times(raised, base);
            }
            *sum = [sum[0].add(raised[0]), sum[1].add(raised[1])];
        }
    }
    // e_k = sum over i of (-1)^(i - 1) e_(k - i) p_i / k, e_0 = 1.
    let mut symmetric = [[zero; 2]; ORDER_MAX + 1];
    symmetric[0] = [V::splat(1.0), zero];
    for k in 1..=order {
        let mut sum = [zero; 2];
        for i in 1..=k {
            let term = times(symmetric[k - i], power_sums[i - 1]);
            let sign = V::splat(if i % 2 == 1 { 1.0 } else { -1.0 });
            sum = [term[0].mul_add(sign, sum[0]), term[1].mul_add(sign, sum[1])];
        }
        symmetric[k] = sum.map(|part| part.mul(V::splat(1.0 / k as f32)));
    }
    power(symmetric[order]).sqrt().mul(V::splat(scale.products))
}

/// The `order`-th root, 1 to 5, of what is not negative: square roots alone come near it, Newton's method does the rest.
#[inline(always)]
fn root<V: Vector>(value: V, order: usize) -> V {
    match order {
        1 => value,
        2 => value.sqrt(),
        4 => value.sqrt().sqrt(),
        3 => {
            // 1/4 + 1/16 + 1/64 = 0.328.
            let quarter = value.sqrt().sqrt();
            let sixteenth = quarter.sqrt().sqrt();
            newton::<V, 3>(value, quarter.mul(sixteenth).mul(sixteenth.sqrt().sqrt()))
        }
        _ => {
            // 1/8 + 1/16 + 1/128 + 1/256 = 0.1992.
            let eighth = value.sqrt().sqrt().sqrt();
            let of_128 = eighth.sqrt().sqrt().sqrt().sqrt();
            newton::<V, 5>(value, eighth.mul(eighth.sqrt()).mul(of_128.mul(of_128.sqrt())))
        }
    }
}

/// Three steps: from 15 % to what f32 holds.
#[inline(always)]
fn newton<V: Vector, const ORDER: usize>(value: V, mut guess: V) -> V {
    let order = ORDER as f32;
    for _ in 0..3 {
        let mut raised = guess;
        for _ in 2..ORDER {
            raised = raised.mul(guess);
        }
        guess = guess.mul(V::splat(order - 1.0)).add(over(value, raised)).mul(V::splat(1.0 / order));
    }
    guess
}

#[cfg(test)]
mod tests {
    use super::super::simd::Plain;
    use super::*;

    #[test]
    fn roots_are_right_to_5e_7_from_a_billionth_to_a_thousand() {
        for order in 1..=ORDER_MAX {
            for step in 0..=120 {
                let value = 10_f64.powf(-9.0 + f64::from(step) / 10.0);
                let mut row = [0.0; 4];
                root::<Plain>(Plain::splat(value as f32), order).store(&mut row);
                let error = f64::from(row[0]) / value.powf(1.0 / order as f64) - 1.0;
                assert!(error.abs() < 5e-7, "order {order} of {value}: {error:e}");
            }
            let mut row = [1.0; 4];
            root::<Plain>(Plain::splat(0.0), order).store(&mut row);
            assert_eq!(row[0], 0.0);
        }
    }
}
