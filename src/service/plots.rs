//! What the program computes, put into the words of [`crate::io::plot`], which draws and computes nothing.
//!
//! Goes in: trials, mounts and grids. Comes out: what the plots are made of. Draws nothing.

use super::trial::Trial;
use crate::flow::{flow_line, flow_rate};
use crate::geometry::polar_from_cartesian;
use crate::io::plot::{FlowCurve, FlowMark, FlowPanel, PlottedPoint, PlottedRun};
use crate::sensor::Mount;
use crate::signal::{PolarGrid, Velocity};
use nalgebra::Vector2;

/// Distance between the lines that are shown, and between the circles.
const LINE_STEP_M: f64 = 0.5;
/// Bearing from point to point of a line.
const BEARING_STEP_DEG: f64 = 0.25;
/// Lines are followed to this multiple of the farthest range, so that they leave the plot instead of ending in it.
const BEYOND: f64 = 20.0;
/// A line this near to the sensor itself is all at range zero.
const THROUGH_SENSOR_M: f64 = 1e-6;
/// The marked reflectors, robot frame: one ahead on the left and one beside on the right, as in figure 4a.
const REFLECTORS: [(&str, [f64; 2]); 2] = [("A", [1.3, 1.75]), ("B", [0.6, -1.6])];

/// The true way of a trial, a point a ping set, under the name of its sensor layout.
#[must_use]
pub fn plotted_run<'a>(layout: &'a str, trial: &Trial) -> PlottedRun<'a> {
    let points =
        trial.track.iter().map(|point| PlottedPoint { x_m: point.pose.x_m, y_m: point.pose.y_m, layer: point.layer });
    PlottedRun {
        layout,
        points: points.collect(),
        collided: trial.score.collided,
        reached_goal: trial.score.reached_goal,
    }
}

/// The flow lines of straight motion and of turning on the spot in a sensor's image, every half metre and through the marked
/// reflectors (paper 000, figures 4b and 5).
#[must_use]
pub fn flow_panels(mount: &Mount, grid: &PolarGrid) -> [FlowPanel; 2] {
    let bearings_rad = bearings_rad(grid);
    let range_max_m = grid.range_m(grid.range_count() - 1);
    let reach_m = mount.distance_m + range_max_m;
    let step_count = (reach_m / LINE_STEP_M).floor().clamp(0.0, 1000.0) as i32;
    let steps = |first: i32| (first..=step_count).map(|step| (f64::from(step) * LINE_STEP_M, None));
    let marked = |constant: fn(Vector2<f64>) -> f64| {
        REFLECTORS.iter().enumerate().map(move |(index, (_, place))| (constant(Vector2::from(*place)), Some(index)))
    };
    let ahead = Velocity::forward_m_s(1.0);
    let turn = Velocity { linear_m_s: 0.0, angular_rad_s: 1.0 };
    let mut straight = Vec::new();
    let own_m = mount.position_m().y;
    let apart = |(lateral_m, _): &(f64, Option<usize>)| (lateral_m - own_m).abs() > THROUGH_SENSOR_M;
    for (lateral_m, marked) in steps(-step_count).chain(marked(|place| place.y)).filter(apart) {
        let range_m = |bearing_rad| flow_line::flow_line_range_m(mount, lateral_m, bearing_rad);
        straight.extend(curves(mount, ahead, &bearings_rad, BEYOND * range_max_m, marked, range_m));
    }
    let mut round = Vec::new();
    for (radius_m, marked) in steps(1).chain(marked(|place| place.norm())) {
        for far in [true, false] {
            let range_m = |bearing_rad| match flow_line::rotation_circle_ranges_m(mount, radius_m, bearing_rad) {
                [near, None] => near.filter(|_| far),
                [near, beyond] => {
                    if far {
                        beyond
                    } else {
                        near
                    }
                }
            };
            round.extend(curves(mount, turn, &bearings_rad, BEYOND * range_max_m, marked, range_m));
        }
    }
    [
        FlowPanel { title: "driving straight ahead".to_owned(), curves: straight },
        FlowPanel { title: "turning left on the spot".to_owned(), curves: round },
    ]
}

/// Where a sensor hears the marked reflectors of [`flow_panels`], if it does.
#[must_use]
pub fn flow_marks(mount: &Mount, grid: &PolarGrid, hidden: &[bool]) -> Vec<FlowMark> {
    let heard = |place_m: [f64; 2]| {
        let (range_m, bearing_rad) = polar_from_cartesian(mount.pose().local_from_parent(Vector2::from(place_m)));
        grid.nearest_range_index(range_m)?;
        let distance = |index: &usize| (grid.directions()[*index].azimuth_rad - bearing_rad).abs();
        let nearest = (0..grid.direction_count()).min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        // Beyond the outermost direction by more than a step there is nothing to hear with.
        let in_view = distance(&nearest) < (std::f64::consts::PI / grid.direction_count() as f64).max(0.02);
        (in_view && !hidden.get(nearest).copied().unwrap_or(false)).then_some([bearing_rad, range_m])
    };
    REFLECTORS.iter().map(|(name, place_m)| FlowMark { name: (*name).to_owned(), place: heard(*place_m) }).collect()
}

