//! Room for what moves: slower, down to a stand, where that keeps the robot farther from somebody who walks.
//!
//! Goes in: the movers of a ping set, and the speed that everything else would allow now. Comes out: a forward speed that is never
//! larger. Movers and robot are taken to go on straight for the horizon; of a few shares of the speed the largest that leaves the
//! wanted gap is taken, or the one that leaves the widest, if that helps at all: somebody who comes from behind is not waited for. Who
//! waits as well is not waited for without end. Never speeds up, never reverses, never turns.

use super::params::RoomParams;
use crate::signal::Movers;
use crate::time::Stamp;
use nalgebra::Vector2;

/// Shares of the speed that are tried, the largest first.
const SHARES: [f64; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];
/// What a slower share must gain to be worth it.
const GAIN_MIN_M: f64 = 0.02;
/// Oldest movers that count.
const AGE_MAX_S: f64 = 0.35;
/// Longest time that the robot waits; then movers count nothing until none is in the way any more.
const WAIT_MAX_S: f64 = 8.0;

/// Remembers the movers told last, and for how long the robot has waited for them.
#[derive(Debug, Clone)]
pub(super) struct Room {
    params: RoomParams,
    radius_m: f64,
    told: Option<(Movers, Stamp)>,
    waited_s: f64,
    waits: bool,
}

impl Room {
    pub(super) fn new(params: &RoomParams, radius_m: f64) -> Self {
        Self { params: params.clone(), radius_m, told: None, waited_s: 0.0, waits: false }
    }

    /// Takes the movers of a ping set.
    pub(super) fn tell(&mut self, movers: &Movers, emitted_at: Stamp) {
        self.told = Some((*movers, emitted_at));
    }

    pub(super) fn forget(&mut self) {
        (self.told, self.waited_s, self.waits) = (None, 0.0, false);
    }

    /// Whether the robot was slowed down by the last call of [`Room::limited_m_s`].
    pub(super) fn waits(&self) -> bool {
        self.waits
    }

    /// The speed, or less of it; what is not forward stays as it is.
    pub(super) fn limited_m_s(&mut self, speed_m_s: f64, now: Stamp, elapsed_s: f64) -> f64 {
        let limited_m_s = self.wished_m_s(speed_m_s, now);
        let wishes = limited_m_s < speed_m_s;
        self.waited_s = if wishes { self.waited_s + elapsed_s } else { 0.0 };
        self.waits = wishes && self.waited_s <= WAIT_MAX_S;
        if self.waits { limited_m_s } else { speed_m_s }
    }

    fn wished_m_s(&self, speed_m_s: f64, now: Stamp) -> f64 {
        let Some((movers, emitted_at)) = self.told.as_ref().filter(|_| self.params.enabled && speed_m_s > 0.0) else {
            return speed_m_s;
        };
        let age_s = now.since_ns(*emitted_at) as f64 * 1e-9;
        if !(0.0..=AGE_MAX_S).contains(&age_s) {
            return speed_m_s;
        }
        let mut best = (f64::NEG_INFINITY, 1.0);
        for share in SHARES {
            let gap_m = self.gap_m(movers, share * speed_m_s, age_s);
            if gap_m >= best.0 + GAIN_MIN_M {
                best = (gap_m, share);
            }
            if !(gap_m < self.params.gap_m) {
                break;
            }
        }
        (best.1 * speed_m_s).min(speed_m_s)
    }

    /// Smallest gap to any mover within the horizon at a speed.
    fn gap_m(&self, movers: &Movers, speed_m_s: f64, age_s: f64) -> f64 {
        let gap_m = |mover: &crate::signal::Mover| {
            let relative_m_s = mover.velocity_m_s - Vector2::new(speed_m_s, 0.0);
            let place_m = mover.position_m + relative_m_s * age_s;
            let square = relative_m_s.norm_squared();
            let nearest_s = if square > 0.0 { -place_m.dot(&relative_m_s) / square } else { 0.0 };
            let nearest_m = (place_m + relative_m_s * nearest_s.clamp(0.0, self.params.horizon_s)).norm();
            nearest_m - mover.radius_m - self.radius_m
        };
        movers.as_slice().iter().map(gap_m).filter(|gap_m| gap_m.is_finite()).fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Mover;

    const NOW: Stamp = Stamp { boottime_ns: 1_000_000_000, wall_ns: 0 };

    fn room(position_m: [f64; 2], velocity_m_s: [f64; 2]) -> Room {
        let mut room = Room::new(&RoomParams { enabled: true, ..RoomParams::default() }, 0.2);
        let mut movers = Movers::default();
        let (position_m, velocity_m_s) = (position_m.into(), velocity_m_s.into());
        movers.enter(Mover { position_m, velocity_m_s, radius_m: 0.2, ..Mover::default() });
        room.tell(&movers, NOW);
        room
    }

    fn limited(position_m: [f64; 2], velocity_m_s: [f64; 2]) -> f64 {
        room(position_m, velocity_m_s).limited_m_s(0.3, NOW, 0.1)
    }

    #[test]
    fn who_crosses_the_way_is_let_pass_and_who_does_not_is_not_waited_for() {
        assert!(limited([0.6, 1.0], [0.0, -0.5]) < 0.1, "he is on the way when the robot is");
        assert_eq!(limited([2.5, 2.6], [0.0, 0.5]), 0.3, "he walks away");
        assert_eq!(limited([-1.0, 0.0], [0.8, 0.0]), 0.3, "he comes from behind: waiting would not help");
        assert_eq!(limited([0.6, 3.0], [0.0, -0.5]), 0.3, "he is far off");
    }

    #[test]
    fn old_news_no_numbers_and_reverse_change_nothing() {
        let mut old = room([0.6, 1.0], [0.0, -0.5]);
        assert_eq!(old.limited_m_s(0.3, NOW.plus_ns(500_000_000), 0.1), 0.3);
        assert_eq!(old.limited_m_s(-0.1, NOW, 0.1), -0.1);
        assert_eq!(limited([f64::NAN, 1.0], [0.0, -0.5]), 0.3);
        let mut off = Room::new(&RoomParams::default(), 0.2);
        off.told = old.told;
        assert_eq!(off.limited_m_s(0.3, NOW, 0.1), 0.3, "not enabled");
    }

    #[test]
    fn nobody_is_waited_for_without_end() {
        let mut room = room([0.7, 0.2], [-0.1, 0.0]);
        let waited = (0..200).take_while(|_| room.limited_m_s(0.3, NOW, 0.1) < 0.3).count();
        assert!((75..=85).contains(&waited), "{waited} ping sets");
    }
}
