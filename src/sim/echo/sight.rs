//! What hides what: walls, pillars, movers, the housings of the robot's sensors and its configured obstructions.
//!
//! Places in the world in, yes or no out: sound is let through or not, by the ray to the middle of the array. What bends
//! into a shadow is left out; it fades over a Fresnel zone, 6 cm at 1 m. Knows no path and no sample.

use super::path::Station;
use crate::geometry::Pose2;
use crate::geometry::shape::Shape;
use crate::sim::obstacles::{Obstacles, segments_cross};
use nalgebra::Vector2;

/// All that may stand in the way at the moment of a ping.
pub(super) struct Sight<'a> {
    pub(super) obstacles: &'a Obstacles,
    pub(super) stations: &'a [Station],
    /// In the robot's frame.
    pub(super) obstructions: &'a [Shape],
    pub(super) robot: Pose2,
    /// Without occlusion nothing hides anything.
    pub(super) occlusion: bool,
}

impl Sight<'_> {
    /// Whether anything stands in the way of the legs. `first` and `last` are the housings (bit k = sensor k) that hide
    /// nothing on the first and on the last leg, being those of the sensors there.
    pub(super) fn hidden(&self, legs: &[(Vector2<f64>, Vector2<f64>)], first: u8, last: u8) -> bool {
        self.occlusion
            && legs.iter().enumerate().any(|(index, &(from_m, to_m))| {
                let mut looks_through = 0;
                if index == 0 {
                    looks_through |= first;
                }
                if index + 1 == legs.len() {
                    looks_through |= last;
                }
                self.obstacles.block(from_m, to_m)
                    || self.housing_blocks(from_m, to_m, looks_through)
                    || self.obstruction_blocks(from_m, to_m)
            })
    }

    fn housing_blocks(&self, from_m: Vector2<f64>, to_m: Vector2<f64>, looks_through: u8) -> bool {
        self.stations.iter().enumerate().any(|(sensor, station)| {
            let corners = &station.housing_m;
            looks_through & (1 << sensor) == 0
                && (0..4).any(|index| segments_cross(from_m, to_m, corners[index], corners[(index + 1) % 4]))
        })
    }

    fn obstruction_blocks(&self, from_m: Vector2<f64>, to_m: Vector2<f64>) -> bool {
        if self.obstructions.is_empty() {
            return false;
        }
        let (from_m, to_m) = (self.robot.local_from_parent(from_m), self.robot.local_from_parent(to_m));
        let length_m = (to_m - from_m).norm();
        // The two ends of a corner's middle leg are one point.
        length_m > 0.0
            && self
                .obstructions
                .iter()
                .filter_map(|shape| shape.first_hit_m(from_m, (to_m - from_m) / length_m))
                .any(|hit_m| hit_m < length_m)
    }
}
