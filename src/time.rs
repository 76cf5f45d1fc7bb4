//! Stamps and clocks. A ping's stamp is taken once and travels unchanged to every product made from it.
//!
//! Ages are always differences of `boottime_ns` (CLOCK_BOOTTIME, which goes on counting in suspend); the wall clock
//! is carried for people and recordings and is never compared.

/// A stamp this far ahead of now is a broken clock, not an early ping.
pub const FUTURE_LIMIT_NS: u64 = 50_000_000;

/// A moment, on the clock that ages are judged by and on the wall clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, PartialOrd, Ord)]
pub struct Stamp {
    /// CLOCK_BOOTTIME in nanoseconds.
    pub boottime_ns: u64,
    /// Nanoseconds since the Unix epoch; for display and recordings only.
    pub wall_ns: u64,
}

impl Stamp {
    /// Nanoseconds from `earlier` to `self`, negative when `earlier` lies in the future.
    #[must_use]
    pub fn since_ns(self, earlier: Stamp) -> i64 {
        self.boottime_ns.wrapping_sub(earlier.boottime_ns).cast_signed()
    }

    /// The stamp `delta_ns` later on both clocks; round the end of the number line, as [`Stamp::since_ns`] counts.
    #[must_use]
    pub fn plus_ns(self, delta_ns: u64) -> Stamp {
        Stamp { boottime_ns: self.boottime_ns.wrapping_add(delta_ns), wall_ns: self.wall_ns.wrapping_add(delta_ns) }
    }
}

/// Where "now" comes from. Only live sources, the main loops and health read one.
pub trait Clock {
    /// The present moment.
    fn now(&self) -> Stamp;
}

/// The machine's clocks.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now(&self) -> Stamp {
        // Linux counts suspended time in CLOCK_BOOTTIME; elsewhere the monotonic clock is the nearest there is.
        #[cfg(any(target_os = "linux", target_os = "android"))]
        let id = rustix::time::ClockId::Boottime;
        #[cfg(not(any(target_os = "linux", target_os = "android")))]
        let id = rustix::time::ClockId::Monotonic;
        // A wall clock before 1970 is told as 1970: nothing is decided by it.
        let wall = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let wall_ns = u64::try_from(wall.as_nanos()).unwrap_or(u64::MAX);
        Stamp { boottime_ns: nanoseconds(rustix::time::clock_gettime(id)), wall_ns }
    }
}

fn nanoseconds(time: rustix::time::Timespec) -> u64 {
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    seconds * 1_000_000_000 + u64::try_from(time.tv_nsec).unwrap_or(0)
}

/// A clock that a test or a replay sets by hand.
#[derive(Debug, Default)]
pub struct ManualClock {
    now: std::sync::Mutex<Stamp>,
}

impl ManualClock {
    /// Starts at `start`.
    #[must_use]
    pub fn new(start: Stamp) -> Self {
        Self { now: std::sync::Mutex::new(start) }
    }

    /// Moves both clocks forward.
    pub fn advance_ns(&self, delta_ns: u64) {
        let mut now = self.now.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        *now = now.plus_ns(delta_ns);
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Stamp {
        *self.now.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn age_of_a_future_stamp_is_negative() {
        let now = Stamp { boottime_ns: 1_000, wall_ns: 0 };
        let future = Stamp { boottime_ns: 1_500, wall_ns: 0 };
        assert_eq!(now.since_ns(future), -500);
        assert_eq!(future.since_ns(now), 500);
    }

    #[test]
    fn the_system_clock_goes_forward() {
        let first = SystemClock.now();
        std::thread::sleep(std::time::Duration::from_millis(2));
        assert!(SystemClock.now().since_ns(first) >= 2_000_000);
    }
}
