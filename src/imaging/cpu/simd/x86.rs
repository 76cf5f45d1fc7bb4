//! Eight (AVX2 and FMA) and sixteen (AVX-512) lanes on x86-64.
//!
//! In and out: as [`Vector`]. Every method is one or a few intrinsics; chosen only by the dispatch in the parent module.

use super::{PLANE_WORDS, PLANES, Vector};
use std::arch::x86_64::*;

// SAFETY, for every `unsafe` of this file: the intrinsics need the instruction set, which holds wherever these methods run (see
// `Vector`); loads and stores touch rows or arrays of exactly the register's length and need no alignment.
macro_rules! x86_vector {
    ($name:ident, $register:ty, $lanes:literal, bits $lookup_bits:literal, $set1:ident, $loadu:ident, $storeu:ident, $add:ident, $sub:ident,
     $mul:ident, $div:ident, $sqrt:ident, $fmadd:ident, $fnmadd:ident, |$abs:ident| $abs_of:expr,
     |$a:ident, $b:ident, $then:ident, $otherwise:ident| $where_less:expr, |$c:ident, $d:ident| $less_bits:expr, |$summed:ident| $sum:expr,
     $transpose:ident, $lookup:ident, $planes:ident) => {
        #[derive(Clone, Copy)]
        pub(in super::super) struct $name($register);

        impl Vector for $name {
            const LANES: usize = $lanes;
            const LOOKUP_BITS: usize = $lookup_bits;
            type Row = [f32; $lanes];
            const ROW_OF_ZEROS: [f32; $lanes] = [0.0; $lanes];

            #[inline(always)]
            fn splat(value: f32) -> Self {
                Self(unsafe { $set1(value) })
            }
            #[inline(always)]
            fn load(row: &[f32; $lanes]) -> Self {
                Self(unsafe { $loadu(row.as_ptr()) })
            }
            #[inline(always)]
            fn store(self, row: &mut [f32; $lanes]) {
                unsafe { $storeu(row.as_mut_ptr(), self.0) }
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
            fn div(self, other: Self) -> Self {
                Self(unsafe { $div(self.0, other.0) })
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                Self(unsafe { $sqrt(self.0) })
            }
            #[inline(always)]
            fn abs(self) -> Self {
                let $abs = self.0;
                Self(unsafe { $abs_of })
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, sum: Self) -> Self {
                Self(unsafe { $fmadd(self.0, factor.0, sum.0) })
            }
            #[inline(always)]
            fn neg_mul_add(self, factor: Self, sum: Self) -> Self {
                Self(unsafe { $fnmadd(self.0, factor.0, sum.0) })
            }
            #[inline(always)]
            fn where_less(self, limit: Self, then: Self, otherwise: Self) -> Self {
                let ($a, $b, $then, $otherwise) = (self.0, limit.0, then.0, otherwise.0);
                Self(unsafe { $where_less })
            }
            #[inline(always)]
            fn less_bits(self, limit: Self) -> u32 {
                let ($c, $d) = (self.0, limit.0);
                unsafe { $less_bits }
            }
            #[inline(always)]
            fn sum(self) -> f32 {
                let $summed = self.0;
                unsafe { $sum }
            }
            #[inline(always)]
            fn transpose(rows: &mut [[f32; $lanes]]) {
                let Some(rows) = rows.first_chunk_mut::<$lanes>() else { return };
                unsafe { $transpose(rows) }
            }
            #[inline(always)]
            fn lookup(table: &[f32; 16], words: &[u32], shift: u32) -> Self {
                let words = &words[..$lanes];
                Self(unsafe { $lookup(table.as_ptr(), words.as_ptr(), shift) })
            }
            #[inline(always)]
            fn bit_planes(words: &[u32; PLANE_WORDS], planes: &mut [u64; PLANES]) {
                unsafe { $planes(words, planes) }
            }
        }
    };
}

x86_vector!(
    Avx512,
    __m512,
    16,
    bits 4,
    _mm512_set1_ps,
    _mm512_loadu_ps,
    _mm512_storeu_ps,
    _mm512_add_ps,
    _mm512_sub_ps,
    _mm512_mul_ps,
    _mm512_div_ps,
    _mm512_sqrt_ps,
    _mm512_fmadd_ps,
    _mm512_fnmadd_ps,
    |value| _mm512_abs_ps(value),
    |a, b, then, otherwise| _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b), otherwise, then),
    |a, b| u32::from(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b)),
    |value| _mm512_reduce_add_ps(value),
    transpose_avx512,
    lookup_avx512,
    planes_avx512
);

