//! Objects fused over pings: a small, fixed set of static points in the odometry frame, each with covariance and score.
//!
//! Goes in: the objects of one scan, how far the robot moved since the last, and whether a place was seen to be empty. Comes out:
//! the tracks. Each is a Kalman filter of a point that stands still: measured by the object in its gate (Mahalanobis,
//! chi-square), made uncertain by the drift of odometry on the way. The score is the log-odds that something is there: it rises
//! when it is heard and falls when its place is seen to be empty; unseen changes next to nothing. Never moves a track by itself,
//! knows no grid and no scan.

use super::ring::RingObject;
use super::triangulation::CHI_SQUARE_2;
use nalgebra::{Matrix2, Vector2};

/// Most tracks; the least likely make room.
pub const TRACKS_MAX: usize = 32;
/// Error of odometry: share of the way, and what it turns off course on it.
const DRIFT_SHARE: f64 = 0.03;
const DRIFT_RAD_M: f64 = 0.12;
/// And share of a turn that it misses.
const DRIFT_TURN_SHARE: f64 = 0.03;
/// Drift keeps its sign for about this way, or turn: so long do errors of single pings add up instead of cancelling out.
const DRIFT_KEEPS_M: f64 = 0.3;
const DRIFT_KEEPS_RAD: f64 = 1.0;
/// The part of an error that is the same in every ping and does not average out: of what is round another place echoes when the
/// robot has moved on, and an array's beam is off by the same at the same bearing.
const LASTING_SIGMA_M: f64 = 0.003;
const LASTING_BEARING_RAD: f64 = 0.004;
/// Log-odds of a new track, and what hearing it and seeing it empty add.
const SCORE_NEW: f64 = -0.2;
const SCORE_HEARD: f64 = 1.2;
const SCORE_EMPTY: f64 = -1.0;
/// Most that the log-odds rise to, and where a track dies.
const SCORE_MAX: f64 = 4.0;
const SCORE_DEAD: f64 = -1.0;
/// Time in which a track that nobody sees loses most of what is known of it.
const UNSEEN_KEEPS_S: f64 = 60.0;
/// Two tracks this near are one, squared Mahalanobis distance.
const ONE_THING: f64 = 4.0;

/// A track as it is told.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Track {
    /// Place in the odometry frame.
    pub position_m: Vector2<f64>,
    /// Covariance of the place, square metres.
    pub covariance_m2: Matrix2<f64>,
    /// The two sonars of the ring that heard it last.
    pub pair: [usize; 2],
    /// Probability that something is there, 0 to 1.
    pub score: f64,
    /// Scans in which it was heard.
    pub heard_count: u32,
}

/// How the robot moved from one scan to the next.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Where it is now, in the odometry frame.
    pub position_m: Vector2<f64>,
    /// Way since the last scan.
    pub way_m: f64,
    /// Turn since then, without sign.
    pub turn_rad: f64,
    /// Time since then.
    pub dt_s: f64,
}

/// Tracks under way.
#[derive(Debug, Clone)]
pub struct Tracks {
    tracks: Vec<Tracked>,
    /// For each object of the scan whether a track has it; scratch.
    taken: Vec<bool>,
}

#[derive(Debug, Clone, Copy)]
struct Tracked {
    position_m: Vector2<f64>,
    /// Without what lasts.
    covariance_m2: Matrix2<f64>,
    pair: [usize; 2],
    log_odds: f64,
    heard_count: u32,
    heard: bool,
}

impl Default for Tracks {
    fn default() -> Self {
        Self::new()
    }
}

impl Tracks {
    /// No tracks yet.
    #[must_use]
    pub fn new() -> Self {
        Self { tracks: Vec::with_capacity(TRACKS_MAX), taken: Vec::with_capacity(4 * TRACKS_MAX) }
    }

    /// Forgets everything: the odometry frame is another one.
    pub fn clear(&mut self) {
        self.tracks.clear();
    }

    /// Number of tracks.
    #[must_use]
    pub fn len(&self) -> usize {
        self.tracks.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.tracks.is_empty()
    }

