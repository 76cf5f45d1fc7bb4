//! The ways that sound takes over what is not upright: floor, ceiling, balls and bars.
//!
//! As the paths of [`super::path`], but with the angle off the boresight in space, not only the bearing. What hides them is still the
//! upright part of the world, seen from above; they hide nothing themselves. Only a sensor's own emission and that of others by one
//! reflection; no way over the floor and a wall. This file makes no samples.

use super::directivity::{piston, view};
use super::path::{Finder, Path, Shape};
use super::solid::{Rod, Solid};
use super::waveform::NODES;
use crate::sim::params::SimParams;
use nalgebra::{Vector2, Vector3};
use rustfft::num_complex::Complex;
use std::f64::consts::PI;

/// Parts of a bar's echo below this are none.
const PART_MIN: f64 = 1e-3;

impl Finder<'_> {
    /// Appends the paths over everything that is not upright.
    pub(super) fn solids(&self, paths: &mut Vec<Path>) {
        let solids = &self.sight.obstacles.solids;
        let (emitter_m, ear_m) = self.ends();
        for level_m in [solids.floor_m, solids.ceiling_m].into_iter().flatten() {
            let image_m = Vector3::new(emitter_m.x, emitter_m.y, 2.0 * level_m - emitter_m.z);
            // The reflection point divides the way as the heights above the level do.
            let share = (ear_m.z - level_m) / (ear_m.z - image_m.z);
            let at_m = ear_m + (image_m - ear_m) * share;
            if (emitter_m.z - level_m) * (ear_m.z - level_m) > 0.0 {
                self.enter((Shape::Image(emitter_m.xy()), image_m.z), at_m, 1.0, paths);
            }
        }
        for ball in &solids.balls {
            self.solid(Solid::ball(ball, emitter_m), 1.0, paths);
        }
        for bar in &solids.bars {
            let rod = Rod::new(bar);
            let whole = Solid::Bar { rod, emitter_m };
            if whole.holds(emitter_m) || whole.holds(ear_m) {
                // In line with the bar there is its end alone, and within it nothing.
                self.solid(rod.end(rod.along_m(emitter_m), emitter_m), 1.0, paths);
                continue;
            }
            let glint = whole.glint(ear_m);
            let (near_m, far_m) = ((glint.point_m - emitter_m).norm(), (glint.point_m - ear_m).norm());
            let wave_number = self.medium.wave_numbers_rad_m[NODES / 2];
            let fresnel_m = (PI / wave_number * near_m * far_m / (near_m + far_m)).sqrt();
            let inside_m = glint.along_m.min(rod.length_m - glint.along_m);
            let part = 0.5 + 0.5 * (1.5 * inside_m / fresnel_m).tanh();
            if part > PART_MIN {
                self.solid(whole, part, paths);
            }
            if inside_m < 0.0 {
                self.solid(rod.end(glint.along_m, emitter_m), 1.0, paths);
            }
        }
    }

    /// Emitter and middle of the microphones.
    fn ends(&self) -> (Vector3<f64>, Vector3<f64>) {
        let (emitter, receiver) = (self.station(self.emitter), self.station(self.receiver));
        let place = |plane_m: Vector2<f64>, height_m| Vector3::new(plane_m.x, plane_m.y, height_m);
        (place(emitter.emitter_m, emitter.emitter_height_m), place(receiver.ear_m, receiver.ear_height_m))
    }

    fn solid(&self, solid: Solid, part: f64, paths: &mut Vec<Path>) {
        let (emitter_m, ear_m) = self.ends();
        if solid.holds(emitter_m) || solid.holds(ear_m) {
            return;
        }
        let glint = solid.glint(ear_m);
        if glint.cos_incidence >= 1e-3 {
            self.enter((Shape::Solid(solid), emitter_m.z), glint.point_m, part, paths);
        }
    }

    /// Adds a way over `at_m`, unless it is too long, too weak or hidden.
    fn enter(&self, (shape, height_m): (Shape, f64), at_m: Vector3<f64>, part: f64, paths: &mut Vec<Path>) {
        let (emitter, receiver) = (self.station(self.emitter), self.station(self.receiver));
        let (emitter_m, ear_m) = self.ends();
        let mut path = Path { shape, emitter_height_m: height_m, response: [Complex::new(0.0, 0.0); NODES] };
        let (length_m, spreading) = path.at(receiver.ear_m, receiver.ear_height_m);
        if length_m >= self.length_max_m {
            return;
        }
        let off_axis_rad = |heading_rad: f64, from_m: Vector3<f64>| {
            Vector3::new(heading_rad.cos(), heading_rad.sin(), 0.0).angle(&(at_m - from_m))
        };
        let SimParams { view_full_rad: full, view_zero_rad: zero, emitter_radius_m, .. } = *self.params;
        let sent_rad = off_axis_rad(emitter.pose.heading_rad, emitter_m);
        let heard_rad = off_axis_rad(receiver.pose.heading_rad, ear_m);
        let gain = part * self.medium.source * view(sent_rad, full, zero) * view(heard_rad, full, zero);
        let legs = [(emitter.emitter_m, at_m.xy()), (at_m.xy(), receiver.ear_m)];
        if gain * spreading < self.params.weakest_amplitude
            || self.sight.hidden(&legs, emitter.looks_through, receiver.looks_through)
        {
            return;
        }
        for (node, response) in path.response.iter_mut().enumerate() {
            let sent = piston(emitter_radius_m, self.medium.wave_numbers_rad_m[node], sent_rad);
            let absorbed = (-self.medium.absorptions_np_m[node] * length_m).exp();
            *response = Complex::new(gain * sent * absorbed, 0.0);
        }
        paths.push(path);
    }
}