/// Bearings from the rightmost to the leftmost direction.
fn bearings_rad(grid: &PolarGrid) -> Vec<f64> {
    let azimuths = || grid.directions().iter().map(|direction| direction.azimuth_rad);
    let (first, last) = (azimuths().fold(f64::INFINITY, f64::min), azimuths().fold(f64::NEG_INFINITY, f64::max));
    let half_step = 0.5 * (last - first) / (grid.direction_count().max(2) - 1) as f64;
    let span = last - first + 2.0 * half_step;
    let count = (span.to_degrees() / BEARING_STEP_DEG).ceil().clamp(1.0, 10_000.0) as usize;
    (0..=count).map(|index| first - half_step + span * index as f64 / count as f64).collect()
}

/// The pieces of the line at which `range_m` is a number, each in the direction in which its echoes move.
fn curves(
    mount: &Mount,
    velocity: Velocity,
    bearings_rad: &[f64],
    range_max_m: f64,
    marked: Option<usize>,
    range_m: impl Fn(f64) -> Option<f64>,
) -> Vec<FlowCurve> {
    let points: Vec<Option<[f64; 2]>> = bearings_rad
        .iter()
        .map(|bearing_rad| {
            range_m(*bearing_rad).filter(|range| *range <= range_max_m).map(|range| [*bearing_rad, range])
        })
        .collect();
    let pieces = points.split(Option::is_none).filter(|piece| piece.len() > 1);
    let oriented = |piece: &[Option<[f64; 2]>]| {
        let mut points: Vec<[f64; 2]> = piece.iter().copied().flatten().collect();
        let [bearing_rad, range_m] = points[points.len() / 2];
        if flow_rate(mount, velocity, range_m, bearing_rad).bearing_rad_s < 0.0 {
            points.reverse();
        }
        FlowCurve { points, marked }
    };
    pieces.map(oriented).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Direction;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn grid() -> PolarGrid {
        PolarGrid::new(
            (0..180).map(|index| Direction::horizontal((f64::from(index) - 89.5).to_radians())).collect(),
            0.3,
            0.05,
            95,
        )
    }

    /// Where a point of a sensor's image lies in the robot frame, written out.
    fn robot_point(mount: &Mount, [bearing_rad, range_m]: [f64; 2]) -> (f64, f64) {
        let heading_rad = mount.bearing_rad + mount.yaw_rad + bearing_rad;
        let x_m = mount.distance_m * mount.bearing_rad.cos() + range_m * heading_rad.cos();
        (x_m, mount.distance_m * mount.bearing_rad.sin() + range_m * heading_rad.sin())
    }

    #[test]
    fn driving_ahead_leaves_the_lateral_distance_and_lets_echoes_fall_back() {
        for bearing_rad in [0.0, 2.0 * PI / 3.0, -FRAC_PI_2] {
            let mount = Mount { distance_m: 0.2, bearing_rad, yaw_rad: 0.3 };
            let [straight, _] = flow_panels(&mount, &grid());
            assert!(straight.curves.len() > 10);
            for curve in &straight.curves {
                let places: Vec<_> = curve.points.iter().map(|point| robot_point(&mount, *point)).collect();
                // Points far out carry the rounding of their range.
                assert!(places.iter().all(|place| (place.1 - places[0].1).abs() < 1e-9), "{bearing_rad}");
                assert!(places.windows(2).all(|pair| pair[1].0 < pair[0].0), "echoes move backward");
            }
        }
    }

    #[test]
    fn turning_left_keeps_the_distance_and_carries_echoes_to_the_right() {
        let mount = Mount { distance_m: 0.7, bearing_rad: PI / 3.0, yaw_rad: -0.5 };
        let [_, round] = flow_panels(&mount, &grid());
        assert!(round.curves.len() > 10);
        for curve in &round.curves {
            let places: Vec<_> = curve.points.iter().map(|point| robot_point(&mount, *point)).collect();
            let radius = |place: &(f64, f64)| place.0.hypot(place.1);
            assert!(places.iter().all(|place| (radius(place) - radius(&places[0])).abs() < 1e-9));
            let turned = |pair: &[(f64, f64)]| pair[0].0 * pair[1].1 - pair[0].1 * pair[1].0;
            assert!(places.windows(2).all(|pair| turned(pair) < 0.0), "clockwise, seen from the robot");
        }
    }

    #[test]
    fn a_reflector_is_marked_where_it_is_heard_and_not_behind_the_sensor() {
        let ahead = Mount::default();
        let marks = flow_marks(&ahead, &grid(), &[]);
        let [bearing_rad, range_m] = marks[0].place.expect("A is ahead");
        assert!((bearing_rad - (1.75 / 1.3f64).atan()).abs() < 1e-12 && (range_m - 4.7525f64.sqrt()).abs() < 1e-12);
        assert!(flow_marks(&ahead, &grid(), &[true; 180])[0].place.is_none(), "hidden");
        let behind = Mount { yaw_rad: PI, ..ahead };
        assert!(flow_marks(&behind, &grid(), &[]).iter().all(|mark| mark.place.is_none()));
    }
}
