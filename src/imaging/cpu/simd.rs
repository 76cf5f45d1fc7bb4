//! Which vector instructions the processor has, one vector type for each set, and the stages' kernels compiled for each.
//!
//! In: an [`InstructionSet`] and the task of a kernel. Out: the same kernel with that set's [`Vector`]. The kernels are plain safe code in
//! the stages' files, written over `Vector`; autovectorised arrays were tried and fell to scalar code at the slightest
//! change. Unsafe code: calls of functions compiled for a set, and the intrinsics inside them.

mod plain;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(super) use plain::Plain;

use super::channel_signal::{self, SignalTask};
use super::delay_and_sum::{self, BeamTask};
use super::demodulate::{self, DemodulateTask};
use super::envelope::{self, EnvelopeTask};
use super::focus::{self, FocusTask};
use super::judge::{self, JudgeTask};
use super::masked_energy::{self, RowTask};
use super::matched_filter::{self, BandPassTask, SpectrumTask};
use super::tile::{self, TileTask};
#[cfg(target_arch = "x86_64")]
use x86::{Avx2, Avx512};

/// A set of vector instructions that the hot loops are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum InstructionSet {
    /// What every processor of this architecture has: SSE2 on x86-64, NEON on ARM64.
    Baseline,
    /// AVX2 and FMA: 8 lanes.
    Avx2,
    /// AVX-512 F, BW, DQ and VL: 16 lanes.
    Avx512,
}

impl InstructionSet {
    /// Every set, plainest first.
    pub const ALL: [InstructionSet; 3] = [InstructionSet::Baseline, InstructionSet::Avx2, InstructionSet::Avx512];

    /// Whether this processor has it.
    #[must_use]
    pub fn is_available(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            match self {
                InstructionSet::Baseline => true,
                InstructionSet::Avx2 => has!("avx2") && has!("fma"),
                InstructionSet::Avx512 => {
                    InstructionSet::Avx2.is_available()
                        && has!("avx512f")
                        && has!("avx512bw")
                        && has!("avx512dq")
                        && has!("avx512vl")
                }
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            self == InstructionSet::Baseline
        }
    }

    /// The largest set that this processor has.
    #[must_use]
    pub fn best() -> Self {
        Self::ALL.into_iter().rev().find(|set| set.is_available()).unwrap_or(InstructionSet::Baseline)
    }

    /// Values in one vector.
    #[must_use]
    pub fn lanes(self) -> usize {
        match self {
            InstructionSet::Baseline => 4,
            InstructionSet::Avx2 => 8,
            InstructionSet::Avx512 => 16,
        }
    }

    /// Bits of one look-up, see [`Vector::lookup`].
    pub(super) fn lookup_bits(self) -> usize {
        match self {
            InstructionSet::Baseline => Plain::LOOKUP_BITS,
            InstructionSet::Avx2 => 3,
            InstructionSet::Avx512 => 4,
        }
    }

    /// Name for people.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            InstructionSet::Baseline if cfg!(target_arch = "aarch64") => "NEON",
            InstructionSet::Baseline if cfg!(target_arch = "x86_64") => "SSE2",
            InstructionSet::Baseline => "baseline",
            InstructionSet::Avx2 => "AVX2",
            InstructionSet::Avx512 => "AVX-512",
        }
    }
}

/// Words of one step of [`Vector::bit_planes`].
pub(super) const PLANE_WORDS: usize = 64;
/// Bits of a word.
pub(super) const PLANES: usize = 32;

