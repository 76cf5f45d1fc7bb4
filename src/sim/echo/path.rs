//! The ways that sound takes from an emitter to a sensor's microphones.
//!
//! Whether a path exists, what hides it and its colour are decided once, for the middle of the array; its length and
//! spreading are exact for every microphone. The world being vertical, a path is plane but for the difference in
//! height: its length is the hypotenuse of the plane length and that difference, also over edges and cylinders.
//! Planes are mirror images; edges are [`super::edge`], cylinders [`super::cylinder`], what is not upright [`super::space`]. Multipath of first order is what comes
//! over two walls, or over a wall and a cylinder in either order: mirror images again. This file makes no samples.

use super::air::absorption_np_m;
use super::cylinder::Bounce;
use super::directivity::{piston, view};
use super::edge;
use super::sight::Sight;
use super::solid::Solid;
use super::waveform::{NODES, Response, WaveformTable};
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::sim::obstacles::{Circle, Corner, Segment, cross};
use crate::sim::params::SimParams;
use nalgebra::{Vector2, Vector3};
use rustfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// No path is shorter than this: an emitter is not a point.
pub(super) const LENGTH_MIN_M: f64 = 1e-3;
/// Wedges this close to flat are walls.
const FLAT_RAD: f64 = 1e-3;

/// A sensor where it stands in the world at the moment of emission.
#[derive(Debug, Clone)]
pub(super) struct Station {
    pub(super) pose: Pose2,
    /// Emitter: place and height.
    pub(super) emitter_m: Vector2<f64>,
    pub(super) emitter_height_m: f64,
    /// Microphones: places and heights.
    pub(super) microphones_m: Vec<(Vector2<f64>, f64)>,
    /// Middle of the microphones.
    pub(super) ear_m: Vector2<f64>,
    pub(super) ear_height_m: f64,
    /// Corners of the housing.
    pub(super) housing_m: [Vector2<f64>; 4],
    /// Bit k: the housing of sensor k hides nothing from this sensor (its own, or one around it).
    pub(super) looks_through: u8,
}

impl Station {
    pub(super) fn new(emitter: &Vector3<f64>, microphones: &[Vector3<f64>]) -> Self {
        Self {
            pose: Pose2::default(),
            emitter_m: Vector2::zeros(),
            emitter_height_m: emitter.z,
            microphones_m: microphones.iter().map(|place| (Vector2::zeros(), place.z)).collect(),
            ear_m: Vector2::zeros(),
            ear_height_m: microphones.iter().map(|place| place.z).sum::<f64>() / microphones.len() as f64,
            housing_m: [Vector2::zeros(); 4],
            looks_through: 0,
        }
    }

    /// Puts the sensor, with `emitter` and `microphones` in its own frame, at `pose`.
    pub(super) fn place(&mut self, pose: Pose2, emitter: &Vector3<f64>, microphones: &[Vector3<f64>]) {
        self.pose = pose;
        self.emitter_m = pose.parent_from_local(emitter.xy());
        let mut sum = Vector2::zeros();
        for ((place, _), local) in self.microphones_m.iter_mut().zip(microphones) {
            *place = pose.parent_from_local(local.xy());
            sum += *place;
        }
        self.ear_m = sum / microphones.len() as f64;
    }

    /// Bearing of the direction from `from` to `to` off the boresight.
    pub(super) fn bearing_rad(&self, from: Vector2<f64>, to: Vector2<f64>) -> f64 {
        let offset = to - from;
        wrap_angle_rad(offset.y.atan2(offset.x) - self.pose.heading_rad)
    }
}

/// What of an emission and of the air paths need to know, at the nodes of its waveform table.
#[derive(Debug, Clone)]
pub(super) struct Medium {
    pub(super) wave_numbers_rad_m: [f64; NODES],
    pub(super) absorptions_np_m: [f64; NODES],
    speed_of_sound_m_s: f64,
    /// Amplitude at 1 m, so that a plane at 1 m reads what the parameters say.
    pub(super) source: f64,
}

impl Medium {
    pub(super) fn new(table: &WaveformTable, params: &SimParams, speed_of_sound_m_s: f64) -> Self {
        let absorptions_np_m =
            table.nodes_hz.map(|frequency_hz| params.air.map_or(0.0, |air| absorption_np_m(frequency_hz, &air)));
        let kept: f64 =
            absorptions_np_m.iter().zip(table.energy_share).map(|(loss, share)| share * (-2.0 * loss).exp()).sum();
        Self {
            wave_numbers_rad_m: table.nodes_hz.map(|frequency_hz| TAU * frequency_hz / speed_of_sound_m_s),
            absorptions_np_m,
            speed_of_sound_m_s,
            source: 2.0 * params.plane_at_1_m / kept,
        }
    }
}

