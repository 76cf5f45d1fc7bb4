//! The closed shapes that regions and obstructions are made of (specification, section 7), in one frame, metres.
//!
//! Goes in: a shape as the configuration writes it. Comes out: whether a point lies inside, how far it is from the
//! shape, and how far along a ray the shape begins. Edges count as inside. Nothing here knows what a shape is used for.

mod boundary;
mod read;
#[cfg(test)]
mod tests;

use crate::parameter::{ParameterError, check_positive, check_range};
use nalgebra::Vector2;
use serde::Serialize;

/// A point this near to an edge counts as lying on it, so that the edge itself is inside however it is rounded.
pub const EDGE_M: f64 = 1e-9;

/// Largest coordinate and radius accepted: far beyond the hearing of any sensor, near enough to keep [`EDGE_M`] exact.
pub const COORDINATE_MAX_M: f64 = 1000.0;

/// Most corners of a polygon.
pub const CORNERS_MAX: usize = 1000;

/// A shape as the configuration writes it: `{ shape = "circle", centre_m = [x, y], radius_m = r }`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "shape", rename_all = "kebab-case")]
pub enum Shape {
    /// Axis-parallel rectangle; an infinite end makes a strip or half-plane strip.
    Rectangle {
        /// Interval in x.
        x_m: [f64; 2],
        /// Interval in y.
        y_m: [f64; 2],
    },
    /// Disc.
    Circle {
        /// Centre.
        centre_m: [f64; 2],
        /// Radius.
        radius_m: f64,
    },
    /// The half of a disc that lies on the side of `heading_deg`.
    HalfCircle {
        /// Centre of the full disc.
        centre_m: [f64; 2],
        /// Radius.
        radius_m: f64,
        /// Direction that the half faces.
        heading_deg: f64,
    },
    /// Ring sector.
    Sector {
        /// Centre of the ring.
        centre_m: [f64; 2],
        /// Inner and outer radius.
        radius_m: [f64; 2],
        /// First and last bearing seen from the centre, counter-clockwise from the first to the last.
        bearing_deg: [f64; 2],
    },
    /// Trapezoid symmetric to the x axis.
    Trapezoid {
        /// Interval in x.
        x_m: [f64; 2],
        /// Half width at the first and at the last x.
        half_width_m: [f64; 2],
    },
    /// Simple polygon, closed by itself.
    Polygon {
        /// Corners in order, either way round.
        points_m: Vec<[f64; 2]>,
    },
}

impl Shape {
    /// Whether `point_m` lies inside or on the edge. A point with a NaN lies in no shape: a caller for whom "not inside" means
    /// "safe" has to refuse such points itself.
    #[must_use]
    pub fn contains(&self, point_m: Vector2<f64>) -> bool {
        self.distance_m(point_m) <= EDGE_M
    }

    /// Distance from `point_m` to the nearest point of the shape, zero inside; NaN for a point with a NaN.
    #[must_use]
    pub fn distance_m(&self, point_m: Vector2<f64>) -> f64 {
        if !(point_m.x.is_finite() && point_m.y.is_finite()) {
            return f64::NAN;
        }
        boundary::distance_m(self, point_m)
    }

    /// Distance along the ray from `origin_m` at which the shape begins: 0 when the origin is inside, `None` when the ray
    /// passes by. `unit_direction` has length 1. A ray that only touches a corner or an arc may count either way.
    #[must_use]
    pub fn first_hit_m(&self, origin_m: Vector2<f64>, unit_direction: Vector2<f64>) -> Option<f64> {
        if self.contains(origin_m) {
            return Some(0.0);
        }
        let mut crossings_m = boundary::crossings_m(self, origin_m, unit_direction);
        crossings_m.retain(|crossing_m| *crossing_m > 0.0 && crossing_m.is_finite());
        crossings_m.sort_by(f64::total_cmp);
        // Between two crossings the answer cannot change, so the middle of each stretch speaks for the whole of it. The
        // last stretch has no end: an infinite strip may begin there.
        crossings_m.iter().enumerate().find_map(|(index, &start_m)| {
            let end_m = crossings_m.get(index + 1).copied().unwrap_or(start_m + 2.0);
            self.contains(origin_m + unit_direction * (0.5 * (start_m + end_m))).then_some(start_m)
        })
    }

