//! Several imagers at one recording: each takes the next ping, images it alone, and waits for its turn to hand the image on.
//!
//! In: a recording and imagers for the same plan. Out: images in the order of the pings, one at a time. No more pings are in
//! flight than there are imagers, however long the recording is. An image does not depend on who makes it.

use super::super::Failure;
use super::{backend_failure, data_failure};
use crate::imaging::Imager;
use crate::imaging::backend::Image;
use crate::imaging::plan::ImagingPlan;
use crate::io::recording_file::RecordingFile;
use crate::signal::PingSet;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// What is done with the images: at once and beside each other, then one after the other in order.
pub trait Images: Sync {
    /// What the second half works on.
    type Written: Send;

    /// Done by whoever made the image, whenever it is made.
    ///
    /// # Errors
    /// Ends the recording.
    fn beside(&self, index: u64, image: &Image) -> Result<(), Failure>;

    /// Done in the order of the pings.
    ///
    /// # Errors
    /// Ends the recording.
    fn in_order(&self, written: &mut Self::Written, index: u64, image: &Image) -> Result<(), Failure>;
}

/// What a recording came to.
pub struct Ended<W> {
    /// Pings imaged and handed on.
    pub count: u64,
    /// Why the reading ended, if not with the recording.
    pub cut_short: Option<Failure>,
    /// What was written to.
    pub written: W,
}

struct Reading<'a> {
    recording: &'a mut RecordingFile,
    next: u64,
    over: bool,
    cut_short: Option<Failure>,
}

struct Writing<W> {
    next: u64,
    failure: Option<Failure>,
    written: W,
}

struct Shared<'a, I: Images> {
    plan: &'a ImagingPlan,
    reading: Mutex<Reading<'a>>,
    writing: Mutex<Writing<I::Written>>,
    turned: Condvar,
    images: &'a I,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Images a whole recording.
///
/// # Errors
/// The first failure of imaging or writing; a recording that cannot be read further is none, see [`Ended::cut_short`].
pub fn image_all<I: Images>(
    recording: &mut RecordingFile,
    imagers: &mut [Imager],
    plan: &ImagingPlan,
    images: &I,
    written: I::Written,
) -> Result<Ended<I::Written>, Failure> {
    let shared = Shared {
        plan,
        reading: Mutex::new(Reading { recording, next: 0, over: false, cut_short: None }),
        writing: Mutex::new(Writing { next: 0, failure: None, written }),
        turned: Condvar::new(),
        images,
    };
    match imagers {
        [imager] => work(&shared, imager),
        imagers => std::thread::scope(|scope| {
            for imager in imagers {
                scope.spawn(|| work(&shared, imager));
            }
        }),
    }
    let reading = shared.reading.into_inner().unwrap_or_else(PoisonError::into_inner);
    let writing = shared.writing.into_inner().unwrap_or_else(PoisonError::into_inner);
    match writing.failure {
        Some(failure) => Err(failure),
        None => Ok(Ended { count: writing.next, cut_short: reading.cut_short, written: writing.written }),
    }
}

fn work<I: Images>(shared: &Shared<'_, I>, imager: &mut Imager) {
    let mut pings = PingSet::empty(1, shared.plan.format, &[shared.plan.raw_len(0)]);
    pings.present = [true, false, false];
    while let Some(index) = next_ping(shared, &mut pings) {
        let image = imager.image(&pings).map_err(|error| backend_failure(&error));
        let image = image.and_then(|image| shared.images.beside(index, image).map(|()| image));
        let mut writing = lock(&shared.writing);
        while writing.next != index && writing.failure.is_none() {
            writing = shared.turned.wait(writing).unwrap_or_else(PoisonError::into_inner);
        }
        if writing.failure.is_some() {
            return;
        }
        let done = image.and_then(|image| shared.images.in_order(&mut writing.written, index, image));
        match done {
            Ok(()) => writing.next += 1,
            Err(failure) => {
                lock(&shared.reading).over = true;
                writing.failure = Some(failure);
            }
        }
        drop(writing);
        shared.turned.notify_all();
    }
}

/// Reads the next ping into the buffer; `None` when there is none, or nobody wants it any more.
fn next_ping<I: Images>(shared: &Shared<'_, I>, pings: &mut PingSet) -> Option<u64> {
    let mut reading = lock(&shared.reading);
    if reading.over {
        return None;
    }
    match reading.recording.read_ping(pings.pings[0].samples_mut()) {
        Ok(true) => {
            let index = reading.next;
            reading.next += 1;
            pings.sequence = index;
            pings.pings[0].sequence = index;
            Some(index)
        }
        Ok(false) => {
            reading.over = true;
            None
        }
        Err(error) => {
            reading.over = true;
            reading.cut_short = Some(data_failure(&error));
            None
        }
    }
}
