//! What the program computes, put into the words of [`crate::io::plot`], which draws and computes nothing.
//!
//! Goes in: trials. Comes out: what the plots are made of. Draws nothing.

use super::trial::Trial;
use crate::io::plot::{PlottedPoint, PlottedRun};

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
