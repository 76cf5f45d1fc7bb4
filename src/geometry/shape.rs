//! The closed shapes that regions and obstructions are made of (specification, section 7), in one frame, metres.
//!
//! One invocation answers "is this point inside?", "where does this ray enter?" or "how far is this point from the
//! edge?"; nothing here knows what a shape is used for.

use crate::parameter::ParameterError;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// A shape as the configuration writes it: `{ shape = "circle", centre_m = [x, y], radius_m = r }`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "kebab-case", deny_unknown_fields)]
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
