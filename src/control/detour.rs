//! The way round what collision avoidance has just turned away from.
//!
//! Goes in: the nearest reflection of the CA region while CA acts, then also that of the OA region, since that shows how wide the
//! obstacle is; and the robot's pose (odometry, or the commands added up).
//! Comes out: the wanted velocity, without a turn that would lead back into it, and the nearer way out from between such places. A sensor that looks ahead does not hear what
//! is abeam any more, and a guidance that knows no obstacle turns back at once: without a memory the robot stands before a
//! box for ever. Places are kept for a few metres and seconds only, since odometry drifts and people walk on. Never turns or
//! speeds up the robot by itself.

use super::default_regions::DEAF_RANGE_M;
use super::layer::is_driving;
use crate::geometry::Pose2;
use crate::signal::Velocity;
use nalgebra::Vector2;
use std::cmp::Ordering;
use std::f64::consts::{FRAC_PI_2, PI};

/// Places kept at a time.
const PLACES_MAX: usize = 12;
/// A reflection this near to a kept one is the same.
const SAME_PLACE_M: f64 = 0.1;
/// Longest time that a place is kept after it was heard last: what a robot needs to turn away and drive past, at walking pace.
const KEPT_S: f64 = 4.0;
const KEPT_S_M: f64 = 10.0;
/// Way beyond two robot radii after which a place is forgotten.
const KEPT_M: f64 = 1.5;
/// How steeply the way leads out where a place is nearer than half the lane: the angle at no distance at all.
const OUTWARD_RAD: f64 = 1.0;
/// Directions that are tried for a way out, and how much farther one counts that lies against the wanted turn.
const WAY_OUT_STEP_RAD: f64 = 0.1;
const WAY_OUT_STEPS: u32 = 31;
const AGAINST_ASKED: f64 = 1.5;
/// How far ahead in time the wanted turn is looked at: a period, and what the robot turns on before the next command arrives.
const LOOK_AHEAD_S: f64 = 0.3;

/// A place in the frame of the odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Place {
    point_m: Vector2<f64>,
    age_s: f64,
    travelled_m: f64,
}

/// What was avoided lately.
#[derive(Debug, Clone)]
pub(super) struct Detour {
    /// Half the width that the robot keeps free of a place beside its way.
    half_lane_m: f64,
    radius_m: f64,
    /// From here on a sensor at the rim hears what is ahead.
    heard_from_m: f64,
    kept_m: f64,
    kept_s: f64,
    places: [Option<Place>; PLACES_MAX],
    last: Option<Vector2<f64>>,
}

impl Detour {
    /// Nothing avoided yet. `half_lane_m` is the CA region's half width: what passes farther off does not fire it.
    pub(super) fn new(half_lane_m: f64, radius_m: f64) -> Self {
        Self {
            half_lane_m,
            radius_m,
            heard_from_m: radius_m + DEAF_RANGE_M + SAME_PLACE_M,
            kept_m: 2.0 * radius_m + KEPT_M,
            kept_s: KEPT_S + KEPT_S_M * radius_m,
            places: [None; PLACES_MAX],
            last: None,
        }
    }

    /// Forgets everything but the robot's size.
    pub(super) fn forget(&mut self) {
        (self.places, self.last) = ([None; PLACES_MAX], None);
    }

    /// Whether something that was avoided is not passed yet.
    pub(super) fn is_under_way(&self) -> bool {
        self.places.iter().any(Option::is_some)
    }

    /// Takes note of where the robot is, and of reflections at `heard_m` in the robot frame that are to be passed.
    pub(super) fn observe(&mut self, pose: &Pose2, heard_m: [Option<Vector2<f64>>; 2], elapsed_s: f64) {
        let moved_m = self.last.map_or(0.0, |last| (pose.position_m() - last).norm());
        self.last = Some(pose.position_m());
        for slot in &mut self.places {
            *slot = slot.and_then(|place| {
                let place = Place { age_s: place.age_s + elapsed_s, travelled_m: place.travelled_m + moved_m, ..place };
                (place.age_s <= self.kept_s && place.travelled_m <= self.kept_m).then_some(place)
            });
        }
        for heard_m in heard_m.into_iter().flatten().filter(|point_m| point_m.x.is_finite() && point_m.y.is_finite()) {
            self.keep(pose.parent_from_local(heard_m));
        }
    }

