//! Which vector instructions the processor has, one vector type for each set, and the stages' kernels compiled for each.
//!
//! In: an [`InstructionSet`] and the task of a kernel. Out: the same kernel with that set's [`Vector`]. The kernels are plain safe code in
//! the stages' files, written over `Vector`; autovectorised arrays were tried and fell to scalar code at the slightest
//! change. All unsafe code of the imaging is here: calls of functions compiled for a set, and the intrinsics inside them.

use super::delay_and_sum::{self, BeamTask};
use super::demodulate::{self, DemodulateTask};
use super::envelope::{self, EnvelopeTask};
use super::masked_energy::{self, GainTask};
use super::matched_filter::{self, BandPassTask};
#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

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

/// Several f32 in one register.
///
/// The methods of a type may run only in code that is compiled for its instruction set and on a processor that has it; `dispatch!`,
/// the only place where a type is chosen, sees to both.
pub(super) trait Vector: Copy {
    /// Values in one vector.
    const LANES: usize;
    /// Whether [`Vector::mul_add`] is fused; kernels that work value by value ask it too.
    const FMA: bool;
    /// All lanes alike.
    fn splat(value: f32) -> Self;
    /// The first [`Vector::LANES`] values. Panics if there are fewer.
    fn load(values: &[f32]) -> Self;
    /// Writes the first [`Vector::LANES`] values. Panics if there is no room.
    fn store(self, values: &mut [f32]);
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    /// `self * factor + sum`.
    fn mul_add(self, factor: Self, sum: Self) -> Self;
    /// Adds `other` in the lanes whose bit, from the lowest, is set.
    fn add_where(self, bits: u32, other: Self) -> Self;
    /// Sum of all lanes, in a fixed order.
    fn sum(self) -> f32;
}

/// `a * b + c`, fused where the vectors are, since elsewhere it would be a function call.
#[inline(always)]
pub(super) fn multiply_add<V: Vector>(a: f32, b: f32, c: f32) -> f32 {
    if V::FMA { a.mul_add(b, c) } else { a * b + c }
}

/// Four lanes, which every compiler turns into the registers of its architecture.
#[derive(Clone, Copy)]
#[repr(align(16))]
pub(super) struct Plain([f32; 4]);

impl Vector for Plain {
    const LANES: usize = 4;
    const FMA: bool = cfg!(any(target_arch = "aarch64", target_feature = "fma"));
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; 4])
    }
    #[inline(always)]
    fn load(values: &[f32]) -> Self {
        Self([values[0], values[1], values[2], values[3]])
    }
    #[inline(always)]
    fn store(self, values: &mut [f32]) {
        values[..4].copy_from_slice(&self.0);
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let ([a, b, c, d], [e, f, g, h]) = (self.0, other.0);
        Self([a + e, b + f, c + g, d + h])
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let ([a, b, c, d], [e, f, g, h]) = (self.0, other.0);
        Self([a - e, b - f, c - g, d - h])
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let ([a, b, c, d], [e, f, g, h]) = (self.0, other.0);
        Self([a * e, b * f, c * g, d * h])
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, sum: Self) -> Self {
        if Self::FMA {
            let ([a, b, c, d], [e, f, g, h], [i, j, k, l]) = (self.0, factor.0, sum.0);
            Self([a.mul_add(e, i), b.mul_add(f, j), c.mul_add(g, k), d.mul_add(h, l)])
        } else {
            self.mul(factor).add(sum)
        }
    }
    #[inline(always)]
    fn add_where(self, bits: u32, other: Self) -> Self {
        // A bit spread over a whole word lets the value through or not, without a branch.
        let masked = |lane: usize| {
            let spread = ((bits << (31 - lane)) as i32 >> 31) as u32;
            f32::from_bits(other.0[lane].to_bits() & spread)
        };
        self.add(Self([masked(0), masked(1), masked(2), masked(3)]))
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        let [a, b, c, d] = self.0;
        (a + c) + (b + d)
    }
}

