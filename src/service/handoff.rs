//! Hands ping sets from the acquiring thread to the imaging thread: three buffers, newest wins, nothing is copied.
//!
//! Either side exchanges its own buffer for the one in the middle under a lock that is held for a pointer swap only, so
//! neither can hold up the other. A ping set that was not taken before the next one came is dropped and counted.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

struct Middle<T> {
    buffer: Option<T>,
    fresh: bool,
    closed: bool,
    dropped: u64,
}

struct Shared<T> {
    middle: Mutex<Middle<T>>,
    arrived: Condvar,
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, Middle<T>> {
        self.middle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The acquiring side. Dropping it closes the handoff.
pub struct Giver<T> {
    shared: Arc<Shared<T>>,
}

/// The imaging side.
pub struct Taker<T> {
    shared: Arc<Shared<T>>,
}

/// What waiting gave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// The buffer now holds the newest item.
    Fresh,
    /// Nothing came in time; the buffer is as it was.
    Nothing,
    /// The giver is gone and everything it gave was taken.
    Closed,
}

/// Makes a handoff around one spare buffer; giver and taker bring one each.
#[must_use]
pub fn handoff<T>(spare: T) -> (Giver<T>, Taker<T>) {
    let middle = Mutex::new(Middle { buffer: Some(spare), fresh: false, closed: false, dropped: 0 });
    let shared = Arc::new(Shared { middle, arrived: Condvar::new() });
    (Giver { shared: Arc::clone(&shared) }, Taker { shared })
}

impl<T> Giver<T> {
    /// Gives the content of `buffer` and takes an old buffer in exchange. Returns how many items were dropped so far.
    pub fn give(&self, buffer: &mut T) -> u64 {
        let mut middle = self.shared.lock();
        if let Some(spare) = &mut middle.buffer {
            std::mem::swap(spare, buffer);
        }
        if middle.fresh {
            middle.dropped += 1;
        }
        middle.fresh = true;
        let dropped = middle.dropped;
        drop(middle);
        self.shared.arrived.notify_one();
        dropped
    }
}

impl<T> Drop for Giver<T> {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.arrived.notify_one();
    }
}

impl<T> Taker<T> {
    /// Waits at most `limit` for a new item and exchanges it for the content of `buffer`.
    pub fn take(&self, buffer: &mut T, limit: Duration) -> Taken {
        let middle = self.shared.lock();
        let waited = self.shared.arrived.wait_timeout_while(middle, limit, |middle| !middle.fresh && !middle.closed);
        let (mut middle, _) = waited.unwrap_or_else(PoisonError::into_inner);
        if middle.fresh {
            if let Some(spare) = &mut middle.buffer {
                std::mem::swap(spare, buffer);
            }
            middle.fresh = false;
            return Taken::Fresh;
        }
        if middle.closed { Taken::Closed } else { Taken::Nothing }
    }

    /// Items that were overtaken by newer ones.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.shared.lock().dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_item_wins_and_the_overtaken_one_is_counted() {
        let (giver, taker) = handoff(0);
        let (mut mine, mut yours) = (1, 0);
        giver.give(&mut mine);
        mine = 2;
        giver.give(&mut mine);
        assert_eq!(taker.take(&mut yours, Duration::ZERO), Taken::Fresh);
        assert_eq!((yours, taker.dropped()), (2, 1));
        assert_eq!(taker.take(&mut yours, Duration::from_millis(1)), Taken::Nothing);
    }

    #[test]
    fn the_last_item_is_taken_before_the_end_is_seen() {
        let (giver, taker) = handoff(0);
        let (mut mine, mut yours) = (7, 0);
        giver.give(&mut mine);
        drop(giver);
        assert_eq!(taker.take(&mut yours, Duration::from_secs(1)), Taken::Fresh);
        assert_eq!(yours, 7);
        assert_eq!(taker.take(&mut yours, Duration::from_secs(1)), Taken::Closed);
    }

    #[test]
    fn buffers_go_round_and_none_is_made() {
        let (giver, taker) = handoff(vec![0_u8; 16]);
        let (mut mine, mut yours) = (vec![1_u8; 16], vec![2_u8; 16]);
        let mut seen = std::collections::BTreeSet::new();
        for round in 0..12 {
            giver.give(&mut mine);
            if round % 3 != 0 {
                taker.take(&mut yours, Duration::ZERO);
            }
            seen.extend([mine.as_ptr() as usize, yours.as_ptr() as usize]);
        }
        assert_eq!(seen.len(), 3, "three buffers and no other");
    }

    #[test]
    fn a_poisoned_lock_holds_nobody_up_and_loses_nothing() {
        let (giver, taker) = handoff(0);
        let shared = Arc::clone(&giver.shared);
        let died = std::thread::spawn(move || {
            let _held = shared.lock();
            panic!("planted");
        });
        assert!(died.join().is_err() && giver.shared.middle.is_poisoned());
        let (mut mine, mut yours) = (5, 0);
        giver.give(&mut mine);
        assert_eq!((taker.take(&mut yours, Duration::ZERO), yours), (Taken::Fresh, 5));
        drop(giver);
        assert_eq!(taker.take(&mut yours, Duration::ZERO), Taken::Closed);
    }
}
