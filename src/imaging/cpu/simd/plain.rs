//! Four lanes in plain Rust, which every compiler turns into the registers of its architecture: SSE2, NEON.
//!
//! In and out: as [`Vector`]. No unsafe code and no assumption about the processor.

use super::{PLANE_WORDS, PLANES, Vector};

/// Four lanes.
#[derive(Clone, Copy)]
#[repr(align(16))]
pub(in super::super) struct Plain([f32; 4]);

impl Plain {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let ([a, b, c, d], [e, f_, g, h]) = (self.0, other.0);
        Self([f(a, e), f(b, f_), f(c, g), f(d, h)])
    }
}

impl Vector for Plain {
    const LANES: usize = 4;
    const LOOKUP_BITS: usize = 4;
    type Row = [f32; 4];
    const ROW_OF_ZEROS: [f32; 4] = [0.0; 4];

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; 4])
    }
    #[inline(always)]
    fn load(row: &[f32; 4]) -> Self {
        Self(*row)
    }
    #[inline(always)]
    fn store(self, row: &mut [f32; 4]) {
        *row = self.0;
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.map(f32::abs))
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, sum: Self) -> Self {
        // Fused only where that is one instruction: elsewhere it would be a function call.
        if cfg!(target_arch = "aarch64") {
            let ([a, b, c, d], [e, f, g, h], [i, j, k, l]) = (self.0, factor.0, sum.0);
            Self([a.mul_add(e, i), b.mul_add(f, j), c.mul_add(g, k), d.mul_add(h, l)])
        } else {
            self.mul(factor).add(sum)
        }
    }
    #[inline(always)]
    fn neg_mul_add(self, factor: Self, sum: Self) -> Self {
        if cfg!(target_arch = "aarch64") {
            Self(self.0.map(|value| -value)).mul_add(factor, sum)
        } else {
            sum.sub(self.mul(factor))
        }
    }
    #[inline(always)]
    fn where_less(self, limit: Self, then: Self, otherwise: Self) -> Self {
        Self(std::array::from_fn(|lane| if self.0[lane] < limit.0[lane] { then.0[lane] } else { otherwise.0[lane] }))
    }
    #[inline(always)]
    fn less_bits(self, limit: Self) -> u32 {
        (0..4).fold(0, |bits, lane| bits | u32::from(self.0[lane] < limit.0[lane]) << lane)
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        let [a, b, c, d] = self.0;
        (a + c) + (b + d)
    }
    #[inline(always)]
    fn transpose(rows: &mut [[f32; 4]]) {
        let [a, b, c, d] = [rows[0], rows[1], rows[2], rows[3]];
        for (lane, row) in rows[..4].iter_mut().enumerate() {
            *row = [a[lane], b[lane], c[lane], d[lane]];
        }
    }
    #[inline(always)]
    fn lookup(table: &[f32; 16], words: &[u32], shift: u32) -> Self {
        let words = &words[..4];
        Self(std::array::from_fn(|lane| table[(words[lane] >> shift & 15) as usize]))
    }
    #[inline(always)]
    fn bit_planes(words: &[u32; PLANE_WORDS], planes: &mut [u64; PLANES]) {
        let (mut low, mut high) = ([0; 32], [0; 32]);
        low.copy_from_slice(&words[..32]);
        high.copy_from_slice(&words[32..]);
        transpose_bits(&mut low);
        transpose_bits(&mut high);
        for ((plane, low), high) in planes.iter_mut().zip(low).zip(high) {
            *plane = u64::from(low) | u64::from(high) << 32;
        }
    }
}

/// Transposes 32 by 32 bits, bit k of row n to bit n of row k: halves are exchanged, then quarters, down to single bits.
#[inline(always)]
fn transpose_bits(rows: &mut [u32; 32]) {
    let mut mask = 0x0000_ffff_u32;
    let mut distance = 16;
    while distance != 0 {
        let mut first = 0;
        while first < 32 {
            for row in first..first + distance {
                let exchanged = (rows[row] >> distance ^ rows[row + distance]) & mask;
                rows[row + distance] ^= exchanged;
                rows[row] ^= exchanged << distance;
            }
            first += 2 * distance;
        }
        distance /= 2;
        mask ^= mask << distance;
    }
}