    /// Judges the numbers of the shape; `key` is the dotted path of the shape itself.
    ///
    /// # Errors
    /// The first number that is not allowed, with its key.
    pub fn validate(&self, key: &str) -> Result<(), ParameterError> {
        let refused = match self {
            Shape::Rectangle { x_m, y_m } => check_interval("x_m", x_m, true).and(check_interval("y_m", y_m, true)),
            Shape::Circle { centre_m, radius_m } => {
                check_point("centre_m", centre_m).and(check_positive("radius_m", *radius_m, COORDINATE_MAX_M))
            }
            Shape::HalfCircle { centre_m, radius_m, heading_deg } => check_point("centre_m", centre_m)
                .and(check_positive("radius_m", *radius_m, COORDINATE_MAX_M))
                .and(check_range("heading_deg", *heading_deg, -360.0, 360.0)),
            Shape::Sector { centre_m, radius_m, bearing_deg } => check_point("centre_m", centre_m)
                .and(check_ring("radius_m", radius_m))
                .and(check_bearings("bearing_deg", bearing_deg)),
            Shape::Trapezoid { x_m, half_width_m } => {
                check_interval("x_m", x_m, false).and(check_half_widths("half_width_m", half_width_m))
            }
            Shape::Polygon { points_m } => check_polygon(points_m),
        };
        refused.map_err(|error| error.within(key))
    }
}

/// Span of a sector's bearings in degrees, counter-clockwise, in (0, 360].
fn bearing_span_deg(bearing_deg: &[f64; 2]) -> f64 {
    let span_deg = (bearing_deg[1] - bearing_deg[0]).rem_euclid(360.0);
    if span_deg == 0.0 && bearing_deg[1] != bearing_deg[0] { 360.0 } else { span_deg }
}

pub(super) fn check_interval(key: &str, interval: &[f64; 2], infinite: bool) -> Result<(), ParameterError> {
    let end_allowed = |end: f64| end.abs() <= COORDINATE_MAX_M || (infinite && end.is_infinite());
    if interval[0] < interval[1] && end_allowed(interval[0]) && end_allowed(interval[1]) {
        return Ok(());
    }
    let infinity = if infinite { " (or -inf, inf)" } else { "" };
    let allowed = format!("[from, to] with from < to, from -{COORDINATE_MAX_M} to {COORDINATE_MAX_M}{infinity}");
    Err(ParameterError::new(key, pair(interval), allowed))
}

fn check_point(key: &str, point: &[f64; 2]) -> Result<(), ParameterError> {
    if point.iter().all(|coordinate| coordinate.abs() <= COORDINATE_MAX_M) {
        return Ok(());
    }
    let allowed = format!("[x, y], each from -{COORDINATE_MAX_M} to {COORDINATE_MAX_M}");
    Err(ParameterError::new(key, pair(point), allowed))
}

fn check_ring(key: &str, radius_m: &[f64; 2]) -> Result<(), ParameterError> {
    if radius_m[0] >= 0.0 && radius_m[1] > radius_m[0] && radius_m[1] <= COORDINATE_MAX_M {
        return Ok(());
    }
    let allowed = format!("[inner, outer] with 0 <= inner < outer <= {COORDINATE_MAX_M}");
    Err(ParameterError::new(key, pair(radius_m), allowed))
}

fn check_bearings(key: &str, bearing_deg: &[f64; 2]) -> Result<(), ParameterError> {
    let in_range = bearing_deg.iter().all(|bearing| bearing.abs() <= 360.0);
    // A thinner wedge would widen by EDGE_M to more than itself near the centre.
    if in_range && bearing_span_deg(bearing_deg) >= 0.01 && (bearing_deg[1] - bearing_deg[0]).abs() <= 360.0 {
        return Ok(());
    }
    let allowed = "[first, last], each from -360 to 360, at least 0.01 and at most 360 apart, counter-clockwise";
    Err(ParameterError::new(key, pair(bearing_deg), allowed))
}

fn check_half_widths(key: &str, half_width_m: &[f64; 2]) -> Result<(), ParameterError> {
    let in_range = half_width_m.iter().all(|width| *width >= 0.0 && *width <= COORDINATE_MAX_M);
    if in_range && half_width_m[0] + half_width_m[1] > 0.0 {
        return Ok(());
    }
    let allowed = format!("[at a, at b], each from 0 to {COORDINATE_MAX_M}, not both 0");
    Err(ParameterError::new(key, pair(half_width_m), allowed))
}

fn check_polygon(points_m: &[[f64; 2]]) -> Result<(), ParameterError> {
    let count = points_m.len();
    if !(3..=CORNERS_MAX).contains(&count) {
        return Err(ParameterError::new("points_m", format!("{count} points"), format!("3 to {CORNERS_MAX} points")));
    }
    for (index, point) in points_m.iter().enumerate() {
        check_point(&format!("points_m[{index}]"), point)?;
        if point == &points_m[(index + 1) % count] {
            let allowed = "a point that differs from the one after it (the polygon closes itself)";
            return Err(ParameterError::new(format!("points_m[{index}]"), pair(point), allowed));
        }
    }
    match boundary::first_crossing_edges(points_m) {
        Some((first, second)) => {
            let found = format!("a polygon whose edges {first} and {second} cross or touch");
            Err(ParameterError::new("points_m", found, "a polygon whose edges meet at its corners only"))
        }
        None => Ok(()),
    }
}

fn pair(values: &[f64; 2]) -> String {
    format!("[{}, {}]", values[0], values[1])
}
