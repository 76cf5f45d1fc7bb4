//! What keeps the robot safe: pure state machines `(state, event, now) -> (state, output)` of daemon and controller, the
//! judgement of pings, and the timeouts. The two machines know nothing of each other: each assumes the other is broken.
//!
//! Every comparison is written so that NaN means "not safe". No clock, no I/O, no allocation.
//!
//! | machine | moves the robot in | leaves a latched state by |
//! |---|---|---|
//! | [`daemon`] | ACTIVE, DEGRADED | operator reset, then arm |
//! | [`gate`] | TRACK | operator arm |

pub mod daemon;
pub mod gate;
pub mod params;
pub mod plausibility;

pub use crate::signal::{DaemonState, GateState, Reason};
pub use daemon::{Daemon, DaemonEvent, DaemonOutput, GroupFindings, SensorFindings};
pub use gate::{CommandSample, Gate, GateEvent, GateOutput, GateParams, MotionLimits, Verdict};
pub use params::SafetyParams;
pub use plausibility::Plausibility;

pub use crate::time::FUTURE_LIMIT_NS;

use crate::time::Stamp;

/// Good ping sets or fresh commands in a row before the robot may move (again).
pub const GOOD_IN_A_ROW: u32 = 5;
/// An operator's arm request is obeyed for this long; what lay in a queue for longer is not what anybody wants now.
pub const ARM_AGE_MAX_NS: u64 = 1_000_000_000;

/// What an operator asks for, on `noctule/operator`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OperatorEvent {
    /// Move the robot, under this start of the daemon only.
    Arm {
        /// The daemon's epoch.
        epoch: u64,
        /// CLOCK_BOOTTIME when the operator asked.
        requested_at_ns: u64,
    },
    /// Stand still until armed again.
    Stop,
    /// Leave FAULT for a new self-test.
    Reset,
}

/// A change of state, to be logged once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Transition<S> {
    /// State before.
    pub from: S,
    /// State after.
    pub to: S,
    /// Why.
    pub reason: Reason,
}

/// Whether something stamped `stamped_ns` may be used at `now`: neither older than `max_age_ns` nor more than
/// [`FUTURE_LIMIT_NS`] ahead. The error says which.
pub(crate) fn check_age(stamped_ns: u64, now: Stamp, max_age_ns: u64) -> Result<(), AgeError> {
    let age_ns = now.since_ns(Stamp { boottime_ns: stamped_ns, wall_ns: 0 });
    if age_ns < -FUTURE_LIMIT_NS.cast_signed() {
        Err(AgeError::Future)
    } else if age_ns > i64::try_from(max_age_ns).unwrap_or(i64::MAX) {
        Err(AgeError::TooOld)
    } else {
        Ok(())
    }
}

/// Why a stamp cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum AgeError {
    TooOld,
    Future,
}

/// Whether an arm request made at `requested_at_ns` still counts: recent, and newer than what disarmed last. So a copy
/// of a request that was already answered by a stop can never arm again.
pub(crate) fn arm_is_current(requested_at_ns: u64, disarmed_at_ns: u64, now: Stamp) -> bool {
    check_age(requested_at_ns, now, ARM_AGE_MAX_NS).is_ok() && requested_at_ns > disarmed_at_ns
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(boottime_ns: u64) -> Stamp {
        Stamp { boottime_ns, wall_ns: 0 }
    }

    #[test]
    fn an_age_is_right_to_the_nanosecond_at_both_ends() {
        let now = at(10_000_000_000);
        assert_eq!(check_age(9_700_000_000, now, 300_000_000), Ok(()));
        assert_eq!(check_age(9_699_999_999, now, 300_000_000), Err(AgeError::TooOld));
        assert_eq!(check_age(10_050_000_000, now, 300_000_000), Ok(()));
        assert_eq!(check_age(10_050_000_001, now, 300_000_000), Err(AgeError::Future));
    }

    #[test]
    fn stamps_at_the_ends_of_the_number_line_are_never_young() {
        let now = at(10_000_000_000);
        for stamped_ns in [0, 1, u64::MAX, u64::MAX - 1, u64::MAX / 2, u64::MAX / 2 + 10_000_000_000] {
            assert!(check_age(stamped_ns, now, 300_000_000).is_err(), "{stamped_ns}");
        }
    }

    #[test]
    fn a_request_older_than_the_last_stop_never_arms() {
        let now = at(10_000_000_000);
        assert!(arm_is_current(9_500_000_000, 9_499_999_999, now));
        assert!(!arm_is_current(9_500_000_000, 9_500_000_000, now));
        assert!(!arm_is_current(8_999_999_999, 0, now));
        assert!(!arm_is_current(10_050_000_001, 0, now));
    }
}
