//! What the detectors found, as it lies in shared memory: the range scan of the whole robot, the obstacle on the planned way, the
//! objects around the robot with the map of them.
//!
//! Layouts only, and the conversion of the scan. Ranges as in ROS: +inf for nothing within range, NaN for what cannot be known.

use super::wire_type;
use crate::signal::{PEAKS_MAX, RAYS, Reading, RobotScan};
use iceoryx2::prelude::ZeroCopySend;

/// Virtual sonars of the vector projection.
pub const PROJECTION_SONARS: usize = 8;
/// Virtual sonars of the ring.
pub const RING_SONARS: usize = 12;
/// Points of a sub-route told.
pub const ROUTE_POINTS: usize = 4;
/// Objects told at a time.
pub const OBJECTS_MAX: usize = 32;
/// Cells of the map along each axis.
pub const MAP_CELLS: usize = 64;
/// A cell of the map of which nothing is known.
pub const MAP_UNKNOWN: i16 = -1;

wire_type! {
    /// The nearest echo around the robot, fused from all sensors: a ray a degree from the robot's origin, and the reflectors behind them.
    Scan = "noctule.Scan.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Sequence of the newest ping that went in.
        sequence: u64,
        /// Oldest emission that went in, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// When the scan was complete, CLOCK_BOOTTIME.
        t_completed_ns: u64,
        /// Bearing of the first ray in the robot frame.
        bearing_first_rad: f64,
        /// Step between rays, counter-clockwise.
        bearing_step_rad: f64,
        /// Nearest range from the robot's origin that any sensor sees.
        range_min_m: f64,
        /// Farthest range from the robot's origin that any sensor sees.
        range_max_m: f64,
        /// Range of the nearest echo; +inf for nothing within range, NaN for unseen.
        range_m: [f32; RAYS],
        /// Envelope of that echo, 1 is full scale.
        amplitude: [f32; RAYS],
        /// Standard deviation of its range.
        range_sigma_m: [f32; RAYS],
        /// Standard deviation of its bearing: small at a reflector, large in the skirt of its main lobe.
        bearing_sigma_rad: [f32; RAYS],
        /// Range up to which the ray is known to hold no echo.
        free_m: [f32; RAYS],
        /// 0 unseen, 1 nothing within range, 2 echo.
        answer: [u32; RAYS] as answer_name,
        /// Reflectors, nearest first: forward of the robot.
        peak_x_m: [f32; PEAKS_MAX],
        /// To its left.
        peak_y_m: [f32; PEAKS_MAX],
        /// Envelope, 1 is full scale.
        peak_amplitude: [f32; PEAKS_MAX],
        /// Standard deviation along the line of sight.
        peak_range_sigma_m: [f32; PEAKS_MAX],
        /// Standard deviation of the bearing from the sensor.
        peak_bearing_sigma_rad: [f32; PEAKS_MAX],
        /// Index of the sensor that heard it.
        peak_sensor: [u32; PEAKS_MAX],
        /// Number of reflectors.
        peak_count: u32,
        /// Bit k is set when sensor k went in.
        sensors_used: u32,
    }
}