/// Several f32 in one register.
///
/// The methods of a type may run only in code that is compiled for its instruction set and on a processor that has it; `dispatch!`,
/// the only place where a type is chosen, sees to both.
pub(super) trait Vector: Copy {
    /// Values in one vector.
    const LANES: usize;
    /// Bits that [`Vector::lookup`] looks at.
    const LOOKUP_BITS: usize;
    /// A vector in memory: `[f32; LANES]`.
    type Row: bytemuck::Pod + AsRef<[f32]> + AsMut<[f32]>;
    /// Zeros in memory.
    const ROW_OF_ZEROS: Self::Row;
    /// All lanes alike.
    fn splat(value: f32) -> Self;
    fn load(row: &Self::Row) -> Self;
    fn store(self, row: &mut Self::Row);
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    /// `self * factor + sum`.
    fn mul_add(self, factor: Self, sum: Self) -> Self;
    /// `sum - self * factor`.
    fn neg_mul_add(self, factor: Self, sum: Self) -> Self;
    /// Lane by lane `then` where `self < limit`, else `otherwise`, also where either is NaN.
    fn where_less(self, limit: Self, then: Self, otherwise: Self) -> Self;
    /// A bit for each lane, from the lowest: whether `self < limit`.
    fn less_bits(self, limit: Self) -> u32;
    /// Sum of all lanes, in a fixed order.
    fn sum(self) -> f32;
    /// Exchanges rows and lanes of the first `LANES` rows.
    fn transpose(rows: &mut [Self::Row]);
    /// `table[word >> shift]` for each lane's word, looking at the lowest `LOOKUP_BITS` bits of the shifted word alone.
    fn lookup(table: &[f32; 16], words: &[u32], shift: u32) -> Self;
    /// Bit k of word n to bit n of plane k.
    fn bit_planes(words: &[u32; PLANE_WORDS], planes: &mut [u64; PLANES]);
}

/// Compiles `$kernel` for every instruction set and chooses among them at run time.
macro_rules! dispatch {
    ($(#[$doc:meta])* $name:ident, $module:ident::$kernel:ident, $task:ty) => {
        $(#[$doc])*
        pub(super) fn $name(set: InstructionSet, task: $task) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
                fn avx512(task: $task) {
                    $module::$kernel::<Avx512>(task);
                }
                #[target_feature(enable = "avx2,fma")]
                fn avx2(task: $task) {
                    $module::$kernel::<Avx2>(task);
                }
                match set {
                    // SAFETY: `CpuBackend::open_with`, the only source of a set, refuses one that `is_available` denies.
                    InstructionSet::Avx512 => return unsafe { avx512(task) },
                    // SAFETY: as above.
                    InstructionSet::Avx2 => return unsafe { avx2(task) },
                    InstructionSet::Baseline => {}
                }
            }
            let _ = set;
            $module::$kernel::<Plain>(task);
        }
    };
}