/// Form of a path, for its length and spreading to one microphone.
#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    /// Straight from an emitter or its mirror image.
    Image(Vector2<f64>),
    /// Over an edge.
    Edge { at_m: Vector2<f64>, from_emitter_m: f64 },
    /// Off a cylinder.
    Cylinder { circle: Circle, emitter_m: Vector2<f64> },
    /// Off a ball or a bar.
    Solid(Solid),
}

/// A path that may be.
struct Way {
    shape: Shape,
    /// Where it leaves to.
    departs_m: Vector2<f64>,
    /// Where it arrives from.
    arrives_m: Vector2<f64>,
    /// Bound of its amplitude apart from spreading, gains and absorption.
    strength: f64,
}

/// A path from one emitter to one sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Path {
    pub(super) shape: Shape,
    /// Height of the emitter, or of its image under the floor or above the ceiling.
    pub(super) emitter_height_m: f64,
    /// Everything but spreading, at the middle of the array.
    pub(super) response: Response,
}

impl Path {
    /// Length to a microphone and amplitude by spreading there (1 at 1 m for a mirror image).
    pub(super) fn at(&self, microphone_m: Vector2<f64>, height_m: f64) -> (f64, f64) {
        let rise_m = height_m - self.emitter_height_m;
        match self.shape {
            Shape::Image(image_m) => {
                let length_m = (microphone_m - image_m).norm().hypot(rise_m).max(LENGTH_MIN_M);
                (length_m, 1.0 / length_m)
            }
            Shape::Edge { at_m, from_emitter_m } => {
                let to_m = (microphone_m - at_m).norm().max(LENGTH_MIN_M);
                let sum_m = from_emitter_m + to_m;
                (sum_m.hypot(rise_m), 1.0 / (from_emitter_m * to_m * sum_m).sqrt())
            }
            Shape::Cylinder { circle, emitter_m } => {
                let bounce = Bounce::new(&circle, emitter_m, microphone_m);
                (bounce.length_m().hypot(rise_m), bounce.spreading(circle.radius_m))
            }
            Shape::Solid(solid) => solid.at(Vector3::new(microphone_m.x, microphone_m.y, height_m)),
        }
    }
}

/// Finds all paths of one emission to one sensor.
pub(super) struct Finder<'a> {
    pub(super) sight: &'a Sight<'a>,
    pub(super) params: &'a SimParams,
    pub(super) medium: &'a Medium,
    pub(super) length_max_m: f64,
    pub(super) emitter: usize,
    pub(super) receiver: usize,
}

