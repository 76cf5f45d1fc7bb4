//! How well things were found: hits, misses, ghosts, and whether covariances are honest.
//!
//! Goes in: what stands where, and what was told. Comes out: counts, errors and their squares over the covariance that was told
//! with them. A thing is where it echoes: the point of its surface nearest to the robot. What was told is a hit of the nearest
//! thing within [`MATCH_M`], if no nearer one was; another for the same thing is a double, any other a ghost.

use crate::geometry::Pose2;
use crate::sim::Pillar;
use nalgebra::{Matrix2, Vector2};

/// Farthest that something told may lie from a thing and still be meant by it: a cell of the grid.
pub const MATCH_M: f64 = 0.2;
/// Shares of a normal distribution of two dimensions within one, two and three deviations.
pub const EXPECTED_SHARES: [f64; 3] = [0.393, 0.865, 0.989];

/// Something told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Told {
    /// Where it is.
    pub position_m: Vector2<f64>,
    /// How well that is known.
    pub covariance_m2: Matrix2<f64>,
}

/// Something that stands there, in the frame of what is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thing {
    /// Its middle.
    pub centre_m: Vector2<f64>,
    /// The point of its surface nearest to the robot.
    pub surface_m: Vector2<f64>,
    /// Whether another thing stands between.
    pub hidden: bool,
}

/// The score of one scene, or the sum over many.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Score {
    /// Scenes.
    pub scenes: usize,
    /// Things that stand there.
    pub things: usize,
    /// Of them, behind others.
    pub hidden: usize,
    /// Things that were told.
    pub hits: usize,
    /// Told, and nothing is there.
    pub ghosts: usize,
    /// Told twice.
    pub doubles: usize,
    /// Things whose cell of the grid, that of the middle or of the nearest surface, counts as occupied.
    pub cells_right: usize,
    /// Distance of every hit from its thing.
    pub errors_m: Vec<f64>,
    /// Its square, normalised by the covariance: chi-square of two degrees of freedom, if that is honest.
    pub squares: Vec<f64>,
}

impl Score {
    /// Things that were not told.
    #[must_use]
    pub fn misses(&self) -> usize {
        self.things - self.hits
    }

    /// Adds another's counts and errors.
    pub fn add(&mut self, other: &Score) {
        self.scenes += other.scenes;
        self.things += other.things;
        self.hidden += other.hidden;
        self.hits += other.hits;
        self.ghosts += other.ghosts;
        self.doubles += other.doubles;
        self.cells_right += other.cells_right;
        self.errors_m.extend_from_slice(&other.errors_m);
        self.squares.extend_from_slice(&other.squares);
    }

    /// The error that so many of the hits stay below; nothing without hits.
    #[must_use]
    pub fn error_quantile_m(&self, share: f64) -> Option<f64> {
        let mut sorted = self.errors_m.clone();
        sorted.sort_by(f64::total_cmp);
        let index = (share.clamp(0.0, 1.0) * (sorted.len().max(1) - 1) as f64).round() as usize;
        sorted.get(index).copied()
    }

    /// Mean normalised squared error; 2 if covariances are honest, more if they promise too much. Nothing without hits.
    #[must_use]
    pub fn mean_square(&self) -> Option<f64> {
        let count = self.squares.len();
        (count > 0).then(|| self.squares.iter().sum::<f64>() / count as f64)
    }

    /// Shares of the hits within one, two and three deviations; [`EXPECTED_SHARES`] if covariances are honest.
    #[must_use]
    pub fn shares_within(&self) -> [f64; 3] {
        let count = self.squares.len().max(1) as f64;
        [1.0_f64, 4.0, 9.0].map(|limit| self.squares.iter().filter(|square| **square <= limit).count() as f64 / count)
    }
}

