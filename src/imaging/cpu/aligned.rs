//! Buffers of f32 that begin at a cache line, and their view as rows of one vector each.
//!
//! In: a length. Out: zeros that vectors load without straddling two lines. Nothing grows after it was made.

use super::simd::Vector;
use std::ops::{Deref, DerefMut};

/// A cache line.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
struct Line([f32; 16]);

/// Values that begin at a cache line.
#[derive(Debug, Clone)]
pub(super) struct Aligned {
    lines: Vec<Line>,
    len: usize,
}

impl Aligned {
    /// `len` zeros.
    pub(super) fn zeros(len: usize) -> Self {
        Self { lines: vec![Line([0.0; 16]); len.div_ceil(16)], len }
    }
}

impl Deref for Aligned {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        &bytemuck::cast_slice(&self.lines)[..self.len]
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut bytemuck::cast_slice_mut(&mut self.lines)[..self.len]
    }
}

/// Values as rows of a vector each; panics if they do not fill whole rows.
#[inline(always)]
pub(super) fn rows<V: Vector>(values: &[f32]) -> &[V::Row] {
    bytemuck::cast_slice(values)
}

/// As [`rows`], to be written.
#[inline(always)]
pub(super) fn rows_mut<V: Vector>(values: &mut [f32]) -> &mut [V::Row] {
    bytemuck::cast_slice_mut(values)
}
