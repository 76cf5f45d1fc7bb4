//! Scenes for the virtual sonar ring: round things on a map of 2 m by 2 m, the robot among them (paper 003, section VI).
//!
//! Goes in: a seed. Comes out: a world and where the robot stands. The paper's own five things cannot be put up again: its table 7
//! gives one cell to two of them, and distances that no place of the robot explains. Nothing here hears or scores.

use crate::geometry::Pose2;
use crate::sim::{Pillar, Start, World};
use nalgebra::Vector2;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Side of the paper's map.
pub const MAP_M: f64 = 1.99;
/// Nearest and farthest surface of a thing from the robot's middle.
pub const RANGE_M: [f64; 2] = [0.3, 1.4];
/// Least gap between two things.
const GAP_MIN_M: f64 = 0.15;
const RADII_M: [f64; 2] = [0.03, 0.05];
const COUNTS: [u64; 2] = [3, 6];
/// Random places that are tried before a scene goes with fewer things.
const TRIES: usize = 2000;

/// A scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Things, and where the robot starts.
    pub world: World,
    /// The same as a pose.
    pub start: Pose2,
    /// Decides noise, wheels and gyro.
    pub seed: u64,
}

impl Scene {
    /// The paper's experiment: five round things of 4 cm radius, each in the middle of a cell of 20 cm; the robot in the middle
    /// of the map, cell (5, 5). Cells (3, 2), (5, 2) and (2, 4) are the paper's; (8, 3) stands for its (1, 2), which nearer
    /// things hide from every plain sonar that would hold it, and (7, 8) for its second (3, 2).
    #[must_use]
    pub fn paper(seed: u64) -> Self {
        let cells = [(3, 2), (5, 2), (2, 4), (8, 3), (7, 8)];
        let pillar = |(x, y): (i32, i32)| Pillar { centre: [0.2 * f64::from(x), 0.2 * f64::from(y)], radius_m: 0.04 };
        Self::new(cells.map(pillar).to_vec(), Pose2 { x_m: 1.0, y_m: 1.0, heading_rad: 0.0 }, seed)
    }

    /// Three to six things of 3 to 5 cm radius in random places, the robot within 30 cm of the middle.
    #[must_use]
    pub fn random(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut between = |[low, high]: [f64; 2]| low + (high - low) * random.random::<f64>();
        let start = Pose2 { x_m: between([0.7, 1.3]), y_m: between([0.7, 1.3]), heading_rad: between([-3.1, 3.1]) };
        let count = between([COUNTS[0] as f64, COUNTS[1] as f64 + 1.0]).floor() as usize;
        let mut pillars: Vec<Pillar> = Vec::new();
        for _ in 0..TRIES {
            if pillars.len() >= count {
                break;
            }
            let radius_m = between(RADII_M);
            let inside = [radius_m, MAP_M - radius_m];
            let centre = [between(inside), between(inside)];
            let gap_m = |from: [f64; 2], radii_m: f64| (Vector2::from(centre) - Vector2::from(from)).norm() - radii_m;
            let away_m = gap_m([start.x_m, start.y_m], radius_m);
            let apart = pillars.iter().all(|other| gap_m(other.centre, radius_m + other.radius_m) >= GAP_MIN_M);
            if (RANGE_M[0]..=RANGE_M[1]).contains(&away_m) && apart {
                pillars.push(Pillar { centre, radius_m });
            }
        }
        Self::new(pillars, start, seed)
    }

    fn new(pillars: Vec<Pillar>, start: Pose2, seed: u64) -> Self {
        let zone = Start {
            corner: [start.x_m, start.y_m],
            size: [0.0, 0.0],
            heading_deg: start.heading_rad.to_degrees(),
            heading_spread_deg: 0.0,
        };
        Self { world: World { pillars, start: zone, ..World::default() }, start, seed }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_follow_from_their_seed_and_things_keep_their_distances() {
        assert_eq!(Scene::random(4), Scene::random(4));
        let mut counts = Vec::new();
        for seed in 0..200 {
            let scene = Scene::random(seed);
            scene.world.validate().expect("a world");
            let pillars = &scene.world.pillars;
            counts.push(pillars.len());
            for (index, pillar) in pillars.iter().enumerate() {
                let centre_m = Vector2::from(pillar.centre);
                let away_m = (centre_m - scene.start.position_m()).norm() - pillar.radius_m;
                assert!((RANGE_M[0]..=RANGE_M[1]).contains(&away_m));
                for other in &pillars[index + 1..] {
                    let gap_m = (centre_m - Vector2::from(other.centre)).norm() - pillar.radius_m - other.radius_m;
                    assert!(gap_m >= GAP_MIN_M);
                }
            }
        }
        assert!((3..=6).all(|count| counts.contains(&count)) && counts.iter().all(|count| (3..=6).contains(count)));
    }

    #[test]
    fn the_papers_five_things_lie_in_five_cells_within_reach() {
        let scene = Scene::paper(1);
        assert_eq!(scene.world.pillars.len(), 5);
        for pillar in &scene.world.pillars {
            let away_m = (Vector2::from(pillar.centre) - scene.start.position_m()).norm() - pillar.radius_m;
            assert!((RANGE_M[0]..=RANGE_M[1]).contains(&away_m), "{away_m}");
            assert!(pillar.centre.iter().all(|coordinate_m| (0.0..=MAP_M).contains(coordinate_m)));
        }
    }
}
