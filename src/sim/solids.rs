//! What of a world does not stand upright from below the sensors to above them: floor, ceiling, balls and bars.
//!
//! Goes in: tables of a world file. Comes out: checked shapes. Heights are those above the plane of the sensors' origins, as those of
//! jammers are. These things echo, and hide nothing; balls and bars stop a robot that reaches to their height. Computes no echo.

use crate::parameter::{ParameterError, check_positive, check_range};
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Deserializer, Serialize, de::Error as _};

/// Farthest coordinate, and the height that floor and ceiling may have at most.
const COORDINATE_MAX_M: f64 = 1e4;
const LEVEL_MAX_M: f64 = 100.0;
/// Steps of the search for the nearest place of a bar, each of which leaves two thirds: 1e-9 of its length.
const NARROWINGS: usize = 52;
/// Shortest bar.
const BAR_MIN_M: f64 = 1e-3;

/// A ball.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ball {
    /// Its middle: x, y and the height above the sensors' origins.
    #[serde(deserialize_with = "place")]
    pub centre: [f64; 3],
    /// Its radius.
    pub radius_m: f64,
}

/// A round bar with round ends, of any slope: the edge of a table, a barrier, a door sill.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bar {
    /// Where its axis begins: x, y and the height above the sensors' origins.
    #[serde(deserialize_with = "place")]
    pub from: [f64; 3],
    /// Where its axis ends.
    #[serde(deserialize_with = "place")]
    pub to: [f64; 3],
    /// Its radius, also that of its ends.
    pub radius_m: f64,
}

impl Ball {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        check_place("centre", self.centre)?;
        check_positive("radius_m", self.radius_m, 100.0)
    }
}

impl Bar {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        check_place("from", self.from)?;
        check_place("to", self.to)?;
        if !((Vector3::from(self.to) - Vector3::from(self.from)).norm() >= BAR_MIN_M) {
            return Err(ParameterError::new(
                "to",
                format!("{:?}", self.to),
                "a place at least 1 mm from the other end",
            ));
        }
        check_positive("radius_m", self.radius_m, 100.0)
    }
}

/// Judges the heights of floor and ceiling.
pub(super) fn check_levels(floor_m: Option<f64>, ceiling_m: Option<f64>) -> Result<(), ParameterError> {
    if let Some(floor_m) = floor_m {
        check_range("floor_m", floor_m, -LEVEL_MAX_M, -0.01)?;
    }
    ceiling_m.map_or(Ok(()), |ceiling_m| check_range("ceiling_m", ceiling_m, 0.01, LEVEL_MAX_M))
}

fn check_place(key: &str, place: [f64; 3]) -> Result<(), ParameterError> {
    for (axis, coordinate_m) in place.iter().enumerate() {
        check_range(&format!("{key}[{axis}]"), *coordinate_m, -COORDINATE_MAX_M, COORDINATE_MAX_M)?;
    }
    Ok(())
}

/// Three coordinates, no more: a plain array would quietly drop a fourth.
fn place<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 3], D::Error> {
    let coordinates = Vec::<f64>::deserialize(deserializer)?;
    let count = coordinates.len();
    coordinates
        .try_into()
        .map_err(|_| D::Error::custom(format!("found {count} coordinates, allowed: 3, as in [1.0, 2.0, 0.3]")))
}

/// The solids of a world, as the echoes ask for them.
#[derive(Debug, Clone, Default)]
pub(super) struct Solids {
    pub(super) floor_m: Option<f64>,
    pub(super) ceiling_m: Option<f64>,
    pub(super) balls: Vec<Ball>,
    pub(super) bars: Vec<Bar>,
}

impl Solids {
    /// Gap between a robot and the nearest ball or bar, in the plane, as far as it lies between the heights `z_m` of the robot; negative
    /// in a contact, infinite where there is none at its height. `robot_m` is the signed distance of a point from the footprint,
    /// which must be convex.
    pub(super) fn gap_m(&self, z_m: [f64; 2], robot_m: impl Fn(Vector2<f64>) -> f64) -> f64 {
        let balls = self.balls.iter().map(|ball| (ball.centre, ball.centre, ball.radius_m));
        let bars = self.bars.iter().map(|bar| (bar.from, bar.to, bar.radius_m));
        let gap_m = |(from, to, radius_m): ([f64; 3], [f64; 3], f64)| {
            gap_of_bar_m((from.into(), to.into()), radius_m, z_m, &robot_m)
        };
        balls.chain(bars).map(gap_m).fold(f64::INFINITY, f64::min)
    }
}

