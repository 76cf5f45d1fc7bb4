//! The judging of channels, compiled for vectors and cut into pieces for the threads. What counts as what is in
//! [`crate::imaging::channels`].
//!
//! In: a channel's samples, or a stretch of PDM words. Out: what was found, as bits.

use super::simd::Vector;
use crate::imaging::channels::{self, ChannelFinding, WordFindings};

/// One channel, or some words of all channels.
pub(super) enum JudgeTask<'a> {
    F32 { row: &'a [f32], clip_from: usize, found: &'a mut ChannelFinding },
    I16 { row: &'a [i16], clip_from: usize, found: &'a mut ChannelFinding },
    Pdm { words: &'a [u32], clip_from: usize, found: &'a mut WordFindings },
}

/// Judges; the plain loops become vector code of the set that this is compiled for.
#[inline(always)]
pub(super) fn judge<V: Vector>(task: JudgeTask<'_>) {
    match task {
        JudgeTask::F32 { row, clip_from, found } => *found = channels::judge_f32(row, clip_from),
        JudgeTask::I16 { row, clip_from, found } => *found = channels::judge_i16(row, clip_from),
        JudgeTask::Pdm { words, clip_from, found } => *found = channels::judge_words(words, clip_from),
    }
}
