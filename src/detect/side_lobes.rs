//! What the finders of echoes share: how loud it is around a range, whose side lobes reach so far, what a top must reach there, and the
//! top between three bins.
//!
//! Goes in: rows of an image. Comes out: for every range bin the loudest value of all rows within [`REACH_M`], and the tops of a row.
//! Says nothing of directions.

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

/// The tops of rows in range: above the noise floor, and above what the side lobes of something louder at about the range reach.
/// Allocates nothing after it was made.
#[derive(Debug, Clone)]
pub(super) struct Tops {
    floors: Vec<f32>,
    /// A top stands so many times above its floor.
    above_floor: f32,
    /// Share of something louder that its side lobes reach.
    pub(super) share: f32,
    loudness: Loudness,
    /// The least that a top at each range bin must reach; scratch.
    needed: Vec<f32>,
    range_first_m: f64,
    range_step_m: f64,
}

impl Tops {
    /// `floor_at` and `side_lobe_share` are those of [`super::RangeScanner::new`].
    pub(super) fn new(grid: &PolarGrid, floor_at: impl Fn(f64) -> f64, side_lobe_share: f64, above_floor: f32) -> Self {
        let count = grid.range_count();
        Self {
            floors: (0..count).map(|index| floor_at(grid.range_m(index)) as f32).collect(),
            above_floor,
            share: side_lobe_share as f32,
            loudness: Loudness::new(grid),
            needed: vec![0.0; count],
            range_first_m: grid.range_first_m(),
            range_step_m: grid.range_step_m(),
        }
    }

    /// Ranges of a row.
    pub(super) fn range_count(&self) -> usize {
        self.floors.len()
    }

    /// Takes the rows whose tops will be asked for. False, and nothing taken, where `cells` do not hold all of `rows`, or a row has no
    /// middle.
    pub(super) fn listen(&mut self, cells: &[f32], rows: impl Iterator<Item = usize> + Clone) -> bool {
        let count = self.range_count();
        if count < 3 || rows.clone().any(|row| (row + 1) * count > cells.len()) {
            return false;
        }
        self.loudness.listen(rows.map(|row| &cells[row * count..][..count]));
        for ((needed, around), floor) in self.needed.iter_mut().zip(self.loudness.around()).zip(&self.floors) {
            *needed = (self.share * around).max(self.above_floor * floor);
        }
        true
    }

    /// Bins at which a row has tops.
    pub(super) fn of_row<'a>(&'a self, row: &'a [f32]) -> impl Iterator<Item = usize> + 'a {
        (1..self.range_count() - 1).filter(|&bin| {
            let value = row[bin];
            value > self.needed[bin] && value >= row[bin - 1] && value > row[bin + 1]
        })
    }

    /// The noise floor at a top, as a share of it, at most 1.
    pub(super) fn noise(&self, row: &[f32], bin: usize) -> f64 {
        f64::from(self.floors[bin] / row[bin]).min(1.0)
    }

    /// Range of a top, finer than a bin.
    pub(super) fn range_m(&self, row: &[f32], bin: usize) -> f64 {
        self.range_first_m + (bin as f64 + vertex(row[bin - 1], row[bin], row[bin + 1])) * self.range_step_m
    }
}

/// Enters something by weight, the weightiest first; the list never grows beyond `most`.
pub(super) fn keep<T>(found: &mut Vec<T>, most: usize, entry: T, weight: impl Fn(&T) -> f64) {
    let place = found.iter().position(|other| weight(other) < weight(&entry)).unwrap_or(found.len());
    if place >= most {
        return;
    }
    found.truncate(most - 1);
    found.insert(place, entry);
}

/// Where the parabola through three values has its top, in steps from the middle one; within half a step.
pub(crate) fn vertex(before: impl Into<f64>, top: impl Into<f64>, after: impl Into<f64>) -> f64 {
    let (before, top, after) = (before.into(), top.into(), after.into());
    let bend = before - 2.0 * top + after;
    if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}
