//! The rules of combining aligned channels by their definitions in f64, slow and plain. Shares no code with `src`.

use super::oracle::{Complex, Fault, band_spectra, focused_blocks, sooner_m};
use super::scenes::{Case, SPEED_OF_SOUND_M_S};
use noctule::imaging::plan::ImagingPlan;
use std::f64::consts::PI;

/// What every channel adds to every cell, `[direction][range][channel]`: its matched filter's analytic signal where the exact path of the
/// cell's block ends, `offset` ranges farther, with a weight on every frequency.
pub fn aligned(
    case: &Case,
    plan: &ImagingPlan,
    samples: &[Vec<f64>],
    gains: &[f32],
    offset: f64,
    share: &dyn Fn(f64) -> f64,
) -> Vec<Vec<Complex>> {
    let (mut spectra, bin_hz, first_bin) = band_spectra(case, plan, samples, gains);
    for spectrum in &mut spectra {
        for (k, value) in spectrum.iter_mut().enumerate() {
            *value = value.scaled(share((first_bin + k) as f64 * bin_hz));
        }
    }
    let mut cells = Vec::new();
    for direction in 0..case.directions.len() {
        for (block_m, ranges) in focused_blocks(plan) {
            for range in ranges {
                let range_m = plan.grid.range_first_m() + (range as f64 + offset) * plan.grid.range_step_m();
                let value = |(channel, spectrum): (usize, &Vec<Complex>)| {
                    let sooner = sooner_m(case, 0, channel, direction, block_m, Fault::None);
                    sum_at(spectrum, first_bin, bin_hz, (2.0 * range_m - sooner) / SPEED_OF_SOUND_M_S)
                };
                cells.push(spectra.iter().enumerate().map(value).collect());
            }
        }
    }
    cells
}

/// Sum of a spectrum's bins at a time.
fn sum_at(spectrum: &[Complex], first_bin: usize, bin_hz: f64, time_s: f64) -> Complex {
    let step = Complex::turn(2.0 * PI * bin_hz * time_s);
    let mut sum = Complex::default();
    for (block, values) in spectrum.chunks(64).enumerate() {
        let mut phase = Complex::turn(2.0 * PI * ((first_bin + 64 * block) as f64 * bin_hz * time_s).fract());
        for value in values {
            sum = sum.plus(value.times(phase));
            phase = phase.times(step);
        }
    }
    sum
}

/// Share of a frequency in one of `count` sub-bands of the plan's band: cosine-squared flanks from middle to middle.
pub fn sub_band_share(plan: &ImagingPlan, sub_band: usize, count: usize, frequency_hz: f64) -> f64 {
    let bin = frequency_hz / plan.bin_step_hz - plan.first_bin as f64;
    let place = ((bin + 0.5) / plan.bin_count as f64 * count as f64 - 0.5).clamp(0.0, count as f64 - 1.0);
    let distance = (place - sub_band as f64).abs();
    if distance < 1.0 { (0.5 * PI * distance).cos().powi(2) } else { 0.0 }
}

/// Minimum variance by its definition: w = R^-1 1 / (1^H R^-1 1), R the sum of s s^H over the snapshots and a load of `loading` times the mean
/// power of a channel; the output w^H s for the middle snapshot. R is solved by elimination, whatever its rank.
pub fn minimum_variance(snapshots: &[Vec<Complex>], loading: f64) -> Complex {
    let count = snapshots[0].len();
    let trace: f64 = snapshots.iter().flatten().map(|value| value.magnitude().powi(2)).sum();
    if trace == 0.0 {
        return Complex::default();
    }
    let mut rows: Vec<Vec<Complex>> = (0..count)
        .map(|row| {
            let entry = |column: usize| {
                let sum = snapshots
                    .iter()
                    .map(|s| s[row].times(s[column].conjugate()))
                    .fold(Complex::default(), Complex::plus);
                let load = if row == column { loading * trace / count as f64 } else { 0.0 };
                sum.plus(Complex { re: load, im: 0.0 })
            };
            (0..count).map(entry).chain([Complex { re: 1.0, im: 0.0 }]).collect()
        })
        .collect();
    for pivot in 0..count {
        let inverse = rows[pivot][pivot].conjugate().scaled(1.0 / rows[pivot][pivot].magnitude().powi(2));
        let top: Vec<Complex> = rows[pivot].iter().map(|value| value.times(inverse)).collect();
        for (index, row) in rows.iter_mut().enumerate() {
            let factor = if index == pivot { continue } else { row[pivot].scaled(-1.0) };
            row.iter_mut().zip(&top).for_each(|(value, top)| *value = value.plus(top.times(factor)));
        }
        rows[pivot] = top;
    }
    let weights: Vec<Complex> = rows.iter().map(|row| row[count]).collect();
    let whole = weights.iter().copied().fold(Complex::default(), Complex::plus).re;
    let middle = &snapshots[snapshots.len() / 2];
    let output =
        weights.iter().zip(middle).map(|(w, s)| w.conjugate().times(*s)).fold(Complex::default(), Complex::plus);
    output.scaled(1.0 / whole)
}

/// Delay-multiply-and-sum by its definition: the sum over all sets of `order` different channels of their product, each with its root
/// for amplitude; over what a coherent echo of amplitude 1 would give. `values` are weighted by `gains`.
pub fn multiplied(values: &[Complex], gains: &[f32], order: usize) -> f64 {
    fn sum(values: &[Complex], order: usize, product: Complex) -> Complex {
        if order == 0 {
            return product;
        }
        let each = (0..values.len()).map(|index| sum(&values[index + 1..], order - 1, product.times(values[index])));
        each.fold(Complex::default(), Complex::plus)
    }
    let rooted = |value: &Complex| {
        let magnitude = value.magnitude();
        if magnitude == 0.0 { *value } else { value.scaled(magnitude.powf(1.0 / order as f64 - 1.0)) }
    };
    let one = Complex { re: 1.0, im: 0.0 };
    let found: Vec<Complex> = values.iter().map(rooted).collect();
    let unit: Vec<Complex> = gains.iter().map(|gain| rooted(&one.scaled(f64::from(*gain)))).collect();
    sum(&found, order, one).magnitude() / sum(&unit, order, one).magnitude()
}

/// Coherence factors by their definitions, of values weighted by `gains`, whose sum is 1: amplitude, phase, sign.
pub fn coherences(values: &[Complex], gains: &[f32]) -> [f64; 3] {
    let used: Vec<(Complex, f64)> = values
        .iter()
        .zip(gains)
        .filter(|(_, gain)| **gain > 0.0)
        .map(|(value, gain)| (value.scaled(1.0 / f64::from(*gain)), f64::from(*gain)))
        .collect();
    let mean = |of: &dyn Fn(Complex) -> Complex| {
        used.iter().map(|(value, weight)| of(*value).scaled(*weight)).fold(Complex::default(), Complex::plus)
    };
    let sum = mean(&|value| value);
    let power = mean(&|value| Complex { re: value.magnitude().powi(2), im: 0.0 }).re;
    let phasor = mean(&|value| value.scaled(1.0 / value.magnitude()));
    let sign = mean(&|value| {
        let cosine = value.times(sum.conjugate()).re / (value.magnitude() * sum.magnitude());
        Complex { re: (8.0 * cosine).clamp(-1.0, 1.0), im: 0.0 }
    });
    let scatter = |mean: Complex| (1.0 - mean.magnitude().powi(2)).max(0.0).sqrt();
    [sum.magnitude().powi(2) / power, 1.0 - scatter(phasor), 1.0 - scatter(sign)]
}
