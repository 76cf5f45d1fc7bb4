//! Limits on every command: what the platform can do, how far the way is seen, how fast a command may change.
//!
//! Speeding up is held to the platform's accelerations; slowing down towards zero never is, in V as in omega, because a
//! limit that keeps a robot moving is no safety: the drive then brakes as hard as it can. So |V| never exceeds what the layer
//! asked for.

use super::platform::PlatformLimits;
use crate::signal::Velocity;

/// Clamps both components to the platform's largest; not finite means standing still.
#[must_use]
pub(super) fn within_platform(velocity: Velocity, platform: &PlatformLimits) -> Velocity {
    if !velocity.is_finite() {
        return Velocity::ZERO;
    }
    Velocity {
        linear_m_s: velocity.linear_m_s.clamp(-platform.max_linear_m_s, platform.max_linear_m_s),
        angular_rad_s: velocity.angular_rad_s.clamp(-platform.max_angular_rad_s, platform.max_angular_rad_s),
    }
}

/// Highest speed from which the robot stands within `seen_m`: v t + v^2 / (2 a) = seen. Zero where that is no number.
#[must_use]
pub(super) fn speed_for_way_m_s(seen_m: f64, reaction_s: f64, platform: &PlatformLimits) -> f64 {
    let accel_m_s2 = platform.max_linear_accel_m_s2;
    let speed_m_s = accel_m_s2 * ((reaction_s * reaction_s + 2.0 * seen_m / accel_m_s2).sqrt() - reaction_s);
    if speed_m_s > 0.0 { speed_m_s.min(platform.max_linear_m_s) } else { 0.0 }
}

/// The next command on the way from `last` to `asked`, `elapsed_s` later.
#[must_use]
pub(super) fn rate_limited(last: Velocity, asked: Velocity, elapsed_s: f64, platform: &PlatformLimits) -> Velocity {
    Velocity {
        linear_m_s: step(last.linear_m_s, asked.linear_m_s, platform.max_linear_accel_m_s2 * elapsed_s),
        angular_rad_s: step(last.angular_rad_s, asked.angular_rad_s, platform.max_angular_accel_rad_s2 * elapsed_s),
    }
}

/// Away from zero by at most `growth`, towards zero at once; a change of sign starts from zero.
fn step(last: f64, asked: f64, growth: f64) -> f64 {
    let started = if last.signum() == asked.signum() { last.abs() } else { 0.0 };
    asked.signum() * asked.abs().min(started + growth.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slowing_down_is_immediate_and_speeding_up_is_not() {
        let platform = PlatformLimits::default();
        let at = |linear_m_s, angular_rad_s| Velocity { linear_m_s, angular_rad_s };
        assert_eq!(rate_limited(at(0.3, 1.0), at(0.0, 0.0), 0.1, &platform), at(0.0, 0.0));
        assert_eq!(rate_limited(at(0.0, 0.0), at(0.3, 1.0), 0.125, &platform), at(0.125, 0.375));
        assert_eq!(rate_limited(at(0.3, -1.0), at(-0.3, 1.0), 0.125, &platform), at(-0.125, 0.375));
        assert_eq!(rate_limited(at(0.25, 0.0), at(0.3, 0.0), 0.125, &platform), at(0.3, 0.0));
    }

    #[test]
    fn the_allowed_speed_stops_within_what_is_seen() {
        let platform = PlatformLimits::default();
        for seen_m in [0.01, 0.05, 0.1, 0.14] {
            let speed_m_s = speed_for_way_m_s(seen_m, 0.35, &platform);
            let way_m = speed_m_s * 0.35 + speed_m_s * speed_m_s / 2.0;
            assert!((way_m - seen_m).abs() < 1e-12);
        }
        assert_eq!(speed_for_way_m_s(3.0, 0.35, &platform), 0.3);
        for nothing_m in [0.0, -1.0, f64::NAN, f64::NEG_INFINITY] {
            assert_eq!(speed_for_way_m_s(nothing_m, 0.35, &platform), 0.0);
        }
    }
}