    /// The tracks, the most likely first, covariances as seen from `observer_m`.
    pub fn tell(&self, observer_m: Vector2<f64>) -> impl Iterator<Item = Track> + '_ {
        self.tracks.iter().map(move |track| Track {
            position_m: track.position_m,
            covariance_m2: track.covariance_m2 + lasting_m2(track.position_m - observer_m),
            pair: track.pair,
            score: 1.0 / (1.0 + (-track.log_odds).exp()),
            heard_count: track.heard_count,
        })
    }

    /// Takes in the objects of one scan (at most 128 count). `is_empty` says of a place and the spread of its uncertainty whether
    /// the scan saw that nothing is there; false where nobody knows. Allocates nothing.
    pub fn update(&mut self, motion: &Motion, objects: &[RingObject], is_empty: impl Fn(Vector2<f64>, f64) -> bool) {
        let objects = &objects[..objects.len().min(4 * TRACKS_MAX)];
        for track in &mut self.tracks {
            track.drift(motion);
            track.heard = false;
        }
        self.taken.clear();
        self.taken.resize(objects.len(), false);
        while let Some((track, object)) = self.nearest(objects, motion) {
            self.taken[object] = true;
            self.tracks[track].hear(&objects[object]);
        }
        let kept = (-motion.dt_s.max(0.0) / UNSEEN_KEEPS_S).exp();
        for track in self.tracks.iter_mut().filter(|track| !track.heard) {
            let spread_m = track.covariance_m2.trace().max(0.0).sqrt();
            if is_empty(track.position_m, spread_m) {
                track.log_odds += SCORE_EMPTY;
            } else {
                track.log_odds *= kept;
            }
        }
        for (index, object) in objects.iter().enumerate() {
            if !self.taken[index] && !self.is_known(object, motion) {
                self.begin(object);
            }
        }
        self.tracks.retain(|track| track.log_odds > SCORE_DEAD && track.is_sound());
        self.join(motion);
        self.tracks.sort_unstable_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
    }

    /// The best pair of a track that was not heard yet and an object that no track has: the most likely one, so that a wide gate
    /// does not win over a narrow one by its width.
    fn nearest(&self, objects: &[RingObject], motion: &Motion) -> Option<(usize, usize)> {
        let mut best = None;
        let mut least = f64::INFINITY;
        for (index, track) in self.tracks.iter().enumerate().filter(|(_, track)| !track.heard) {
            for (number, object) in objects.iter().enumerate().filter(|(number, _)| !self.taken[*number]) {
                let Some((squared, spread)) = track.distance(object, motion) else { continue };
                if squared <= CHI_SQUARE_2 && squared + spread < least {
                    (best, least) = (Some((index, number)), squared + spread);
                }
            }
        }
        best
    }

    /// Whether an object lies in the gate of a track: two views of one thing are no two things.
    fn is_known(&self, object: &RingObject, motion: &Motion) -> bool {
        self.tracks
            .iter()
            .any(|track| track.distance(object, motion).is_some_and(|(squared, _)| squared <= CHI_SQUARE_2))
    }

    fn begin(&mut self, object: &RingObject) {
        let new = Tracked {
            position_m: object.position_m,
            covariance_m2: object.covariance_m2,
            pair: object.pair,
            log_odds: SCORE_NEW,
            heard_count: 1,
            heard: true,
        };
        if !new.is_sound() {
            return;
        }
        if self.tracks.len() < TRACKS_MAX {
            self.tracks.push(new);
            return;
        }
        let least = self.tracks.iter_mut().min_by(|a, b| a.log_odds.total_cmp(&b.log_odds));
        if let Some(least) = least.filter(|least| least.log_odds < new.log_odds) {
            *least = new;
        }
    }

    /// Of two tracks of one thing the less likely goes; what both know came from the same pings, so nothing is added.
    fn join(&mut self, motion: &Motion) {
        let mut first = 0;
        while first < self.tracks.len() {
            let mut second = first + 1;
            while second < self.tracks.len() {
                let (a, b) = (self.tracks[first], self.tracks[second]);
                let object = RingObject { position_m: b.position_m, pair: b.pair, covariance_m2: b.covariance_m2 };
                if a.distance(&object, motion).is_some_and(|(squared, _)| squared <= ONE_THING) {
                    if b.log_odds > a.log_odds {
                        self.tracks[first] = b;
                    }
                    self.tracks.swap_remove(second);
                } else {
                    second += 1;
                }
            }
            first += 1;
        }
    }
}