x86_vector!(
    Avx2,
    __m256,
    8,
    bits 3,
    _mm256_set1_ps,
    _mm256_loadu_ps,
    _mm256_storeu_ps,
    _mm256_add_ps,
    _mm256_sub_ps,
    _mm256_mul_ps,
    _mm256_div_ps,
    _mm256_sqrt_ps,
    _mm256_fmadd_ps,
    _mm256_fnmadd_ps,
    |value| _mm256_andnot_ps(_mm256_set1_ps(-0.0), value),
    |a, b, then, otherwise| _mm256_blendv_ps(otherwise, then, _mm256_cmp_ps::<_CMP_LT_OQ>(a, b)),
    |a, b| _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(a, b)) as u32,
    |value| {
        let half = _mm_add_ps(_mm256_castps256_ps128(value), _mm256_extractf128_ps::<1>(value));
        let quarter = _mm_add_ps(half, _mm_movehl_ps(half, half));
        _mm_cvtss_f32(_mm_add_ss(quarter, _mm_shuffle_ps::<1>(quarter, quarter)))
    },
    transpose_avx2,
    lookup_avx2,
    planes_avx2
);

#[inline(always)]
unsafe fn lookup_avx512(table: *const f32, words: *const u32, shift: u32) -> __m512 {
    unsafe {
        let index = _mm512_srl_epi32(_mm512_loadu_si512(words.cast()), _mm_cvtsi32_si128(shift as i32));
        // The permutation looks at the low four bits alone.
        _mm512_permutexvar_ps(index, _mm512_loadu_ps(table))
    }
}

#[inline(always)]
unsafe fn lookup_avx2(table: *const f32, words: *const u32, shift: u32) -> __m256 {
    unsafe {
        let index = _mm256_srl_epi32(_mm256_loadu_si256(words.cast()), _mm_cvtsi32_si128(shift as i32));
        // The permutation looks at the low three bits alone.
        _mm256_permutevar8x32_ps(_mm256_loadu_ps(table), index)
    }
}

/// Pairs, then quads, then whole quarters of the registers change places.
#[inline(always)]
unsafe fn transpose_avx512(rows: &mut [[f32; 16]; 16]) {
    unsafe {
        let mut a = [_mm512_setzero_ps(); 16];
        let mut b = a;
        for (register, row) in a.iter_mut().zip(rows.iter()) {
            *register = _mm512_loadu_ps(row.as_ptr());
        }
        for i in 0..8 {
            b[2 * i] = _mm512_unpacklo_ps(a[2 * i], a[2 * i + 1]);
            b[2 * i + 1] = _mm512_unpackhi_ps(a[2 * i], a[2 * i + 1]);
        }
        for i in 0..4 {
            a[4 * i] = _mm512_shuffle_ps::<0x44>(b[4 * i], b[4 * i + 2]);
            a[4 * i + 1] = _mm512_shuffle_ps::<0xee>(b[4 * i], b[4 * i + 2]);
            a[4 * i + 2] = _mm512_shuffle_ps::<0x44>(b[4 * i + 1], b[4 * i + 3]);
            a[4 * i + 3] = _mm512_shuffle_ps::<0xee>(b[4 * i + 1], b[4 * i + 3]);
        }
        for i in 0..4 {
            b[i] = _mm512_shuffle_f32x4::<0x88>(a[i], a[i + 4]);
            b[i + 4] = _mm512_shuffle_f32x4::<0xdd>(a[i], a[i + 4]);
            b[i + 8] = _mm512_shuffle_f32x4::<0x88>(a[i + 8], a[i + 12]);
            b[i + 12] = _mm512_shuffle_f32x4::<0xdd>(a[i + 8], a[i + 12]);
        }
        for i in 0..4 {
            a[i] = _mm512_shuffle_f32x4::<0x88>(b[i], b[i + 8]);
            a[i + 8] = _mm512_shuffle_f32x4::<0xdd>(b[i], b[i + 8]);
            a[i + 4] = _mm512_shuffle_f32x4::<0x88>(b[i + 4], b[i + 12]);
            a[i + 12] = _mm512_shuffle_f32x4::<0xdd>(b[i + 4], b[i + 12]);
        }
        for (register, row) in a.iter().zip(rows.iter_mut()) {
            _mm512_storeu_ps(row.as_mut_ptr(), *register);
        }
    }
}

