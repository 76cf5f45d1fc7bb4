//! The figures of paper 000, drawn from our own drives and configurations; curves of measured times ([`curves()`]); and what one
//! ping was made of ([`heard()`], [`rectangular()`]); what stands where in space ([`space_panels()`]); how a robot moved by its echoes ([`motion_panels()`]); and what a detector knows of its surroundings ([`grid_map()`]).
//!
//! | figure | function | what goes in |
//! |---|---|---|
//! | 9 | [`heat_map()`] | a world and the ways of many runs through it |
//! | 1c | [`frames()`], [`energyscapes_together()`] | energyscapes |
//! | 4b, 5 | [`flow_lines()`] | lines of a sensor's image |
//! | 7 | [`regions()`] | a robot and the regions of its layers |
//! | 8 | [`masks_together()`] | the masks of a layer |
//! | 11, 12 | [`paths()`], [`paths_by_layout()`] | the same, coloured by the layer that decided |
//! | 8, 9 of paper 001 | [`edge_panels()`] | worlds with planned edges and ways |
//!
//! Every function is pure: the same input gives the same pixels. Whatever is not finite, or farther out than a world may
//! reach, is left out of the picture; no input panics. Nothing here computes a result, it only shows what it is handed.

mod chrome;
mod curves;
mod edges;
mod flow_lines;
mod frames;
mod grid_map;
mod heat_map;
mod motion;
mod regions;
mod robot;
mod signals;
mod space;
mod trajectories;
mod world;

pub use curves::{CurvePanel, CurvePoint, curves};
pub use edges::{Doing, EdgePanel, edge_panels};
pub use flow_lines::{FlowCurve, FlowMark, FlowPanel, flow_lines};
pub use frames::{energyscapes_together, frames};
pub use grid_map::{PlottedGrid, PlottedObject, grid_map};
pub use heat_map::{HeatMapOptions, HeatMeasure, heat_map};
pub use motion::{PlottedMotion, PlottedMover, motion_panels};
pub use regions::{PlottedRegions, masks_together, regions};
pub use robot::PlottedRobot;
pub use signals::{HeardPing, heard, rectangular};
pub use space::{PlottedSpace, PlottedSpacePoint, space_panels};
pub use trajectories::{PathsOptions, paths, paths_by_layout};

use crate::signal::LayerName;
use embedded_graphics::pixelcolor::{Rgb888, RgbColor};

/// A place that a robot came past, and who decided there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlottedPoint {
    /// True place in the world.
    pub x_m: f64,
    /// True place in the world.
    pub y_m: f64,
    /// The layer that made the decision.
    pub layer: LayerName,
}

/// One run through a world.
#[derive(Debug, Clone, PartialEq)]
pub struct PlottedRun<'a> {
    /// Name of the sensor layout.
    pub layout: &'a str,
    /// The way, a point a ping set. The last one is where the run ended.
    pub points: Vec<PlottedPoint>,
    /// Whether the run ended with a contact, at its last point.
    pub collided: bool,
    /// Whether the run reached its goal.
    pub reached_goal: bool,
}

/// Colour that stands for a layer in every plot: the palette of Okabe and Ito, which colour-blind readers can tell apart, with
/// a lighter grey and a darker violet, which their lightness alone sets off from the rest.
#[must_use]
pub fn layer_colour(layer: LayerName) -> [u8; 3] {
    let colour = layer_ink(layer);
    [colour.r(), colour.g(), colour.b()]
}

fn layer_ink(layer: LayerName) -> Rgb888 {
    match layer {
        LayerName::PassThrough => Rgb888::new(190, 190, 190),
        LayerName::CollisionAvoidance => Rgb888::new(213, 94, 0),
        LayerName::ObstacleAvoidance => Rgb888::new(240, 190, 0),
        LayerName::FlowFollowing => Rgb888::new(0, 114, 178),
        LayerName::CorridorFollowing => Rgb888::new(0, 158, 115),
        LayerName::Stopped => Rgb888::new(60, 10, 70),
    }
}

/// A layer as a legend names it.
fn layer_words(layer: LayerName) -> &'static str {
    match layer {
        LayerName::PassThrough => "passed through",
        LayerName::CollisionAvoidance => "collision avoidance",
        LayerName::ObstacleAvoidance => "obstacle avoidance",
        LayerName::FlowFollowing => "flow following",
        LayerName::CorridorFollowing => "corridor following",
        LayerName::Stopped => "stopped",
    }
}