impl Tracked {
    /// What the drift of odometry makes of a place: shifted with the robot's, and swung about it.
    fn drift(&mut self, motion: &Motion) {
        let away_m = self.position_m - motion.position_m;
        let across = Vector2::new(-away_m.y, away_m.x);
        let (way_m, turn_rad) = (motion.way_m.max(0.0), motion.turn_rad.abs());
        let shift_m2 = DRIFT_SHARE.powi(2) * way_m * way_m.max(DRIFT_KEEPS_M);
        let swing_rad2 = DRIFT_RAD_M.powi(2) * way_m * way_m.max(DRIFT_KEEPS_M)
            + DRIFT_TURN_SHARE.powi(2) * turn_rad * turn_rad.max(DRIFT_KEEPS_RAD);
        self.covariance_m2 += Matrix2::identity() * shift_m2 + across * across.transpose() * swing_rad2;
    }

    /// Squared Mahalanobis distance of an object, and the logarithm of the spread that it is measured by.
    fn distance(&self, object: &RingObject, motion: &Motion) -> Option<(f64, f64)> {
        let apart_m = object.position_m - self.position_m;
        let spread_m2 = self.covariance_m2 + object.covariance_m2 + lasting_m2(self.position_m - motion.position_m);
        let squared = (apart_m.transpose() * spread_m2.try_inverse()? * apart_m)[0];
        squared.is_finite().then(|| (squared, spread_m2.determinant().max(1e-300).ln()))
    }

    fn hear(&mut self, object: &RingObject) {
        self.heard = true;
        self.heard_count = self.heard_count.saturating_add(1);
        self.pair = object.pair;
        self.log_odds = (self.log_odds + SCORE_HEARD).min(SCORE_MAX);
        let Some(inverse) = (self.covariance_m2 + object.covariance_m2).try_inverse() else { return };
        let gain = self.covariance_m2 * inverse;
        self.position_m += gain * (object.position_m - self.position_m);
        // Joseph's form: stays symmetric and positive whatever the rounding.
        let rest = Matrix2::identity() - gain;
        self.covariance_m2 =
            rest * self.covariance_m2 * rest.transpose() + gain * object.covariance_m2 * gain.transpose();
    }

    fn is_sound(&self) -> bool {
        let finite = self.position_m.iter().chain(self.covariance_m2.iter()).all(|value| value.is_finite());
        finite && self.covariance_m2.determinant() > 0.0
    }
}