#[inline(always)]
unsafe fn transpose_avx2(rows: &mut [[f32; 8]; 8]) {
    unsafe {
        let mut a = [_mm256_setzero_ps(); 8];
        let mut b = a;
        for (register, row) in a.iter_mut().zip(rows.iter()) {
            *register = _mm256_loadu_ps(row.as_ptr());
        }
        for i in 0..4 {
            b[2 * i] = _mm256_unpacklo_ps(a[2 * i], a[2 * i + 1]);
            b[2 * i + 1] = _mm256_unpackhi_ps(a[2 * i], a[2 * i + 1]);
        }
        for i in 0..2 {
            a[4 * i] = _mm256_shuffle_ps::<0x44>(b[4 * i], b[4 * i + 2]);
            a[4 * i + 1] = _mm256_shuffle_ps::<0xee>(b[4 * i], b[4 * i + 2]);
            a[4 * i + 2] = _mm256_shuffle_ps::<0x44>(b[4 * i + 1], b[4 * i + 3]);
            a[4 * i + 3] = _mm256_shuffle_ps::<0xee>(b[4 * i + 1], b[4 * i + 3]);
        }
        for i in 0..4 {
            b[i] = _mm256_permute2f128_ps::<0x20>(a[i], a[i + 4]);
            b[i + 4] = _mm256_permute2f128_ps::<0x31>(a[i], a[i + 4]);
        }
        for (register, row) in b.iter().zip(rows.iter_mut()) {
            _mm256_storeu_ps(row.as_mut_ptr(), *register);
        }
    }
}

/// Bytes of equal place in their words together, word after word, for words in the four quarters of a register each.
const BYTES_BY_PLACE: [u8; 16] = [0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15];

/// The highest bits of 64 bytes are one plane; seven shifts bring the others up.
#[inline(always)]
unsafe fn planes_avx512(words: &[u32; PLANE_WORDS], planes: &mut [u64; PLANES]) {
    unsafe {
        let by_place = _mm512_broadcast_i32x4(_mm_loadu_si128(BYTES_BY_PLACE.as_ptr().cast()));
        let quarters = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
        let mut sorted = [_mm512_setzero_si512(); 4];
        for (register, words) in sorted.iter_mut().zip(words.as_chunks::<16>().0) {
            let loaded = _mm512_loadu_si512(words.as_ptr().cast());
            // Now 16 bytes of place 0, 16 of place 1 and so on.
            *register = _mm512_permutexvar_epi32(quarters, _mm512_shuffle_epi8(loaded, by_place));
        }
        let [a, b, c, d] = sorted;
        let (low, high) = (_mm512_shuffle_i32x4::<0x44>(a, b), _mm512_shuffle_i32x4::<0x44>(c, d));
        let (low_2, high_2) = (_mm512_shuffle_i32x4::<0xee>(a, b), _mm512_shuffle_i32x4::<0xee>(c, d));
        let places = [
            _mm512_shuffle_i32x4::<0x88>(low, high),
            _mm512_shuffle_i32x4::<0xdd>(low, high),
            _mm512_shuffle_i32x4::<0x88>(low_2, high_2),
            _mm512_shuffle_i32x4::<0xdd>(low_2, high_2),
        ];
        for (mut bytes, planes) in places.into_iter().zip(planes.as_chunks_mut::<8>().0) {
            for plane in planes.iter_mut().rev() {
                *plane = _mm512_movepi8_mask(bytes);
                bytes = _mm512_add_epi8(bytes, bytes);
            }
        }
    }
}

#[inline(always)]
unsafe fn planes_avx2(words: &[u32; PLANE_WORDS], planes: &mut [u64; PLANES]) {
    unsafe {
        let by_place = _mm256_broadcastsi128_si256(_mm_loadu_si128(BYTES_BY_PLACE.as_ptr().cast()));
        let halves = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
        planes.fill(0);
        for (half, words) in words.as_chunks::<32>().0.iter().enumerate() {
            let mut sorted = [_mm256_setzero_si256(); 4];
            for (register, words) in sorted.iter_mut().zip(words.as_chunks::<8>().0) {
                let loaded = _mm256_loadu_si256(words.as_ptr().cast());
                // Now 8 bytes of place 0, 8 of place 1 and so on.
                *register = _mm256_permutevar8x32_epi32(_mm256_shuffle_epi8(loaded, by_place), halves);
            }
            let [a, b, c, d] = sorted;
            let (even_low, even_high) = (_mm256_unpacklo_epi64(a, b), _mm256_unpacklo_epi64(c, d));
            let (odd_low, odd_high) = (_mm256_unpackhi_epi64(a, b), _mm256_unpackhi_epi64(c, d));
            let places = [
                _mm256_permute2x128_si256::<0x20>(even_low, even_high),
                _mm256_permute2x128_si256::<0x20>(odd_low, odd_high),
                _mm256_permute2x128_si256::<0x31>(even_low, even_high),
                _mm256_permute2x128_si256::<0x31>(odd_low, odd_high),
            ];
            for (mut bytes, planes) in places.into_iter().zip(planes.as_chunks_mut::<8>().0) {
                for plane in planes.iter_mut().rev() {
                    *plane |= u64::from(_mm256_movemask_epi8(bytes) as u32) << (32 * half);
                    bytes = _mm256_add_epi8(bytes, bytes);
                }
            }
        }
    }
}
