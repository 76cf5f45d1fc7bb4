//! Discrete Fourier transforms of as many signals at once as a vector has lanes, in place.
//!
//! In: `[place][re, im][lane]`, the input of index n at the place that [`Transform::place`] says. Out: the forward transform in
//! natural order. Decimation in time with mixed radices 2, 3, 4, 5 and 7 (Cooley and Tukey 1965): lanes never mix, so there is
//! no shuffling, and blocks are combined as soon as their parts are done, while those are still in the nearest cache. With
//! real and imaginary parts exchanged on the way in and out it is the inverse transform.

use super::aligned::rows_mut;
use super::simd::Vector;
use std::f64::consts::PI;

/// Tables of one length.
#[derive(Debug)]
pub(super) struct Transform {
    len: usize,
    /// Innermost first.
    levels: Vec<Level>,
    places: Vec<u32>,
}

#[derive(Debug)]
struct Level {
    radix: usize,
    /// Length of the parts that it combines.
    part: usize,
    /// `[index in the part][part, without the first]`: exp(-j 2 pi index part / (radix * part)).
    twiddles: Vec<[f32; 2]>,
}

/// The radices of `len`, largest power first so that the innermost level needs the fewest twiddles; `None` if a prime factor above 7 remains.
fn radices(len: usize) -> Option<Vec<usize>> {
    let mut rest = len;
    let mut radices = Vec::new();
    for radix in [7, 5, 4, 3, 2] {
        while rest.is_multiple_of(radix) {
            radices.push(radix);
            rest /= radix;
        }
    }
    (rest == 1).then_some(radices)
}

impl Transform {
    /// Tables for `len` points.
    ///
    /// # Panics
    /// If `len` has a prime factor above 7: the plan chooses no such length.
    pub(super) fn new(len: usize) -> Self {
        let radices = radices(len).unwrap_or_else(|| panic!("{len} has a prime factor above 7"));
        let mut levels = Vec::with_capacity(radices.len());
        let mut places = vec![0_u32];
        let mut part = 1;
        for radix in radices {
            let whole = radix * part;
            let turn = |product: usize| -2.0 * PI * (product % whole) as f64 / whole as f64;
            let twiddle = |(index, q): (usize, usize)| {
                let (sin, cos) = turn(index * q).sin_cos();
                [cos as f32, sin as f32]
            };
            let twiddles = (0..part).flat_map(|index| (1..radix).map(move |q| (index, q))).map(twiddle).collect();
            // Input n of the whole is input n / radix of part n % radix.
            places = (0..whole).map(|n| ((n % radix) * part) as u32 + places[n / radix]).collect();
            levels.push(Level { radix, part, twiddles });
            part = whole;
        }
        Self { len, levels, places }
    }

    /// Where the input of index `n` belongs.
    pub(super) fn place(&self, n: usize) -> usize {
        self.places[n] as usize
    }

    /// Values of a buffer for `lanes` signals.
    pub(super) fn buffer_len(&self, lanes: usize) -> usize {
        2 * self.len * lanes
    }
}

/// Transforms.
#[inline(always)]
pub(super) fn forward<V: Vector>(transform: &Transform, values: &mut [f32]) {
    let data = rows_mut::<V>(values);
    let Some((innermost, outer)) = transform.levels.split_first() else { return };
    for block in 0..transform.len / innermost.radix {
        combine::<V>(innermost, block, data);
        let mut done = block + 1;
        for level in outer {
            if !done.is_multiple_of(level.radix) {
                break;
            }
            done /= level.radix;
            combine::<V>(level, done - 1, data);
        }
    }
}

#[inline(always)]
fn combine<V: Vector>(level: &Level, block: usize, data: &mut [V::Row]) {
    let whole = level.radix * level.part;
    let data = &mut data[2 * whole * block..][..2 * whole];
    match level.radix {
        2 => combine_of::<V, 2>(level, data),
        3 => combine_of::<V, 3>(level, data),
        4 => combine_of::<V, 4>(level, data),
        5 => combine_of::<V, 5>(level, data),
        _ => combine_of::<V, 7>(level, data),
    }
}

#[inline(always)]
fn combine_of<V: Vector, const R: usize>(level: &Level, data: &mut [V::Row]) {
    let count = level.part;
    // Slices of one length each, so that no index needs a check in the loop.
    let mut rest = data.as_chunks_mut::<2>().0;
    let mut parts: [&mut [[V::Row; 2]]; R] = std::array::from_fn(|_| {
        let (first, others) = std::mem::take(&mut rest).split_at_mut(count);
        rest = others;
        first
    });
    let twiddles = &level.twiddles[..count * (R - 1)];
    for index in 0..count {
        let mut x = [[V::splat(0.0); 2]; R];
        for (q, x) in x.iter_mut().enumerate() {
            let [re, im] = &parts[q][index];
            let (re, im) = (V::load(re), V::load(im));
            // Index 0 has no twiddle but 1, which the innermost level is made of.
            *x = if q == 0 || index == 0 {
                [re, im]
            } else {
                let [cos, sin] = twiddles[index * (R - 1) + q - 1].map(V::splat);
                [im.neg_mul_add(sin, re.mul(cos)), im.mul_add(cos, re.mul(sin))]
            };
        }
        for (part, [re, im]) in parts.iter_mut().zip(butterfly::<V, R>(x)) {
            let output = &mut part[index];
            re.store(&mut output[0]);
            im.store(&mut output[1]);
        }
    }
}

