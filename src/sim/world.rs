//! World files (specification, section 8): TOML in, a checked [`World`] out.
//!
//! A world is plane and vertical: everything in it stands upright from the floor past the sensors, but for the floor, the ceiling,
//! balls and bars of [`super::solids`]. This file says what stands where and what counts as a success; it computes no echo and moves nothing.

use super::solids::{Ball, Bar, check_levels};
use crate::document::{self, DocumentError};
use crate::parameter::{ParameterError, check_positive, check_range};
use nalgebra::Vector2;
use serde::{Deserialize, Deserializer, Serialize, de::Error as _};
use std::path::Path;

/// Farthest coordinate that a world may use.
const COORDINATE_MAX_M: f64 = 1e4;
/// Neighbouring points closer than this are one point, written twice by mistake.
const POINT_GAP_MIN_M: f64 = 1e-3;

const DEFAULT_WORLD: &str = include_str!("../../fixtures/worlds/default.toml");

/// A world file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct World {
    /// Places to be reached one after the other.
    #[serde(deserialize_with = "points")]
    pub waypoints: Vec<[f64; 2]>,
    /// Distance at which a waypoint counts as reached.
    pub reach_m: f64,
    /// A run ends here.
    pub time_limit_s: f64,
    /// The wanted velocity without waypoints or guidance; its linear part is also the guidance's cruising speed.
    pub input: WantedVelocity,
    /// Whether waypoints steer; if not they only score the run.
    pub guidance: bool,
    /// Specular walls.
    #[serde(rename = "wall")]
    pub walls: Vec<Wall>,
    /// Round obstacles that stand.
    #[serde(rename = "pillar")]
    pub pillars: Vec<Pillar>,
    /// Round obstacles that move.
    #[serde(rename = "mover")]
    pub movers: Vec<Mover>,
    /// Height of a smooth floor, negative, above the sensors' origins; without it there is none to be heard.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub floor_m: Option<f64>,
    /// Height of a smooth ceiling.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ceiling_m: Option<f64>,
    /// Balls, at any height.
    #[serde(rename = "ball", skip_serializing_if = "Vec::is_empty")]
    pub balls: Vec<Ball>,
    /// Bars, at any height and of any slope.
    #[serde(rename = "bar", skip_serializing_if = "Vec::is_empty")]
    pub bars: Vec<Bar>,
    /// Where the robot starts.
    pub start: Start,
}

/// A velocity as a world file writes it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WantedVelocity {
    /// Forward speed.
    pub linear_m_s: f64,
    /// Turn rate, counter-clockwise.
    pub angular_rad_s: f64,
}

/// A thin vertical wall along a line of points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// Points in order.
    #[serde(deserialize_with = "points")]
    pub points: Vec<[f64; 2]>,
    /// Whether the last point is joined to the first.
    #[serde(default)]
    pub closed: bool,
}

/// A vertical cylinder.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pillar {
    /// Its axis.
    #[serde(deserialize_with = "point")]
    pub centre: [f64; 2],
    /// Its radius.
    pub radius_m: f64,
}

/// A vertical cylinder that follows a path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mover {
    /// Its radius.
    pub radius_m: f64,
    /// Points in order; a single one stands still.
    #[serde(deserialize_with = "points")]
    pub path: Vec<[f64; 2]>,
    /// Speed along the path.
    #[serde(default = "default_mover_speed_m_s")]
    pub speed_m_s: f64,
    /// What happens at the end of the path.
    #[serde(default, rename = "loop")]
    pub repeat: PathLoop,
    /// Time at which it sets out; it stands at the first point before.
    #[serde(default)]
    pub start_s: f64,
}

fn default_mover_speed_m_s() -> f64 {
    0.5
}

/// What a mover does at the end of its path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PathLoop {
    /// Goes back the way it came, and so on.
    #[default]
    PingPong,
    /// Goes straight to the first point and round again.
    Cycle,
    /// Stays.
    Once,
}

/// The start zone: uniform in a rectangle and in heading.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Start {
    /// Corner of the rectangle with the smallest x and y.
    #[serde(deserialize_with = "point")]
    pub corner: [f64; 2],
    /// Width (x) and height (y).
    #[serde(deserialize_with = "point")]
    pub size: [f64; 2],
    /// Middle of the heading's interval.
    pub heading_deg: f64,
    /// Half the width of the heading's interval.
    pub heading_spread_deg: f64,
}

/// Two coordinates, no more: a plain array would quietly drop a third.
fn point<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
    let coordinates = Vec::<f64>::deserialize(deserializer)?;
    let count = coordinates.len();
    coordinates
        .try_into()
        .map_err(|_| D::Error::custom(format!("found {count} coordinates, allowed: 2, as in [1.0, 2.0]")))
}