/// The gap to one bar. What of it lies at the robot's height is, seen from above, a row of discs along its axis: each as wide as the
/// ball around that place of the axis is at that height. The gap to the disc is a convex function of the place.
fn gap_of_bar_m(
    (from_m, to_m): (Vector3<f64>, Vector3<f64>),
    radius_m: f64,
    [low_m, high_m]: [f64; 2],
    robot_m: &impl Fn(Vector2<f64>) -> f64,
) -> f64 {
    let along_m = to_m - from_m;
    let reach_m = [low_m - radius_m, high_m + radius_m];
    let (mut first, mut last) = (0.0f64, 1.0f64);
    if along_m.z == 0.0 {
        if !(reach_m[0]..=reach_m[1]).contains(&from_m.z) {
            return f64::INFINITY;
        }
    } else {
        let [one, other] = reach_m.map(|level_m| (level_m - from_m.z) / along_m.z);
        (first, last) = (first.max(one.min(other)), last.min(one.max(other)));
        if first > last {
            return f64::INFINITY;
        }
    }
    let gap_m = |share: f64| {
        let axis_m = from_m + along_m * share;
        let off_m = (low_m - axis_m.z).max(axis_m.z - high_m).max(0.0);
        robot_m(axis_m.xy()) - (radius_m * radius_m - off_m * off_m).max(0.0).sqrt()
    };
    if along_m == Vector3::zeros() {
        return gap_m(0.0);
    }
    for _ in 0..NARROWINGS {
        let third = (last - first) / 3.0;
        if gap_m(first + third) <= gap_m(last - third) {
            last -= third;
        } else {
            first += third;
        }
    }
    gap_m(0.5 * (first + last))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// The gap of a robot of 0.2 m in the origin, from -0.1 to 0.3 m high.
    fn gap_m(solids: &Solids) -> f64 {
        solids.gap_m([-0.1, 0.3], |point_m| point_m.norm() - 0.2)
    }

    fn one_ball(z_m: f64) -> Solids {
        Solids { balls: vec![Ball { centre: [1.0, 0.0, z_m], radius_m: 0.1 }], ..Solids::default() }
    }

    fn one_bar(from: [f64; 3], to: [f64; 3]) -> Solids {
        Solids { bars: vec![Bar { from, to, radius_m: 0.05 }], ..Solids::default() }
    }

    #[test]
    fn closed_forms() {
        let near = |found_m: f64, true_m: f64| assert!((found_m - true_m).abs() < 1e-9, "{found_m} of {true_m}");
        near(gap_m(&one_ball(0.0)), 0.7);
        near(gap_m(&one_ball(0.3)), 0.7);
        // 0.06 above the robot a ball of 0.1 is 0.08 wide.
        near(gap_m(&one_ball(0.36)), 0.72);
        near(gap_m(&one_ball(-0.18)), 0.74);
        assert_eq!(gap_m(&one_ball(0.401)), f64::INFINITY);
        assert_eq!(gap_m(&one_ball(-0.201)), f64::INFINITY);
        near(gap_m(&one_bar([0.5, -3.0, 0.1], [0.5, 2.0, 0.1])), 0.25);
        near(gap_m(&one_bar([0.5, 1.2, 0.1], [0.5, 2.0, 0.1])), 1.3 - 0.25);
        assert_eq!(gap_m(&one_bar([0.5, -3.0, 0.36], [0.5, 2.0, 0.36])), f64::INFINITY);
        near(gap_m(&one_bar([0.1, -3.0, 0.1], [0.1, 2.0, 0.1])), -0.15);
        assert_eq!(gap_m(&Solids { floor_m: Some(-0.05), ..Solids::default() }), f64::INFINITY);
    }

    /// The oracle: points all over the bar, those at the robot's height alone.
    #[test]
    fn slanting_bars_end_where_the_robot_does() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let (mut met, mut passed) = (0, 0);
        for _ in 0..40 {
            let mut place = || std::array::from_fn(|axis| (random.random::<f64>() - 0.5) * [4.0, 4.0, 1.6][axis]);
            let (from, to): ([f64; 3], [f64; 3]) = (place(), place());
            let found_m = gap_m(&one_bar(from, to));
            let (from_m, along_m) = (Vector3::from(from), Vector3::from(to) - Vector3::from(from));
            let mut true_m = f64::INFINITY;
            for _ in 0..200_000 {
                let mut offset_m: Vector3<f64> = Vector3::from_fn(|_, _| random.random::<f64>() * 2.0 - 1.0);
                offset_m *= 0.05 / offset_m.norm().max(1.0);
                let point_m = from_m + along_m * random.random::<f64>() + offset_m;
                if (-0.1..=0.3).contains(&point_m.z) {
                    true_m = true_m.min(point_m.xy().norm() - 0.2);
                }
            }
            (met, passed) = (met + usize::from(true_m.is_finite()), passed + usize::from(!true_m.is_finite()));
            assert_eq!(found_m.is_finite(), true_m.is_finite(), "{from:?} {to:?}");
            // Points fall short of the surface: by 1.6 cm at most of these, where a bar only just reaches to the height.
            assert!(
                found_m == true_m || (0.0..0.03).contains(&(true_m - found_m)),
                "{found_m} {true_m} {from:?} {to:?}"
            );
        }
        assert!(met > 10 && passed > 2, "{met} {passed}");
    }
}