/// What stands in a scene, as the robot at `true_pose` that believes to be at `believed` would have to tell it.
#[must_use]
pub fn things(pillars: &[Pillar], true_pose: &Pose2, believed: &Pose2) -> Vec<Thing> {
    let local = |pillar: &Pillar| true_pose.local_from_parent(Vector2::from(pillar.centre));
    pillars
        .iter()
        .map(|pillar| {
            let centre_m = local(pillar);
            let surface_m = centre_m - centre_m.normalize() * pillar.radius_m;
            let hides = |other: &Pillar| {
                let other_m = local(other);
                let share = (other_m.dot(&surface_m) / surface_m.norm_squared()).clamp(0.0, 1.0);
                !std::ptr::eq(other, pillar) && (other_m - surface_m * share).norm() < other.radius_m
            };
            Thing {
                centre_m: believed.parent_from_local(centre_m),
                surface_m: believed.parent_from_local(surface_m),
                hidden: pillars.iter().any(hides),
            }
        })
        .collect()
}

/// Scores what was told of one scene; `is_occupied` says whether the grid takes the cell of a place for occupied.
#[must_use]
pub fn score(things: &[Thing], told: &[Told], is_occupied: impl Fn(Vector2<f64>) -> bool) -> Score {
    let mut score = Score {
        scenes: 1,
        things: things.len(),
        hidden: things.iter().filter(|thing| thing.hidden).count(),
        cells_right: things.iter().filter(|thing| is_occupied(thing.centre_m) || is_occupied(thing.surface_m)).count(),
        ..Score::default()
    };
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (index, told) in told.iter().enumerate() {
        for (number, thing) in things.iter().enumerate() {
            let error_m = (told.position_m - thing.surface_m).norm();
            if error_m <= MATCH_M {
                pairs.push((error_m, index, number));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut meant, mut found) = (vec![false; told.len()], vec![false; things.len()]);
    for (error_m, index, number) in &pairs {
        if meant[*index] || found[*number] {
            continue;
        }
        (meant[*index], found[*number]) = (true, true);
        score.hits += 1;
        score.errors_m.push(*error_m);
        let error = told[*index].position_m - things[*number].surface_m;
        let inverse = told[*index].covariance_m2.try_inverse();
        score.squares.push(inverse.map_or(f64::INFINITY, |inverse| (error.transpose() * inverse * error)[0]));
    }
    for index in (0..told.len()).filter(|index| !meant[*index]) {
        let near = pairs.iter().any(|pair| pair.1 == index);
        *(if near { &mut score.doubles } else { &mut score.ghosts }) += 1;
    }
    score
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(x_m: f64, y_m: f64, sigma_m: f64) -> Told {
        Told { position_m: Vector2::new(x_m, y_m), covariance_m2: Matrix2::identity() * sigma_m * sigma_m }
    }

    #[test]
    fn hits_misses_doubles_and_ghosts_are_told_apart() {
        let pillar = |x_m: f64, y_m: f64| Pillar { centre: [x_m, y_m], radius_m: 0.05 };
        let pose = Pose2::default();
        let things = things(&[pillar(1.05, 0.0), pillar(0.0, 1.05), pillar(2.0, 0.0)], &pose, &pose);
        assert!((things[0].surface_m - Vector2::new(1.0, 0.0)).norm() < 1e-12);
        assert_eq!(things.iter().map(|thing| thing.hidden).collect::<Vec<_>>(), [false, false, true]);
        let all = [told(1.01, 0.0, 0.02), told(1.05, 0.05, 0.01), told(-1.0, 0.0, 0.1)];
        let found = score(&things, &all, |place_m| place_m.x > 1.1);
        assert_eq!((found.hits, found.misses(), found.doubles, found.ghosts, found.hidden), (1, 2, 1, 1, 1));
        assert_eq!(found.cells_right, 1);
        assert!((found.squares[0] - 0.25).abs() < 1e-9 && (found.errors_m[0] - 0.01).abs() < 1e-9);
        assert_eq!(found.shares_within(), [1.0, 1.0, 1.0]);
    }

    #[test]
    fn a_robot_that_believes_to_be_elsewhere_has_to_tell_things_there() {
        let pillar = Pillar { centre: [1.0, 0.0], radius_m: 0.1 };
        let believed = Pose2 { x_m: 0.5, y_m: 0.0, heading_rad: std::f64::consts::FRAC_PI_2 };
        let things = things(&[pillar], &Pose2::default(), &believed);
        assert!((things[0].surface_m - Vector2::new(0.5, 0.9)).norm() < 1e-12);
    }
}