fn points<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 2]>, D::Error> {
    #[derive(Deserialize)]
    #[serde(transparent)]
    struct Point(#[serde(deserialize_with = "point")] [f64; 2]);
    Ok(Vec::<Point>::deserialize(deserializer)?.into_iter().map(|point| point.0).collect())
}

impl Default for WantedVelocity {
    fn default() -> Self {
        Self { linear_m_s: 0.3, angular_rad_s: 0.0 }
    }
}

impl Default for World {
    fn default() -> Self {
        Self {
            waypoints: Vec::new(),
            reach_m: 0.3,
            time_limit_s: 120.0,
            input: WantedVelocity::default(),
            guidance: true,
            walls: Vec::new(),
            pillars: Vec::new(),
            movers: Vec::new(),
            floor_m: None,
            ceiling_m: None,
            balls: Vec::new(),
            bars: Vec::new(),
            start: Start::default(),
        }
    }
}

/// A piece of the picture of a world; see [`World::outline`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outline {
    /// Piece of a wall.
    Segment {
        /// One end.
        from_m: Vector2<f64>,
        /// The other end.
        to_m: Vector2<f64>,
    },
    /// Pillar or mover.
    Circle {
        /// Axis.
        centre_m: Vector2<f64>,
        /// Radius.
        radius_m: f64,
        /// Whether it is a mover.
        moving: bool,
    },
}

impl World {
    /// Parses `text`, the content of `path` (the name is for messages only).
    ///
    /// # Errors
    /// [`DocumentError`] for bad syntax, an unknown key, or a value that [`World::validate`] refuses.
    pub fn parse(path: &Path, text: &str) -> Result<Self, DocumentError> {
        document::parse(path, text, World::validate)
    }

    /// Reads and parses a world file.
    ///
    /// # Errors
    /// [`DocumentError`] when the file cannot be read, and as [`World::parse`].
    pub fn load(path: &Path) -> Result<Self, DocumentError> {
        document::load(path, World::validate)
    }

    /// The built-in world: an office loop of 10 m by 8 m with a corridor, doors, round obstacles and two movers.
    ///
    /// # Errors
    /// As [`World::parse`]; a test holds the built-in file to be valid.
    pub fn default_world() -> Result<Self, DocumentError> {
        Self::parse(Path::new("default.toml"), DEFAULT_WORLD)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed.
    pub fn validate(&self) -> Result<(), ParameterError> {
        for (index, point) in self.waypoints.iter().enumerate() {
            check_point(&format!("waypoints[{index}]"), *point)?;
        }
        check_positive("reach_m", self.reach_m, 100.0)?;
        check_positive("time_limit_s", self.time_limit_s, 1e6)?;
        check_range("input.linear_m_s", self.input.linear_m_s, -10.0, 10.0)?;
        check_range("input.angular_rad_s", self.input.angular_rad_s, -10.0, 10.0)?;
        for (index, wall) in self.walls.iter().enumerate() {
            wall.validate().map_err(|error| error.within(&format!("wall[{index}]")))?;
        }
        for (index, pillar) in self.pillars.iter().enumerate() {
            let table = format!("pillar[{index}]");
            check_point("centre", pillar.centre).map_err(|error| error.within(&table))?;
            check_positive("radius_m", pillar.radius_m, 100.0).map_err(|error| error.within(&table))?;
        }
        for (index, mover) in self.movers.iter().enumerate() {
            mover.validate().map_err(|error| error.within(&format!("mover[{index}]")))?;
        }
        check_levels(self.floor_m, self.ceiling_m)?;
        for (index, ball) in self.balls.iter().enumerate() {
            ball.validate().map_err(|error| error.within(&format!("ball[{index}]")))?;
        }
        for (index, bar) in self.bars.iter().enumerate() {
            bar.validate().map_err(|error| error.within(&format!("bar[{index}]")))?;
        }
        self.start.validate().map_err(|error| error.within("start"))
    }

    /// Everything that stands in the world at `time_s`, for drawing: seen from above, floor and ceiling left out.
    pub fn outline(&self, time_s: f64) -> impl Iterator<Item = Outline> + '_ {
        let walls =
            self.walls.iter().flat_map(|wall| wall.pieces().map(|(from_m, to_m)| Outline::Segment { from_m, to_m }));
        let pillars = self.pillars.iter().map(|pillar| Outline::Circle {
            centre_m: Vector2::from(pillar.centre),
            radius_m: pillar.radius_m,
            moving: false,
        });
        let movers = self.movers.iter().map(move |mover| Outline::Circle {
            centre_m: mover.position_m(time_s),
            radius_m: mover.radius_m,
            moving: true,
        });
        let balls = self.balls.iter().map(|ball| Outline::Circle {
            centre_m: Vector2::new(ball.centre[0], ball.centre[1]),
            radius_m: ball.radius_m,
            moving: false,
        });
        let bars = self.bars.iter().map(|bar| Outline::Segment {
            from_m: Vector2::new(bar.from[0], bar.from[1]),
            to_m: Vector2::new(bar.to[0], bar.to[1]),
        });
        walls.chain(pillars).chain(movers).chain(balls).chain(bars)
    }
}