wire_type! {
    /// What the vector projection says of the planned way: is something in it, where, and how to pass.
    Obstacle = "noctule.Obstacle.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Sequence of the scan.
        sequence: u64,
        /// Oldest emission that went in, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// When it was complete, CLOCK_BOOTTIME.
        t_completed_ns: u64,
        /// Projection of each sonar's vector on the way, 0 to 10.
        projection: [f64; PROJECTION_SONARS],
        /// What each sonar reads, from its transducer; +inf for nothing within range, NaN for unseen.
        reading_m: [f64; PROJECTION_SONARS],
        /// Distance of the robot from the planned edge; NaN without one.
        edge_distance_m: f64,
        /// Distance from the edge beyond which the detector is blind.
        blind_beyond_m: f64,
        /// Obstacle: nearest point of it, x in the frame of odometry; NaN without one.
        x_m: f64,
        /// The same, y.
        y_m: f64,
        /// Where it begins along the edge, from the edge's start.
        along_near_m: f64,
        /// Where it ends as far as it was seen.
        along_far_m: f64,
        /// Its right end across the edge, left of the edge positive.
        across_right_m: f64,
        /// Its left end.
        across_left_m: f64,
        /// Standard deviation of these.
        extent_sigma_m: f64,
        /// Free width between the obstacle and what stands to its left; +inf for nothing seen, NaN for unknown.
        passage_left_m: f64,
        /// The same to its right.
        passage_right_m: f64,
        /// Sub-route, x of up to four points in the frame of odometry.
        route_x_m: [f64; ROUTE_POINTS],
        /// The same, y.
        route_y_m: [f64; ROUTE_POINTS],
        /// Forward speed that the follower wishes; the layers have the last word.
        wish_linear_m_s: f64,
        /// Turn rate that it wishes.
        wish_angular_rad_s: f64,
        /// Points of the sub-route.
        route_count: u32,
        /// Index of the planned edge; 4294967295 without one.
        edge_index: u32,
        /// Whether an obstacle is detected.
        detected: u32,
        /// Sonar with the largest projection, where one is above the threshold; 4294967295 for none.
        sonar: u32,
        /// Whether the robot is too far from the edge to judge: that nothing is detected then means nothing.
        blind: u32,
        /// Whether a cone ahead is not seen: then the follower waits.
        cannot_see: u32,
        /// Whether the far end of the obstacle was seen.
        far_end_seen: u32,
        /// Whether the obstacle reaches into the safe path along the edge.
        in_the_way: u32,
        /// Bit k is set when sensor k went in.
        sensors_used: u32,
        /// What the follower does.
        follower: u32 as follower_name,
    }
}

wire_type! {
    /// Objects around the robot by the virtual sonar ring, and the occupancy map.
    Objects = "noctule.Objects.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Sequence of the scan.
        sequence: u64,
        /// Oldest emission that went in, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// When it was complete, CLOCK_BOOTTIME.
        t_completed_ns: u64,
        /// Where the robot was, x in the frame of the objects.
        robot_x_m: f64,
        /// The same, y.
        robot_y_m: f64,
        /// The same, heading.
        robot_heading_rad: f64,
        /// What each sonar of the ring reads, from the ring; +inf for nothing within range, NaN for unseen.
        reading_m: [f64; RING_SONARS],
        /// Objects, the surest first: x.
        x_m: [f64; OBJECTS_MAX],
        /// y.
        y_m: [f64; OBJECTS_MAX],
        /// Variance of x.
        variance_x_m2: [f64; OBJECTS_MAX],
        /// Covariance of x and y.
        covariance_xy_m2: [f64; OBJECTS_MAX],
        /// Variance of y.
        variance_y_m2: [f64; OBJECTS_MAX],
        /// x of the middle of the map's first cell.
        map_x_m: f64,
        /// The same, y.
        map_y_m: f64,
        /// Edge of a cell.
        cell_m: f64,
        /// How sure each object is, 0 to 1.
        score: [f32; OBJECTS_MAX],
        /// First sonar of the pair that heard it last; the second is its neighbour to the left.
        pair: [u32; OBJECTS_MAX],
        /// Number of objects.
        object_count: u32,
        /// 0 frame of odometry; 1 robot frame, where nobody tells odometry: then nothing is kept from one ping set to the next.
        frame: u32 as frame_name,
        /// Cells of the map, row after row of rising y: occupied to 0 to 100 per cent, -1 for unknown.
        map: [i16; MAP_CELLS * MAP_CELLS],
    }
}

const FRAMES: [&str; 2] = ["odometry", "robot"];

pub(crate) fn frame_name(number: u32) -> Option<&'static str> {
    FRAMES.get(number as usize).copied()
}

const FOLLOWER_STATES: [&str; 7] = ["IDLE", "FOLLOW", "MEASURE", "PASS", "RETURN", "BLOCKED", "ARRIVED"];

pub(crate) fn follower_name(number: u32) -> Option<&'static str> {
    FOLLOWER_STATES.get(number as usize).copied()
}

const ANSWERS: [&str; 3] = ["unseen", "clear", "echo"];

pub(crate) fn answer_name(number: u32) -> Option<&'static str> {
    ANSWERS.get(number as usize).copied()
}

