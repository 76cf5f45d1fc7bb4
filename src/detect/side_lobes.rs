//! What the two finders of echoes share: how loud it is around a range, whose side lobes reach so far, and the top between three bins.
//!
//! Goes in: rows of an image. Comes out: for every range bin the loudest value of all rows within [`REACH_M`]. Decides nothing.

use crate::signal::PolarGrid;

/// How far before and behind a loud reflector its side lobes reach: off its direction the microphones' echoes are added as far apart
/// in range as half the array is wide (12 cm), and half a pulse more.
const REACH_M: f64 = 0.06;

/// How loud it is around each range bin. Allocates nothing after it was made.
#[derive(Debug, Clone)]
pub(super) struct Loudness {
    /// Largest value of each range bin over all rows; scratch.
    loudest: Vec<f32>,
    /// The same over the bins that its side lobes reach.
    around: Vec<f32>,
    reach_bins: usize,
}

impl Loudness {
    pub(super) fn new(grid: &PolarGrid) -> Self {
        Self {
            loudest: vec![0.0; grid.range_count()],
            around: vec![0.0; grid.range_count()],
            reach_bins: (REACH_M / grid.range_step_m()).ceil() as usize,
        }
    }

    /// Takes the rows of an image.
    pub(super) fn listen<'a>(&mut self, rows: impl Iterator<Item = &'a [f32]>) {
        self.loudest.fill(0.0);
        for row in rows {
            for (loudest, value) in self.loudest.iter_mut().zip(row) {
                *loudest = loudest.max(*value);
            }
        }
        let last_bin = self.loudest.len() - 1;
        for (index, around) in self.around.iter_mut().enumerate() {
            let (first, last) = (index.saturating_sub(self.reach_bins), (index + self.reach_bins).min(last_bin));
            *around = self.loudest[first..=last].iter().copied().fold(0.0, f32::max);
        }
    }

    /// The loudest around each range bin.
    pub(super) fn around(&self) -> &[f32] {
        &self.around
    }
}

/// Where the parabola through three values has its top, in steps from the middle one; within half a step.
pub(super) fn vertex(before: f32, top: f32, after: f32) -> f64 {
    let (before, top, after) = (f64::from(before), f64::from(top), f64::from(after));
    let bend = before - 2.0 * top + after;
    if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}