impl Finder<'_> {
    fn emitter_m(&self) -> Vector2<f64> {
        self.station(self.emitter).emitter_m
    }

    fn ear_m(&self) -> Vector2<f64> {
        self.station(self.receiver).ear_m
    }

    pub(super) fn station(&self, sensor: usize) -> &Station {
        &self.sight.stations[sensor]
    }

    /// Appends every path to `paths`, the direct one first.
    pub(super) fn find(&self, paths: &mut Vec<Path>) {
        self.direct(paths);
        for segment in &self.sight.obstacles.segments {
            self.plane(segment, paths);
        }
        for circle in &self.sight.obstacles.circles {
            self.cylinder(circle, paths);
        }
        for corner in &self.sight.obstacles.corners {
            self.corner(corner, paths);
        }
        self.solids(paths);
        if self.params.multipath {
            self.multipath(paths);
        }
    }

    fn multipath(&self, paths: &mut Vec<Path>) {
        for first in &self.sight.obstacles.segments {
            for second in &self.sight.obstacles.segments {
                if !std::ptr::eq(first, second) && !share_an_end(first, second) {
                    self.double(first, second, None, paths);
                }
            }
            for circle in &self.sight.obstacles.circles {
                self.wall_then_cylinder(first, circle, paths);
                self.cylinder_then_wall(first, circle, paths);
            }
        }
    }

    fn direct(&self, paths: &mut Vec<Path>) {
        let shape = Shape::Image(self.emitter_m());
        let path = Path { shape, emitter_height_m: self.emitter_height_m(), response: [Complex::new(0.0, 0.0); NODES] };
        if self.emitter == self.receiver {
            let nearest_m = self
                .station(self.receiver)
                .microphones_m
                .iter()
                .map(|(place, height)| path.at(*place, *height).0)
                .fold(f64::INFINITY, f64::min);
            let gain = self.params.direct_amplitude * nearest_m;
            paths.push(Path { response: [Complex::new(gain, 0.0); NODES], ..path });
        } else {
            let way = Way { shape, departs_m: self.ear_m(), arrives_m: self.emitter_m(), strength: 1.0 };
            self.add(way, |_| Complex::new(1.0, 0.0), &[(self.emitter_m(), self.ear_m())], paths);
        }
    }

    fn plane(&self, segment: &Segment, paths: &mut Vec<Path>) {
        let Some((image_m, at_m)) = reflect(segment, self.emitter_m(), self.ear_m()) else { return };
        let legs = [(self.emitter_m(), at_m), (at_m, self.ear_m())];
        let way = Way { shape: Shape::Image(image_m), departs_m: at_m, arrives_m: at_m, strength: 1.0 };
        self.add(way, |_| Complex::new(1.0, 0.0), &legs, paths);
    }

    fn cylinder(&self, circle: &Circle, paths: &mut Vec<Path>) {
        let Some(bounce) = self.bounce(circle, self.emitter_m(), self.ear_m()) else { return };
        let at_m = bounce.point_m;
        let legs = [(self.emitter_m(), at_m), (at_m, self.ear_m())];
        // A mover has moved on when the sound arrives there.
        let flown_s = if self.params.motion { bounce.in_m / self.medium.speed_of_sound_m_s } else { 0.0 };
        let centre_m = circle.centre_m + circle.velocity_m_s * flown_s;
        let shape = Shape::Cylinder { circle: Circle { centre_m, ..*circle }, emitter_m: self.emitter_m() };
        let way = Way { shape, departs_m: at_m, arrives_m: at_m, strength: 1.0 };
        self.add(way, |_| Complex::new(1.0, 0.0), &legs, paths);
    }

    /// Over a wall to a cylinder: the cylinder's echo of the emitter's mirror image.
    fn wall_then_cylinder(&self, segment: &Segment, circle: &Circle, paths: &mut Vec<Path>) {
        let (from_m, to_m) = (self.emitter_m(), self.ear_m());
        let image_m = mirror(segment, from_m);
        let Some(bounce) = self.bounce(circle, image_m, to_m) else { return };
        let Some((_, wall_m)) = reflect(segment, from_m, bounce.point_m) else { return };
        let legs = [(from_m, wall_m), (wall_m, bounce.point_m), (bounce.point_m, to_m)];
        let shape = Shape::Cylinder { circle: *circle, emitter_m: image_m };
        let way = Way { shape, departs_m: wall_m, arrives_m: bounce.point_m, strength: 1.0 };
        self.add(way, |_| Complex::new(1.0, 0.0), &legs, paths);
    }

    /// Over a cylinder to a wall: seen in the mirror, the echo of the mirrored cylinder and emitter.
    fn cylinder_then_wall(&self, segment: &Segment, circle: &Circle, paths: &mut Vec<Path>) {
        let (from_m, to_m) = (self.emitter_m(), self.ear_m());
        let (image_m, centre_m) = (mirror(segment, from_m), mirror(segment, circle.centre_m));
        let mirrored = Circle { centre_m, ..*circle };
        let Some(bounce) = self.bounce(&mirrored, image_m, to_m) else { return };
        let at_m = mirror(segment, bounce.point_m);
        let Some((_, wall_m)) = reflect(segment, at_m, to_m) else { return };
        let legs = [(from_m, at_m), (at_m, wall_m), (wall_m, to_m)];
        let shape = Shape::Cylinder { circle: mirrored, emitter_m: image_m };
        let way = Way { shape, departs_m: at_m, arrives_m: wall_m, strength: 1.0 };
        self.add(way, |_| Complex::new(1.0, 0.0), &legs, paths);
    }

    /// The echo of a circle between two places outside it, unless it lies in its shadow or comes too late.
    fn bounce(&self, circle: &Circle, from_m: Vector2<f64>, to_m: Vector2<f64>) -> Option<Bounce> {
        let (near_m, far_m) = ((from_m - circle.centre_m).norm(), (to_m - circle.centre_m).norm());
        if near_m.min(far_m) <= circle.radius_m || near_m + far_m - 2.0 * circle.radius_m >= self.length_max_m {
            return None;
        }
        let bounce = Bounce::new(circle, from_m, to_m);
        (bounce.cos_incidence >= 1e-3).then_some(bounce)
    }

    fn corner(&self, corner: &Corner, paths: &mut Vec<Path>) {
        let direction = |place: Vector2<f64>| (place.y - corner.at_m.y).atan2(place.x - corner.at_m.x);
        let from_m = (self.emitter_m() - corner.at_m).norm();
        let to_m = (self.ear_m() - corner.at_m).norm();
        if !(from_m > LENGTH_MIN_M && to_m > LENGTH_MIN_M && from_m + to_m < self.length_max_m) {
            return;
        }
        let Some(sector) = corner.sector(direction(self.emitter_m())) else { return };
        let Some(from_rad) = sector.angle_of(direction(self.emitter_m())) else { return };
        let Some(to_rad) = sector.angle_of(direction(self.ear_m())) else { return };
        if sector.opening_rad < PI - FLAT_RAD {
            let (first, second) =
                (self.sight.obstacles.segments[sector.faces.0], self.sight.obstacles.segments[sector.faces.1]);
            self.double(&first, &second, Some(corner.at_m), paths);
            self.double(&second, &first, Some(corner.at_m), paths);
        } else if sector.opening_rad > PI + FLAT_RAD {
            let mean_m = from_m * to_m / (from_m + to_m);
            // A sharp edge is almost silent towards some directions; a real one is rounded and thick.
            let radius_m = self.params.edge_radius_m * (2.0 * (sector.opening_rad / PI - 1.0)).min(1.0);
            let rounded = (mean_m * radius_m / (radius_m + 2.0 * mean_m)).sqrt();
            let colour = |node: usize| {
                let wave_number = self.medium.wave_numbers_rad_m[node];
                let sharp = edge::coefficient(sector.opening_rad, from_rad, to_rad, mean_m, wave_number);
                let size = sharp.norm();
                if size > 1e-12 { sharp * (size.max(rounded) / size) } else { Complex::new(rounded, 0.0) }
            };
            let legs = [(self.emitter_m(), corner.at_m), (corner.at_m, self.ear_m())];
            let shape = Shape::Edge { at_m: corner.at_m, from_emitter_m: from_m };
            // No edge is stronger than half a mirror image.
            let strength = rounded.max(0.5 / (from_m + to_m) / self.spreading(shape));
            let way = Way { shape, departs_m: corner.at_m, arrives_m: corner.at_m, strength };
            self.add(way, colour, &legs, paths);
        }
    }

    /// The echo over `first`, then `second`. At a `corner` the two orders share the view: the ray passes the corner on
    /// one side or the other, and within a Fresnel zone of it each order has its part.
    fn double(&self, first: &Segment, second: &Segment, corner: Option<Vector2<f64>>, paths: &mut Vec<Path>) {
        let (from_m, to_m) = (self.emitter_m(), self.ear_m());
        let once_m = mirror(first, from_m);
        let image_m = mirror(second, once_m);
        let (side_m, image_side_m) = (side(second, to_m), side(second, once_m));
        // The last leg must come off the face that the microphones see.
        if side_m * image_side_m <= 0.0 {
            return;
        }
        let second_m = to_m + (image_m - to_m) * (side_m / (side_m + image_side_m));
        let (side_m, image_side_m) = (side(first, from_m), side(first, second_m));
        let first_m = (side_m * image_side_m > 0.0)
            .then(|| second_m + (once_m - second_m) * (image_side_m / (side_m + image_side_m)));
        let (mut part, mut legs) = (1.0, [(from_m, second_m); 3]);
        if let Some(first_m) = first_m {
            legs = [(from_m, first_m), (first_m, second_m), (second_m, to_m)];
        }
        let mut inside = first_m.is_some_and(|first_m| on(first, first_m)) && on(second, second_m);
        if let Some(corner_m) = corner {
            let along = (image_m - to_m).normalize();
            let miss_m = cross(along, corner_m - to_m).abs();
            let outward = if (second.from_m - corner_m).norm() < 1e-6 { second.along } else { -second.along };
            let signed_m = miss_m.copysign((second_m - corner_m).dot(&outward));
            let (near_m, far_m) = ((corner_m - to_m).norm(), (corner_m - from_m).norm());
            let fresnel_m = (PI / self.medium.wave_numbers_rad_m[NODES / 2] * near_m * far_m / (near_m + far_m)).sqrt();
            part = 0.5 + 0.5 * (1.5 * signed_m / fresnel_m).tanh();
            if signed_m.abs() < 2.0 * fresnel_m {
                inside = true;
                legs = [(from_m, corner_m), (corner_m, corner_m), (corner_m, to_m)];
            }
        }
        if inside {
            let way = Way { shape: Shape::Image(image_m), departs_m: legs[0].1, arrives_m: legs[2].0, strength: part };
            self.add(way, |_| Complex::new(part, 0.0), &legs, paths);
        }
    }

    /// Adds a way of the given colour along `legs`, unless it is too long, too weak or hidden.
    fn add(
        &self,
        way: Way,
        colour: impl Fn(usize) -> Complex<f64>,
        legs: &[(Vector2<f64>, Vector2<f64>)],
        paths: &mut Vec<Path>,
    ) {
        let (emitter, receiver) = (self.station(self.emitter), self.station(self.receiver));
        let mut path = Path {
            shape: way.shape,
            emitter_height_m: self.emitter_height_m(),
            response: [Complex::new(0.0, 0.0); NODES],
        };
        let (length_m, spreading) = path.at(receiver.ear_m, receiver.ear_height_m);
        if length_m >= self.length_max_m {
            return;
        }
        let SimParams { view_full_rad: full, view_zero_rad: zero, .. } = *self.params;
        let sent_rad = emitter.bearing_rad(emitter.emitter_m, way.departs_m);
        let heard_rad = receiver.bearing_rad(receiver.ear_m, way.arrives_m);
        let gain = self.medium.source * view(sent_rad, full, zero) * view(heard_rad, full, zero);
        if gain * way.strength * spreading < self.params.weakest_amplitude {
            return;
        }
        for (node, response) in path.response.iter_mut().enumerate() {
            let sent = piston(self.params.emitter_radius_m, self.medium.wave_numbers_rad_m[node], sent_rad);
            *response = colour(node) * (gain * sent * (-self.medium.absorptions_np_m[node] * length_m).exp());
        }
        let strongest = path.response.iter().map(|value| value.norm()).fold(0.0, f64::max);
        if strongest * spreading < self.params.weakest_amplitude
            || self.sight.hidden(legs, emitter.looks_through, receiver.looks_through)
        {
            return;
        }
        paths.push(path);
    }

    fn emitter_height_m(&self) -> f64 {
        self.station(self.emitter).emitter_height_m
    }

    fn spreading(&self, shape: Shape) -> f64 {
        let path = Path { shape, emitter_height_m: self.emitter_height_m(), response: [Complex::new(0.0, 0.0); NODES] };
        path.at(self.ear_m(), self.station(self.receiver).ear_height_m).1
    }
}