// SAFETY, for every `unsafe` of the two types below: the intrinsics need the instruction set, which holds wherever these methods run (see
// `Vector`); loads and stores touch `LANES` values of a slice that was cut to that length first, and need no alignment.
#[cfg(target_arch = "x86_64")]
macro_rules! x86_vector {
    ($name:ident, $register:ty, $lanes:literal, $set1:ident, $loadu:ident, $storeu:ident, $add:ident, $sub:ident, $mul:ident,
     $fmadd:ident, |$this:ident, $bits:ident, $other:ident| $add_where:expr, |$summed:ident| $sum:expr) => {
        #[derive(Clone, Copy)]
        pub(super) struct $name($register);

        impl Vector for $name {
            const LANES: usize = $lanes;
            const FMA: bool = true;
            #[inline(always)]
            fn splat(value: f32) -> Self {
                Self(unsafe { $set1(value) })
            }
            #[inline(always)]
            fn load(values: &[f32]) -> Self {
                Self(unsafe { $loadu(values[..$lanes].as_ptr()) })
            }
            #[inline(always)]
            fn store(self, values: &mut [f32]) {
                unsafe { $storeu(values[..$lanes].as_mut_ptr(), self.0) }
            }
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                Self(unsafe { $add(self.0, other.0) })
            }
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                Self(unsafe { $sub(self.0, other.0) })
            }
            #[inline(always)]
            fn mul(self, other: Self) -> Self {
                Self(unsafe { $mul(self.0, other.0) })
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, sum: Self) -> Self {
                Self(unsafe { $fmadd(self.0, factor.0, sum.0) })
            }
            #[inline(always)]
            fn add_where(self, $bits: u32, $other: Self) -> Self {
                let $this = self;
                Self(unsafe { $add_where })
            }
            #[inline(always)]
            fn sum(self) -> f32 {
                let $summed = self;
                unsafe { $sum }
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
x86_vector!(
    Avx512,
    __m512,
    16,
    _mm512_set1_ps,
    _mm512_loadu_ps,
    _mm512_storeu_ps,
    _mm512_add_ps,
    _mm512_sub_ps,
    _mm512_mul_ps,
    _mm512_fmadd_ps,
    |this, bits, other| _mm512_mask_add_ps(this.0, bits as __mmask16, this.0, other.0),
    |this| _mm512_reduce_add_ps(this.0)
);

#[cfg(target_arch = "x86_64")]
x86_vector!(
    Avx2,
    __m256,
    8,
    _mm256_set1_ps,
    _mm256_loadu_ps,
    _mm256_storeu_ps,
    _mm256_add_ps,
    _mm256_sub_ps,
    _mm256_mul_ps,
    _mm256_fmadd_ps,
    |this, bits, other| {
        let lane_bits = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
        let set = _mm256_and_si256(_mm256_set1_epi32(bits as i32), lane_bits);
        let mask = _mm256_castsi256_ps(_mm256_cmpeq_epi32(set, lane_bits));
        _mm256_add_ps(this.0, _mm256_and_ps(mask, other.0))
    },
    |this| {
        let half = _mm_add_ps(_mm256_castps256_ps128(this.0), _mm256_extractf128_ps::<1>(this.0));
        let quarter = _mm_add_ps(half, _mm_movehl_ps(half, half));
        _mm_cvtss_f32(_mm_add_ss(quarter, _mm_shuffle_ps::<1>(quarter, quarter)))
    }
);

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
    /// PDM words to PCM, see [`demodulate::demodulate`].
    demodulate, demodulate::demodulate, DemodulateTask<'_>
);
dispatch!(
    /// PCM to the decimated band, see [`matched_filter::band_pass`].
    band_pass, matched_filter::band_pass, BandPassTask<'_>
);
dispatch!(
    /// Channels to beams, see [`delay_and_sum::delay_and_sum`].
    delay_and_sum, delay_and_sum::delay_and_sum, BeamTask<'_>
);
dispatch!(
    /// Magnitude and smoothing, see [`envelope::magnitude`].
    magnitude, envelope::magnitude, EnvelopeTask<'_>
);
dispatch!(
    /// Range gain and noise floor, see [`masked_energy::gained`].
    gained, masked_energy::gained, GainTask<'_>
);

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation lane by lane against plain arithmetic.
    #[inline(always)]
    fn check<V: Vector>() {
        let a: Vec<f32> = (0..V::LANES).map(|lane| lane as f32 + 0.25).collect();
        let b: Vec<f32> = (0..V::LANES).map(|lane| 3.0 - 2.0 * lane as f32).collect();
        let mut found = vec![0.0; V::LANES];
        let mut lanes = |value: V| {
            value.store(&mut found);
            found.clone()
        };
        let (x, y) = (V::load(&a), V::load(&b));
        let expected = |f: fn(f32, f32) -> f32| a.iter().zip(&b).map(|(a, b)| f(*a, *b)).collect::<Vec<f32>>();
        assert_eq!(lanes(x.add(y)), expected(|a, b| a + b));
        assert_eq!(lanes(x.sub(y)), expected(|a, b| a - b));
        assert_eq!(lanes(x.mul(y)), expected(|a, b| a * b));
        assert_eq!(lanes(x.mul_add(y, V::splat(0.5))), expected(|a, b| a * b + 0.5));
        for bits in [0, 1, 0b1010, 0x8421, u32::MAX] {
            let sum = |lane: usize| if bits >> lane & 1 == 1 { a[lane] + b[lane] } else { a[lane] };
            assert_eq!(lanes(x.add_where(bits, y)), (0..V::LANES).map(sum).collect::<Vec<f32>>());
        }
        assert_eq!(x.sum(), a.iter().sum::<f32>());
    }

    #[test]
    fn every_vector_type_computes_lane_by_lane() {
        check::<Plain>();
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
            fn avx512() {
                check::<Avx512>();
            }
            #[target_feature(enable = "avx2,fma")]
            fn avx2() {
                check::<Avx2>();
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
