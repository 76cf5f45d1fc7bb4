//! An image whose rows several threads write at the same time, each row by one of them.
//!
//! In: the number and length of rows. Out: guards of single rows, or the whole image by exchange. A flag a row says whether it is
//! held; holding it is what makes the access sound, and a row that is held already is refused, never waited for. The only unsafe
//! code of the imaging beside the vector types.

use std::cell::UnsafeCell;
use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicBool, AtomicPtr, Ordering};

/// The image, `[row][column]`.
pub(super) struct SharedImage {
    values: UnsafeCell<Vec<f32>>,
    /// The first value of `values`.
    first: AtomicPtr<f32>,
    columns: usize,
    /// Whether the row is held.
    held: Vec<AtomicBool>,
}

// SAFETY: a row is reached only through a `RowGuard`, of which the row's flag allows one at a time; the whole only while all flags are held.
unsafe impl Sync for SharedImage {}

impl SharedImage {
    /// Zeros.
    pub(super) fn zeros(rows: usize, columns: usize) -> Self {
        let held = (0..rows).map(|_| AtomicBool::new(false)).collect();
        let mut values = vec![0.0; rows * columns];
        let first = AtomicPtr::new(values.as_mut_ptr());
        Self { values: UnsafeCell::new(values), first, columns, held }
    }

    fn take(&self, row: usize) -> bool {
        !self.held[row].swap(true, Ordering::Acquire)
    }

    fn give_back(&self, row: usize) {
        self.held[row].store(false, Ordering::Release);
    }

    /// A row, to be read or written; `None` while somebody else holds it.
    pub(super) fn row(&self, row: usize) -> Option<RowGuard<'_>> {
        self.take(row).then(|| RowGuard { image: self, row })
    }

    /// Exchanges the whole image with `other` of the same length; false, and nothing done, while somebody holds a row.
    pub(super) fn exchange(&self, other: &mut Vec<f32>) -> bool {
        let taken = (0..self.held.len()).take_while(|row| self.take(*row)).count();
        let may = taken == self.held.len() && other.len() == taken * self.columns;
        if may {
            // SAFETY: all flags are held by this call, so no guard lives and none can be made until they are given back.
            let values = unsafe { &mut *self.values.get() };
            std::mem::swap(values, other);
            self.first.store(values.as_mut_ptr(), Ordering::Relaxed);
        }
        (0..taken).for_each(|row| self.give_back(row));
        may
    }
}

/// A row that nobody else can reach.
pub(super) struct RowGuard<'a> {
    image: &'a SharedImage,
    row: usize,
}

impl RowGuard<'_> {
    fn start(&self) -> *mut f32 {
        // SAFETY: nobody replaces the vector while this guard's flag is held, and the row lies within it, since `exchange` lets only a
        // vector of the same length in.
        unsafe { self.image.first.load(Ordering::Relaxed).add(self.row * self.image.columns) }
    }
}

impl Deref for RowGuard<'_> {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        // SAFETY: the row's values, which nobody else reaches while the flag is held.
        unsafe { std::slice::from_raw_parts(self.start(), self.image.columns) }
    }
}

impl DerefMut for RowGuard<'_> {
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as in `deref`, and the guard is borrowed exclusively.
        unsafe { std::slice::from_raw_parts_mut(self.start(), self.image.columns) }
    }
}

impl Drop for RowGuard<'_> {
    fn drop(&mut self) {
        self.image.give_back(self.row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_written_side_by_side_and_each_by_one_at_a_time() {
        let image = SharedImage::zeros(8, 5);
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let image = &image;
                scope.spawn(move || {
                    for row in (thread..8).step_by(4) {
                        image.row(row).unwrap().fill(row as f32);
                    }
                });
            }
        });
        let mut all = vec![0.0; 40];
        assert!(image.exchange(&mut all));
        assert!(all.chunks(5).enumerate().all(|(row, values)| values.iter().all(|value| *value == row as f32)));
    }

    #[test]
    fn a_held_row_is_refused_and_so_is_the_whole() {
        let image = SharedImage::zeros(3, 2);
        let guard = image.row(1).unwrap();
        assert!(image.row(1).is_none());
        assert!(image.row(2).is_some());
        assert!(!image.exchange(&mut vec![0.0; 6]));
        drop(guard);
        assert!(image.row(1).is_some() && image.row(0).is_some());
        assert!(!image.exchange(&mut vec![0.0; 5]), "another length");
        assert!(image.exchange(&mut vec![0.0; 6]));
    }
}