type Pair<V> = [V; 2];

#[inline(always)]
fn add<V: Vector>(a: Pair<V>, b: Pair<V>) -> Pair<V> {
    [a[0].add(b[0]), a[1].add(b[1])]
}

#[inline(always)]
fn sub<V: Vector>(a: Pair<V>, b: Pair<V>) -> Pair<V> {
    [a[0].sub(b[0]), a[1].sub(b[1])]
}

/// -j x.
#[inline(always)]
fn turned<V: Vector>(x: Pair<V>) -> Pair<V> {
    [x[1], V::splat(0.0).sub(x[0])]
}

/// The transform of `R` points.
#[inline(always)]
fn butterfly<V: Vector, const R: usize>(x: [Pair<V>; R]) -> [Pair<V>; R] {
    if R == 2 {
        let mut y = x;
        (y[0], y[1]) = (add(x[0], x[1]), sub(x[0], x[1]));
        return y;
    }
    if R == 4 {
        let (even, odd) = ((add(x[0], x[2]), sub(x[0], x[2])), (add(x[1], x[3]), turned(sub(x[1], x[3]))));
        let mut y = x;
        (y[0], y[2]) = (add(even.0, odd.0), sub(even.0, odd.0));
        (y[1], y[3]) = (add(even.1, odd.1), sub(even.1, odd.1));
        return y;
    }
    odd_butterfly::<V, R>(x)
}

/// Cosines and sines of whole parts of a turn, for 3, 5 and 7 parts.
const fn parts<const R: usize>() -> [[f32; 2]; 3] {
    match R {
        3 => [[-0.5, 0.866_025_4], [0.0; 2], [0.0; 2]],
        5 => [[0.309_017, 0.951_056_5], [-0.809_017, 0.587_785_25], [0.0; 2]],
        _ => [[0.623_489_8, 0.781_831_5], [-0.222_520_93, 0.974_927_9], [-0.900_968_85, 0.433_883_74]],
    }
}

/// An odd number of points: inputs k and R - k share cosine and sine, and so do outputs.
#[inline(always)]
fn odd_butterfly<V: Vector, const R: usize>(x: [Pair<V>; R]) -> [Pair<V>; R] {
    let parts = parts::<R>();
    let half = R / 2;
    let mut y = x;
    for k in 1..=half {
        y[0] = add(y[0], add(x[k], x[R - k]));
    }
    for k in 1..=half {
        let (mut even, mut odd) = (x[0], [V::splat(0.0); 2]);
        for n in 1..=half {
            let turn = k * n % R;
            let ([cos, sin], sign) = if turn <= half { (parts[turn - 1], 1.0) } else { (parts[R - turn - 1], -1.0) };
            let (cos, sin) = (V::splat(cos), V::splat(sign * sin));
            let (sum, difference) = (add(x[n], x[R - n]), sub(x[n], x[R - n]));
            even = [sum[0].mul_add(cos, even[0]), sum[1].mul_add(cos, even[1])];
            odd = [difference[0].mul_add(sin, odd[0]), difference[1].mul_add(sin, odd[1])];
        }
        let odd = turned(odd);
        y[k] = add(even, odd);
        y[R - k] = sub(even, odd);
    }
    y
}

#[cfg(test)]
mod tests {
    use super::super::simd::Plain;
    use super::*;

    #[test]
    fn transforms_equal_the_definition_for_every_radix_and_their_products() {
        for len in [1, 2, 3, 4, 5, 7, 8, 12, 21, 30, 35, 60, 64, 105, 140, 420] {
            let transform = Transform::new(len);
            let mut values = vec![0.0_f32; transform.buffer_len(4)];
            let input = |n: usize, lane: usize| {
                let x = (n * 7 + lane * 3) as f64;
                ((x * 0.37).sin(), (x * 0.81).cos())
            };
            for n in 0..len {
                for lane in 0..4 {
                    let row = 2 * transform.place(n) * 4;
                    values[row + lane] = input(n, lane).0 as f32;
                    values[row + 4 + lane] = input(n, lane).1 as f32;
                }
            }
            forward::<Plain>(&transform, &mut values);
            for k in 0..len {
                for lane in 0..4 {
                    let (mut re, mut im) = (0.0, 0.0);
                    for n in 0..len {
                        let (sin, cos) = (-2.0 * PI * (n * k % len) as f64 / len as f64).sin_cos();
                        let (a, b) = input(n, lane);
                        re += a * cos - b * sin;
                        im += a * sin + b * cos;
                    }
                    let found = (f64::from(values[8 * k + lane]), f64::from(values[8 * k + 4 + lane]));
                    let error = (found.0 - re).hypot(found.1 - im);
                    // Measured 1e-6 for 420 points whose largest sum is 200.
                    assert!(error < 1e-6 * (len as f64).max(3.0), "{len} points, output {k}: {error:e}");
                }
            }
        }
    }

    #[test]
    fn a_length_with_a_larger_prime_has_no_radices() {
        assert_eq!(radices(22), None);
        assert_eq!(radices(1250), Some(vec![5, 5, 5, 5, 2]));
    }
}