impl Wall {
    fn validate(&self) -> Result<(), ParameterError> {
        let needed = if self.closed { 3 } else { 2 };
        if self.points.len() < needed {
            let allowed =
                format!("at least {needed} points for {} wall", if self.closed { "a closed" } else { "an open" });
            return Err(ParameterError::new("points", format!("{} points", self.points.len()), allowed));
        }
        check_path("points", &self.points)?;
        if self.closed && gap_m(self.points[0], self.points[self.points.len() - 1]) < POINT_GAP_MIN_M {
            return Err(ParameterError::new(
                "points",
                "a last point equal to the first",
                "a closed wall without its first point repeated",
            ));
        }
        Ok(())
    }

    /// Its straight pieces, the closing one included.
    pub fn pieces(&self) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + '_ {
        let count = if self.closed { self.points.len() } else { self.points.len().saturating_sub(1) };
        (0..count).map(|index| {
            let next = (index + 1) % self.points.len();
            (Vector2::from(self.points[index]), Vector2::from(self.points[next]))
        })
    }
}

impl Mover {
    fn validate(&self) -> Result<(), ParameterError> {
        check_positive("radius_m", self.radius_m, 100.0)?;
        check_range("speed_m_s", self.speed_m_s, 0.0, 20.0)?;
        check_range("start_s", self.start_s, 0.0, 1e6)?;
        if self.path.is_empty() {
            return Err(ParameterError::new("path", "no point", "at least one point"));
        }
        check_path("path", &self.path)
    }

    /// Where its axis is at `time_s`.
    ///
    /// Computed from the time alone, so a run may jump in time and two runs agree. A path must not be empty.
    #[must_use]
    pub fn position_m(&self, time_s: f64) -> Vector2<f64> {
        let closing = usize::from(self.repeat == PathLoop::Cycle);
        let piece = |index: usize| {
            let from = Vector2::from(self.path[index]);
            let to = Vector2::from(self.path[(index + 1) % self.path.len()]);
            (from, to, (to - from).norm())
        };
        let piece_count = self.path.len() - 1 + closing;
        let length_m: f64 = (0..piece_count).map(|index| piece(index).2).sum();
        let travelled_m = self.speed_m_s * (time_s - self.start_s).max(0.0);
        if length_m < POINT_GAP_MIN_M {
            return Vector2::from(self.path[0]);
        }
        let mut along_m = match self.repeat {
            PathLoop::Once => travelled_m.min(length_m),
            PathLoop::Cycle => travelled_m.rem_euclid(length_m),
            PathLoop::PingPong => {
                let there_and_back_m = travelled_m.rem_euclid(2.0 * length_m);
                there_and_back_m.min(2.0 * length_m - there_and_back_m)
            }
        };
        for index in 0..piece_count {
            let (from, to, piece_m) = piece(index);
            if along_m <= piece_m {
                return from + (to - from) * (along_m / piece_m);
            }
            along_m -= piece_m;
        }
        piece(piece_count - 1).1
    }
}

impl Start {
    fn validate(&self) -> Result<(), ParameterError> {
        check_point("corner", self.corner)?;
        for (index, size_m) in self.size.iter().enumerate() {
            check_range(&format!("size[{index}]"), *size_m, 0.0, COORDINATE_MAX_M)?;
        }
        check_range("heading_deg", self.heading_deg, -360.0, 360.0)?;
        check_range("heading_spread_deg", self.heading_spread_deg, 0.0, 180.0)
    }
}

fn check_point(key: &str, point: [f64; 2]) -> Result<(), ParameterError> {
    for (axis, coordinate_m) in point.iter().enumerate() {
        check_range(&format!("{key}[{axis}]"), *coordinate_m, -COORDINATE_MAX_M, COORDINATE_MAX_M)?;
    }
    Ok(())
}

fn check_path(key: &str, points: &[[f64; 2]]) -> Result<(), ParameterError> {
    for (index, point) in points.iter().enumerate() {
        check_point(&format!("{key}[{index}]"), *point)?;
        if index > 0 && gap_m(points[index - 1], *point) < POINT_GAP_MIN_M {
            let found = format!("[{}, {}] after the same point", point[0], point[1]);
            return Err(ParameterError::new(
                format!("{key}[{index}]"),
                found,
                "a point at least 1 mm from the one before",
            ));
        }
    }
    Ok(())
}

fn gap_m(first: [f64; 2], second: [f64; 2]) -> f64 {
    (Vector2::from(first) - Vector2::from(second)).norm()
}