dispatch!(
    /// Judges channels, see [`judge::judge`].
    judge, judge::judge, JudgeTask<'_>
);
dispatch!(
    /// PDM words to PCM, see [`demodulate::demodulate`].
    demodulate, demodulate::demodulate, DemodulateTask<'_>
);
dispatch!(
    /// PCM side by side, see [`tile::fill`].
    fill, tile::fill, TileTask<'_>
);
dispatch!(
    /// PCM to the decimated band, see [`matched_filter::band_pass`].
    band_pass, matched_filter::band_pass, BandPassTask<'_>
);
dispatch!(
    /// The decimated band to its spectrum, see [`matched_filter::spectrum`].
    spectrum, matched_filter::spectrum, SpectrumTask<'_>
);
dispatch!(
    /// Channels to beams, see [`delay_and_sum::delay_and_sum`].
    delay_and_sum, delay_and_sum::delay_and_sum, BeamTask<'_>
);
dispatch!(
    /// Beams to rows of the image, see [`envelope::envelope`].
    envelope, envelope::envelope, EnvelopeTask<'_, '_>
);
dispatch!(
    /// Channels to their signals, see [`channel_signal::channel_signal`].
    channel_signal, channel_signal::channel_signal, SignalTask<'_>
);
dispatch!(
    /// Signals to near cells of the image, see [`focus::focus`].
    focus, focus::focus, FocusTask<'_, '_>
);
dispatch!(
    /// Sums over a row of the mask table, see [`masked_energy::masked_energy`].
    masked_energy, masked_energy::masked_energy, RowTask<'_>
);

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation lane by lane against plain arithmetic.
    #[inline(always)]
    fn check<V: Vector>() {
        let row = |of: fn(usize) -> f32| {
            let mut row = V::ROW_OF_ZEROS;
            row.as_mut().iter_mut().enumerate().for_each(|(lane, value)| *value = of(lane));
            row
        };
        let (a, b) = (row(|lane| lane as f32 + 0.25), row(|lane| 3.0 - 2.0 * lane as f32));
        let lanes = |value: V| {
            let mut found = V::ROW_OF_ZEROS;
            value.store(&mut found);
            found.as_ref().to_vec()
        };
        let (x, y) = (V::load(&a), V::load(&b));
        let expected =
            |f: fn(f32, f32) -> f32| a.as_ref().iter().zip(b.as_ref()).map(|(a, b)| f(*a, *b)).collect::<Vec<f32>>();
        assert_eq!(lanes(x.add(y)), expected(|a, b| a + b));
        assert_eq!(lanes(x.sub(y)), expected(|a, b| a - b));
        assert_eq!(lanes(x.mul(y)), expected(|a, b| a * b));
        assert_eq!(lanes(x.div(y)), expected(|a, b| a / b));
        assert_eq!(lanes(x.sqrt()), expected(|a, _| a.sqrt()));
        assert_eq!(lanes(y.abs()), expected(|_, b| b.abs()));
        assert_eq!(lanes(x.mul_add(y, V::splat(0.5))), expected(|a, b| a * b + 0.5));
        assert_eq!(lanes(x.neg_mul_add(y, V::splat(0.5))), expected(|a, b| 0.5 - a * b));
        assert_eq!(lanes(x.where_less(y, x, V::splat(-7.0))), expected(|a, b| if a < b { a } else { -7.0 }));
        let nan = V::splat(f32::NAN);
        assert_eq!(lanes(nan.where_less(y, x, V::splat(-7.0))), vec![-7.0; V::LANES]);
        let less = |bits, (lane, (a, b)): (usize, (&f32, &f32))| bits | u32::from(a < b) << lane;
        assert_eq!(x.less_bits(y), a.as_ref().iter().zip(b.as_ref()).enumerate().fold(0, less));
        assert_eq!((nan.less_bits(y), y.less_bits(nan)), (0, 0));
        assert_eq!(x.sum(), a.as_ref().iter().sum::<f32>());
    }

    /// Whatever moves values between lanes, against indices.
    #[inline(always)]
    fn check_moves<V: Vector>() {
        let mut square = vec![V::ROW_OF_ZEROS; V::LANES];
        for (index, row) in square.iter_mut().enumerate() {
            row.as_mut().iter_mut().enumerate().for_each(|(lane, value)| *value = (100 * index + lane) as f32);
        }
        V::transpose(&mut square);
        for (index, row) in square.iter().enumerate() {
            for (lane, value) in row.as_ref().iter().enumerate() {
                assert_eq!(*value, (100 * lane + index) as f32, "row {index}, lane {lane}");
            }
        }

        let table: [f32; 16] = std::array::from_fn(|index| index as f32);
        let random = |index: u32| (index + 1).wrapping_mul(2_654_435_761).rotate_left(index % 31);
        let words: Vec<u32> = (0..V::LANES as u32).map(random).collect();
        for shift in 0..28 {
            let mut found = V::ROW_OF_ZEROS;
            V::lookup(&table, &words, shift).store(&mut found);
            for (value, word) in found.as_ref().iter().zip(&words) {
                assert_eq!(*value, (word >> shift & ((1 << V::LOOKUP_BITS) - 1)) as f32, "shift {shift}");
            }
        }

        let words: [u32; PLANE_WORDS] = std::array::from_fn(|index| random(index as u32));
        let mut planes = [0; PLANES];
        V::bit_planes(&words, &mut planes);
        for (bit, plane) in planes.iter().enumerate() {
            for (index, word) in words.iter().enumerate() {
                assert_eq!(plane >> index & 1, u64::from(word >> bit & 1), "bit {bit} of word {index}");
            }
        }
    }

    #[test]
    fn every_vector_type_computes_lane_by_lane() {
        check::<Plain>();
        check_moves::<Plain>();
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
            fn avx512() {
                check::<Avx512>();
                check_moves::<Avx512>();
            }
            #[target_feature(enable = "avx2,fma")]
            fn avx2() {
                check::<Avx2>();
                check_moves::<Avx2>();
            }
            if InstructionSet::Avx2.is_available() {
                // SAFETY: the processor was asked.
                unsafe { avx2() }
            }
            if InstructionSet::Avx512.is_available() {
                // SAFETY: the processor was asked.
                unsafe { avx512() }
            }
        }
    }
}