/// Distance of `place` from a segment's line, positive on its left.
fn side(segment: &Segment, place: Vector2<f64>) -> f64 {
    cross(segment.along, place - segment.from_m)
}

fn mirror(segment: &Segment, place: Vector2<f64>) -> Vector2<f64> {
    place - Vector2::new(-segment.along.y, segment.along.x) * (2.0 * side(segment, place))
}

/// Whether a point of the segment's line lies on the segment.
fn on(segment: &Segment, place: Vector2<f64>) -> bool {
    let along_m = segment.along.dot(&(place - segment.from_m));
    along_m >= 0.0 && along_m < segment.length_m
}

fn share_an_end(first: &Segment, second: &Segment) -> bool {
    [first.from_m, first.to_m].iter().any(|end| *end == second.from_m || *end == second.to_m)
}

/// Mirror image of `from_m` and reflection point for a microphone at `to_m`, if both see the same face of the segment.
fn reflect(segment: &Segment, from_m: Vector2<f64>, to_m: Vector2<f64>) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let (from_side_m, to_side_m) = (side(segment, from_m), side(segment, to_m));
    if from_side_m * to_side_m <= 0.0 {
        return None;
    }
    let image_m = mirror(segment, from_m);
    let at_m = to_m + (image_m - to_m) * (to_side_m / (to_side_m + from_side_m));
    on(segment, at_m).then_some((image_m, at_m))
}