/// Range and answer of a reading on the wire.
#[must_use]
pub fn answered(reading: Reading) -> (f32, u32) {
    match reading {
        Reading::Unseen => (f32::NAN, 0),
        Reading::Clear => (f32::INFINITY, 1),
        Reading::Echo { range_m, .. } => (range_m as f32, 2),
    }
}

impl Scan {
    /// Takes over a scan that was complete at `completed_ns` of CLOCK_BOOTTIME.
    pub fn fill(&mut self, scan: &RobotScan, completed_ns: u64) {
        self.sequence = scan.sequence;
        self.t_monotonic_ns = scan.emitted_at.boottime_ns;
        self.t_wall_ns = scan.emitted_at.wall_ns;
        self.t_completed_ns = completed_ns;
        self.bearing_first_rad = RobotScan::bearing_rad(0);
        self.bearing_step_rad = RobotScan::bearing_rad(1) - RobotScan::bearing_rad(0);
        [self.range_min_m, self.range_max_m] = scan.range_m;
        self.sensors_used = scan.sensors_used;
        for (index, ray) in scan.rays.iter().enumerate() {
            (self.range_m[index], self.answer[index]) = answered(ray.reading);
            self.amplitude[index] = match ray.reading {
                Reading::Echo { energy, .. } => energy,
                Reading::Clear | Reading::Unseen => 0.0,
            };
            self.range_sigma_m[index] = ray.range_sigma_m as f32;
            self.bearing_sigma_rad[index] = ray.bearing_sigma_rad as f32;
            self.free_m[index] = ray.free_m as f32;
        }
        self.peak_count = scan.peaks.len().min(PEAKS_MAX) as u32;
        for index in 0..PEAKS_MAX {
            let peak = scan.peaks.get(index);
            self.peak_x_m[index] = peak.map_or(0.0, |peak| peak.position_m.x as f32);
            self.peak_y_m[index] = peak.map_or(0.0, |peak| peak.position_m.y as f32);
            self.peak_amplitude[index] = peak.map_or(0.0, |peak| peak.energy);
            self.peak_range_sigma_m[index] = peak.map_or(0.0, |peak| peak.range_sigma_m as f32);
            self.peak_bearing_sigma_rad[index] = peak.map_or(0.0, |peak| peak.bearing_sigma_rad as f32);
            self.peak_sensor[index] = peak.map_or(0, |peak| peak.sensor_index as u32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::wire::{WireType, fields_json};
    use crate::signal::{Peak, Ray};
    use nalgebra::Vector2;

    #[test]
    fn the_three_answers_stay_apart_and_reflectors_that_went_away_are_gone() {
        let mut scan = RobotScan::unseen();
        let echo = Reading::Echo { range_m: 1.5, energy: 0.25 };
        scan.rays[RobotScan::ray_at(0.0)] =
            Ray { reading: echo, range_sigma_m: 0.01, bearing_sigma_rad: 0.02, free_m: 1.5 };
        scan.rays[0].reading = Reading::Clear;
        let peak = Peak {
            position_m: Vector2::new(1.5, 0.0),
            sensor_m: Vector2::zeros(),
            range_sigma_m: 0.01,
            bearing_sigma_rad: 0.02,
            energy: 0.25,
            sensor_index: 1,
        };
        scan.peaks.extend([peak, peak]);
        let mut wire = Scan::blank();
        wire.fill(&scan, 7);
        scan.peaks.pop();
        wire.fill(&scan, 8);
        let fields = fields_json(Scan::FIELDS, bytemuck::bytes_of(&wire));
        assert_eq!((&fields["answer"][0], &fields["answer"][1]), (&"clear".into(), &"unseen".into()));
        assert_eq!((&fields["answer"][180], wire.range_m[180], wire.amplitude[180]), (&"echo".into(), 1.5, 0.25));
        assert!(wire.range_m[0] == f32::INFINITY && wire.range_m[1].is_nan());
        assert_eq!((wire.peak_count, wire.peak_x_m[0], wire.peak_x_m[1], wire.t_completed_ns), (1, 1.5, 0.0, 8));
        let behind = wire.bearing_first_rad + 90.0 * wire.bearing_step_rad;
        assert!((behind + std::f64::consts::FRAC_PI_2).abs() < 1e-12, "the ray after a quarter looks right");
    }
}
