//! What of a world does not stand upright from below the sensors to above them: floor, ceiling, balls and bars.
//!
//! Goes in: tables of a world file. Comes out: checked shapes. Heights are those above the plane of the sensors' origins, as those of
//! jammers are. These things echo, and hide nothing; the robot does not run into them. Computes no echo.

use crate::parameter::{ParameterError, check_positive, check_range};
use nalgebra::Vector3;
use serde::{Deserialize, Deserializer, Serialize, de::Error as _};

/// Farthest coordinate, and the height that floor and ceiling may have at most.
const COORDINATE_MAX_M: f64 = 1e4;
const LEVEL_MAX_M: f64 = 100.0;
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
