//! The points that the echoes came from, in space, as they lie in shared memory.
//!
//! Layout only, and the conversion from [`PointCloud`].

use super::wire_type;
use crate::signal::{POINTS_MAX, PointCloud, SLICE_BEARINGS, SpaceClass};
use iceoryx2::prelude::ZeroCopySend;

wire_type! {
    /// Points in the robot frame with covariance and class, and the slice of them at the robot's height.
    PointCloud3 = "noctule.PointCloud3.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Sequence of the ping set.
        sequence: u64,
        /// Its oldest emission, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// When it was complete, CLOCK_BOOTTIME.
        t_completed_ns: u64,
        /// Height of the floor above the sensors' origins, median of the last echoes from straight below; NaN while unknown.
        floor_m: f64,
        /// Height of the ceiling; NaN while unknown.
        ceiling_m: f64,
        /// Nearest obstacle of each bearing from the robot's centre, two degrees each from straight behind on; +inf without one.
        slice_m: [f32; SLICE_BEARINGS],
        /// Places, forward.
        x_m: [f32; POINTS_MAX],
        /// To the left.
        y_m: [f32; POINTS_MAX],
        /// Above the sensors' origins.
        z_m: [f32; POINTS_MAX],
        /// Covariance, forward.
        variance_x_m2: [f32; POINTS_MAX],
        /// Forward and left.
        covariance_xy_m2: [f32; POINTS_MAX],
        /// Forward and up.
        covariance_xz_m2: [f32; POINTS_MAX],
        /// Left.
        variance_y_m2: [f32; POINTS_MAX],
        /// Left and up.
        covariance_yz_m2: [f32; POINTS_MAX],
        /// Up.
        variance_z_m2: [f32; POINTS_MAX],
        /// Envelope, linear amplitude in units of full scale.
        energy: [f32; POINTS_MAX],
        /// Sensor that heard it, in the order of the configuration.
        sensor_index: [u32; POINTS_MAX],
        /// 0 floor, 1 obstacle, 2 overhang, 3 ceiling.
        class: [u32; POINTS_MAX],
        /// Number of points.
        point_count: u32,
        /// Of these, those at the robot's height.
        obstacle_count: u32,
    }
}

impl PointCloud3 {
    /// Takes over a cloud that was complete at `completed_ns` of CLOCK_BOOTTIME.
    pub fn fill(&mut self, cloud: &PointCloud, completed_ns: u64) {
        *self = Self {
            sequence: cloud.sequence,
            t_monotonic_ns: cloud.emitted_at.boottime_ns,
            t_wall_ns: cloud.emitted_at.wall_ns,
            t_completed_ns: completed_ns,
            floor_m: cloud.floor_m.unwrap_or(f64::NAN),
            ceiling_m: cloud.ceiling_m.unwrap_or(f64::NAN),
            slice_m: cloud.slice_m.map(|range_m| range_m as f32),
            ..Self::blank()
        };
        for (index, point) in cloud.points.iter().take(POINTS_MAX).enumerate() {
            let (place, spread) = (point.position_m, point.covariance_m2);
            (self.x_m[index], self.y_m[index], self.z_m[index]) = (place.x as f32, place.y as f32, place.z as f32);
            self.variance_x_m2[index] = spread.m11 as f32;
            self.covariance_xy_m2[index] = spread.m12 as f32;
            self.covariance_xz_m2[index] = spread.m13 as f32;
            self.variance_y_m2[index] = spread.m22 as f32;
            self.covariance_yz_m2[index] = spread.m23 as f32;
            self.variance_z_m2[index] = spread.m33 as f32;
            self.energy[index] = point.energy;
            self.sensor_index[index] = point.sensor_index as u32;
            self.class[index] = point.class as u32;
            self.point_count += 1;
            self.obstacle_count += u32::from(point.class == SpaceClass::Obstacle);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::SpacePoint;
    use nalgebra::{Matrix3, Vector3};

    #[test]
    fn points_are_taken_over_in_order_and_nothing_of_an_earlier_cloud_stays() {
        let mut cloud = PointCloud::empty();
        let spread = Matrix3::new(1.0, 2.0, 3.0, 2.0, 4.0, 5.0, 3.0, 5.0, 6.0);
        let place = Vector3::new(7.0, 8.0, 9.0);
        let class = SpaceClass::Overhang;
        let one = SpacePoint { position_m: place, covariance_m2: spread, energy: 0.5, sensor_index: 2, class };
        cloud.points = vec![one, SpacePoint::default()];
        cloud.floor_m = Some(-0.4);
        cloud.slice_m[3] = 1.5;
        let mut wire = PointCloud3::blank();
        wire.fill(&cloud, 77);
        assert_eq!((wire.x_m[0], wire.y_m[0], wire.z_m[0]), (7.0, 8.0, 9.0));
        let covariance = [
            wire.variance_x_m2[0],
            wire.covariance_xy_m2[0],
            wire.covariance_xz_m2[0],
            wire.variance_y_m2[0],
            wire.covariance_yz_m2[0],
            wire.variance_z_m2[0],
        ];
        assert_eq!(covariance, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!((wire.energy[0], wire.sensor_index[0], wire.class[0]), (0.5, 2, 2));
        assert_eq!((wire.point_count, wire.obstacle_count, wire.t_completed_ns), (2, 1, 77));
        assert_eq!((wire.floor_m, wire.slice_m[3], wire.slice_m[4]), (-0.4, 1.5, f32::INFINITY));
        assert!(wire.ceiling_m.is_nan() && wire.schema_hash != 0);
        wire.fill(&PointCloud::empty(), 78);
        assert_eq!((wire.point_count, wire.x_m[0], wire.obstacle_count), (0, 0.0, 0));
    }
}