/// Covariance of what does not average out, for a place so far from the robot.
fn lasting_m2(away_m: Vector2<f64>) -> Matrix2<f64> {
    let across = Vector2::new(-away_m.y, away_m.x);
    Matrix2::identity() * LASTING_SIGMA_M.powi(2) + across * across.transpose() * LASTING_BEARING_RAD.powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    fn object(x_m: f64, y_m: f64, sigma_m: f64) -> RingObject {
        let covariance_m2 = Matrix2::identity() * sigma_m * sigma_m;
        RingObject { position_m: Vector2::new(x_m, y_m), pair: [0, 1], covariance_m2 }
    }

    const STILL: Motion = Motion { position_m: Vector2::new(0.0, 0.0), way_m: 0.0, turn_rad: 0.0, dt_s: 0.1 };

    fn told(tracks: &Tracks) -> Vec<Track> {
        tracks.tell(Vector2::zeros()).collect()
    }

    #[test]
    fn what_is_heard_again_becomes_certain_and_better_known() {
        let mut tracks = Tracks::new();
        tracks.update(&STILL, &[object(1.0, 0.5, 0.05)], |_, _| false);
        let first = told(&tracks)[0];
        assert!(first.score < 0.5, "one ping is no proof: {first:?}");
        for _ in 0..9 {
            tracks.update(&STILL, &[object(1.0, 0.5, 0.05)], |_, _| false);
        }
        let last = told(&tracks)[0];
        assert!(last.score > 0.95 && last.heard_count == 10, "{last:?}");
        // A tenth of the variance, and what does not average out.
        let expected_m2 =
            0.05_f64.powi(2) / 10.0 + LASTING_SIGMA_M.powi(2) + (1.25 * LASTING_BEARING_RAD.powi(2)) / 2.0;
        assert!((last.covariance_m2.trace() / 2.0 - expected_m2).abs() < 0.1 * expected_m2, "{}", last.covariance_m2);
    }

    #[test]
    fn a_ghost_dies_where_its_place_is_seen_empty_and_lives_where_nobody_sees() {
        let mut tracks = Tracks::new();
        tracks.update(&STILL, &[object(1.0, 0.0, 0.02)], |_, _| false);
        let mut unseen = tracks.clone();
        tracks.update(&STILL, &[], |_, _| true);
        assert!(tracks.is_empty());
        for _ in 0..20 {
            unseen.update(&STILL, &[], |_, _| false);
        }
        assert_eq!(unseen.len(), 1);
    }

    #[test]
    fn what_was_certain_needs_more_than_one_look_to_die() {
        let mut tracks = Tracks::new();
        for _ in 0..10 {
            tracks.update(&STILL, &[object(1.0, 0.0, 0.02)], |_, _| false);
        }
        tracks.update(&STILL, &[], |_, _| true);
        assert!(told(&tracks)[0].score > 0.8);
        for _ in 0..5 {
            tracks.update(&STILL, &[], |_, _| true);
        }
        assert!(tracks.is_empty(), "it was carried away");
    }

    #[test]
    fn drift_of_odometry_makes_far_things_less_certain_than_near_ones() {
        let mut tracks = Tracks::new();
        tracks.update(&STILL, &[object(0.5, 0.0, 0.01), object(2.0, 0.0, 0.01)], |_, _| false);
        tracks.update(&Motion { way_m: 0.5, turn_rad: 0.5, ..STILL }, &[], |_, _| false);
        let across_m = |x_m: f64| {
            let found = told(&tracks).into_iter().find(|track| (track.position_m.x - x_m).abs() < 0.1);
            found.expect("there").covariance_m2.m22.sqrt()
        };
        assert!(across_m(2.0) > 3.0 * across_m(0.5), "{} {}", across_m(2.0), across_m(0.5));
    }

    #[test]
    fn neighbours_keep_their_own_tracks_and_there_are_never_more_than_there_is_room_for() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut tracks = Tracks::new();
        for _ in 0..50 {
            let mut objects = vec![object(1.0, 0.1, 0.02), object(1.0, -0.1, 0.02)];
            objects.extend(
                (0..60).map(|_| object(3.0 + 9.0 * random.random::<f64>(), 9.0 * random.random::<f64>(), 0.01)),
            );
            tracks.update(&STILL, &objects, |place_m, _| place_m.x > 2.0);
            assert!(tracks.len() <= TRACKS_MAX);
        }
        let sure: Vec<Track> = told(&tracks).into_iter().filter(|track| track.score > 0.9).collect();
        assert_eq!(sure.len(), 2, "{sure:?}");
        assert!(sure.iter().all(|track| (track.position_m.y.abs() - 0.1).abs() < 0.02));
    }

    #[test]
    fn values_that_are_no_numbers_make_no_track() {
        let mut tracks = Tracks::new();
        let bad = RingObject { covariance_m2: Matrix2::repeat(f64::NAN), ..object(1.0, 1.0, 0.1) };
        tracks.update(&STILL, &[object(f64::NAN, 0.0, 0.1), bad, object(f64::INFINITY, 0.0, 0.1)], |_, _| false);
        assert!(tracks.is_empty());
        tracks.update(&STILL, &[object(1.0, 0.0, 0.1)], |_, _| false);
        tracks.update(&Motion { way_m: f64::NAN, turn_rad: f64::INFINITY, ..STILL }, &[], |_, _| false);
        assert!(tracks.is_empty(), "and one that becomes none is dropped");
    }
}