    /// Forgets places squarely ahead, where nothing is heard: whoever stood there has gone.
    pub(super) fn forget_ahead(&mut self, pose: &Pose2) {
        for slot in &mut self.places {
            *slot = slot.filter(|place| {
                let point_m = pose.local_from_parent(place.point_m);
                point_m.x < self.heard_from_m || point_m.y.abs() > self.radius_m
            });
        }
    }

    fn keep(&mut self, point_m: Vector2<f64>) {
        let same = |place: &Option<Place>| place.is_some_and(|place| (place.point_m - point_m).norm() <= SAME_PLACE_M);
        let oldest = |slot: &Option<Place>| slot.map_or(f64::INFINITY, |place| place.age_s);
        let index = self.places.iter().position(same).or_else(|| {
            let ages = self.places.iter().map(oldest).enumerate();
            ages.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index)
        });
        if let Some(index) = index {
            self.places[index] = Some(Place { point_m, age_s: 0.0, travelled_m: 0.0 });
        }
    }

    /// Least bearing of a place at which the way straight on passes it: that of the tangent to the circle around it, or, nearer
    /// than that, beyond abeam, so that the way leads out of the circle.
    fn bearing_min_rad(&self, distance_m: f64) -> f64 {
        let share = distance_m / self.half_lane_m;
        if share >= 1.0 { (1.0 / share).asin() } else { FRAC_PI_2 + OUTWARD_RAD * (1.0 - share) }
    }

    /// The side, +1 left or -1 right, to which a turn on the spot leads out from between the kept places: the nearer way out, one
    /// against the turn that is asked for counting half as far again, since the robot must come back from there. `None` where neither
    /// is nearer.
    pub(super) fn way_out(&self, pose: &Pose2, asked_rad_s: f64) -> Option<f64> {
        let cost_rad = |side: f64| {
            let turn_rad = |step: &u32| f64::from(*step) * WAY_OUT_STEP_RAD;
            let free = |turned_rad: &f64| self.is_free(pose, side * turned_rad);
            let found_rad = (0..WAY_OUT_STEPS).map(|step| turn_rad(&step)).find(free).unwrap_or(PI);
            if side * asked_rad_s < 0.0 { AGAINST_ASKED * found_rad } else { found_rad }
        };
        match cost_rad(1.0).total_cmp(&cost_rad(-1.0)) {
            _ if !self.is_under_way() => None,
            Ordering::Less => Some(1.0),
            Ordering::Greater => Some(-1.0),
            Ordering::Equal => None,
        }
    }

    /// Whether the way straight on passes all kept places after a turn.
    fn is_free(&self, pose: &Pose2, turned_rad: f64) -> bool {
        let turned = Pose2 { heading_rad: pose.heading_rad + turned_rad, ..*pose };
        self.places.iter().flatten().all(|place| {
            let point_m = turned.local_from_parent(place.point_m);
            point_m.y.atan2(point_m.x).abs() >= self.bearing_min_rad(point_m.norm())
        })
    }

    /// The wanted velocity without the turn that would point the way at a kept place. A turn on the spot runs into nothing and passes.
    pub(super) fn guard(&self, pose: &Pose2, wanted: Velocity) -> Velocity {
        if !is_driving(wanted) {
            return wanted;
        }
        let turned = Pose2 { heading_rad: pose.heading_rad + LOOK_AHEAD_S * wanted.angular_rad_s, ..*pose };
        let leads_back = self.places.iter().flatten().any(|place| {
            let now_m = pose.local_from_parent(place.point_m);
            let then_m = turned.local_from_parent(place.point_m);
            let towards = now_m.y * wanted.angular_rad_s > 0.0;
            towards && then_m.y.atan2(then_m.x).abs() < self.bearing_min_rad(then_m.norm())
        });
        if leads_back { Velocity { angular_rad_s: 0.0, ..wanted } } else { wanted }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN_RIGHT: Velocity = Velocity { linear_m_s: 0.2, angular_rad_s: -0.5 };

    fn at(x_m: f64, y_m: f64, heading_rad: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad }
    }

    fn after_a_box_ahead() -> Detour {
        let mut detour = Detour::new(0.4, 0.2);
        detour.observe(&at(0.0, 0.0, 0.0), [Some(Vector2::new(0.5, 0.0)), None], 0.1);
        detour
    }

    #[test]
    fn a_turn_back_to_the_place_is_refused_until_the_place_is_passed() {
        let detour = after_a_box_ahead();
        // Turned left by 60 deg: the place is ahead on the right.
        assert_eq!(detour.guard(&at(0.0, 0.0, 1.05), TURN_RIGHT).angular_rad_s, 0.0);
        assert_eq!(detour.guard(&at(0.0, 0.0, 1.05), TURN_RIGHT).linear_m_s, 0.2);
        // The other way, or with the place far enough aside, nothing is held back.
        let left = Velocity { angular_rad_s: 0.5, ..TURN_RIGHT };
        assert_eq!(detour.guard(&at(0.0, 0.0, 1.05), left), left);
        assert_eq!(detour.guard(&at(0.2, 0.6, 0.3), TURN_RIGHT), TURN_RIGHT);
        // Abeam, and behind.
        assert_eq!(detour.guard(&at(0.5, 0.3, 0.0), TURN_RIGHT).angular_rad_s, 0.0);
        assert_eq!(detour.guard(&at(0.9, 0.3, 0.0), TURN_RIGHT), TURN_RIGHT);
    }

    #[test]
    fn places_are_forgotten_after_a_while_and_after_a_way() {
        let mut detour = after_a_box_ahead();
        let pose = at(0.0, 0.0, 1.05);
        for _ in 0..58 {
            detour.observe(&pose, [None; 2], 0.1);
        }
        assert_eq!(detour.guard(&pose, TURN_RIGHT).angular_rad_s, 0.0);
        for _ in 0..3 {
            detour.observe(&pose, [None; 2], 0.1);
        }
        assert_eq!(detour.guard(&pose, TURN_RIGHT), TURN_RIGHT);
        let mut detour = after_a_box_ahead();
        for step in 1..=10 {
            detour.observe(&at(-0.2 * f64::from(step), 0.0, 0.0), [None; 2], 0.1);
        }
        assert_eq!(detour.guard(&pose, TURN_RIGHT), TURN_RIGHT, "2 m were driven");
    }

    #[test]
    fn whoever_has_gone_from_ahead_is_forgotten_and_what_is_abeam_or_too_near_is_not() {
        let walker = |x_m: f64, y_m: f64| {
            let mut detour = Detour::new(0.4, 0.2);
            detour.observe(&at(0.0, 0.0, 0.0), [Some(Vector2::new(x_m, y_m)), None], 0.1);
            detour.forget_ahead(&at(0.0, 0.0, 0.0));
            detour.is_under_way()
        };
        assert!(!walker(0.7, 0.1));
        assert!(walker(0.7, 0.3) && walker(0.5, 0.0) && walker(-0.7, 0.0));
    }

    #[test]
    fn the_way_out_is_the_nearer_one_unless_it_leads_away_from_what_is_wanted() {
        let way_out = |places_m: &[(f64, f64)], asked_rad_s: f64| {
            let mut detour = Detour::new(0.4, 0.2);
            for (x_m, y_m) in places_m {
                detour.observe(&at(0.0, 0.0, 0.0), [Some(Vector2::new(*x_m, *y_m)), None], 0.1);
            }
            detour.way_out(&at(0.0, 0.0, 0.0), asked_rad_s)
        };
        // A box seen to the right: 20 deg to the left pass it, 110 deg to the right.
        for asked_rad_s in [0.5, 0.0, -0.5] {
            assert_eq!(way_out(&[(0.4, -0.3), (0.5, -0.2)], asked_rad_s), Some(1.0));
            assert_eq!(way_out(&[(0.4, 0.3), (0.5, 0.2)], asked_rad_s), Some(-1.0));
        }
        // A wedge: 90 deg to the left, 108 deg to the right.
        let wedge_m = [(0.33, 0.43), (0.31, -0.39)];
        assert_eq!(way_out(&wedge_m, 0.0), way_out(&wedge_m, 0.5));
        assert_eq!([way_out(&wedge_m, 0.5), way_out(&wedge_m, -0.5)], [Some(1.0), Some(-1.0)]);
        assert_eq!(way_out(&[], 0.5), None);
    }

    #[test]
    fn more_places_than_fit_push_out_the_oldest_and_nonsense_is_not_kept() {
        let mut detour = after_a_box_ahead();
        detour.observe(&at(0.0, 0.0, 0.0), [Some(Vector2::new(f64::NAN, 0.0)), None], 0.1);
        for index in 0..12 {
            detour.observe(&at(0.0, 0.0, 0.0), [None, Some(Vector2::new(-1.0, -f64::from(index)))], 0.1);
        }
        assert_eq!(detour.guard(&at(0.0, 0.0, 1.05), TURN_RIGHT), TURN_RIGHT, "the box was the oldest");
    }
}
