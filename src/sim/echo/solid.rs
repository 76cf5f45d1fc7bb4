//! Echoes of floor, ceiling, balls and bars: image source, sphere, and cylinder of finite length.
//!
//! Shape, emitter and microphone in space in; length and amplitude by spreading out, of geometrical optics as for upright cylinders:
//! a ball's echo leaves its surface with both caustics at about half its radius, which backscattered is a / (a + r) of a plane's (Kuc
//! and Siegel's sphere, and a/2r of it far away). A bar is a cylinder where the reflection point lies between its ends, by Fresnel
//! zones, and else the ball that its nearer end is. Floor and ceiling are smooth: they echo from straight below and above.

use super::cylinder::Bounce;
use super::path::LENGTH_MIN_M;
use crate::sim::obstacles::Circle;
use crate::sim::solids::{Ball, Bar};
use nalgebra::{Vector2, Vector3};

/// A ball or a bar and the emitter that sounds at it.
#[derive(Debug, Clone, Copy)]
pub(super) enum Solid {
    /// A ball, or the end of a bar.
    Ball { centre_m: Vector3<f64>, radius_m: f64, emitter_m: Vector3<f64> },
    /// A bar between its ends.
    Bar { rod: Rod, emitter_m: Vector3<f64> },
}

/// A bar by its axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rod {
    from_m: Vector3<f64>,
    /// Unit vector along the axis, and two across it.
    along: Vector3<f64>,
    across: [Vector3<f64>; 2],
    pub(super) length_m: f64,
    radius_m: f64,
}

/// A reflection in space.
pub(super) struct Glint {
    pub(super) point_m: Vector3<f64>,
    length_m: f64,
    spreading: f64,
    pub(super) cos_incidence: f64,
    /// Where on a bar's axis it lies, from its beginning; 0 for a ball.
    pub(super) along_m: f64,
}

impl Solid {
    pub(super) fn ball(ball: &Ball, emitter_m: Vector3<f64>) -> Self {
        Self::Ball { centre_m: Vector3::from(ball.centre), radius_m: ball.radius_m, emitter_m }
    }

    /// Whether a place lies inside, or in line with a bar: there is no echo from within.
    pub(super) fn holds(&self, place_m: Vector3<f64>) -> bool {
        match self {
            Self::Ball { centre_m, radius_m, .. } => (place_m - centre_m).norm() <= *radius_m,
            Self::Bar { rod, .. } => rod.across_m(place_m).norm() <= rod.radius_m,
        }
    }

    pub(super) fn glint(&self, microphone_m: Vector3<f64>) -> Glint {
        match *self {
            Self::Ball { centre_m, radius_m, emitter_m } => off_ball(centre_m, radius_m, emitter_m, microphone_m),
            Self::Bar { rod, emitter_m } => rod.glint(emitter_m, microphone_m),
        }
    }

    /// Length to a microphone and amplitude by spreading there.
    pub(super) fn at(&self, microphone_m: Vector3<f64>) -> (f64, f64) {
        let glint = self.glint(microphone_m);
        (glint.length_m, glint.spreading)
    }
}

fn off_ball(centre_m: Vector3<f64>, radius_m: f64, emitter_m: Vector3<f64>, microphone_m: Vector3<f64>) -> Glint {
    // Both ways lie in the plane through the two places and the middle: there the ball is a circle.
    let (from, to) = (emitter_m - centre_m, microphone_m - centre_m);
    let first = from.normalize();
    let aside = to - first * to.dot(&first);
    let second = if aside.norm() > 1e-9 { aside.normalize() } else { any_across(first) };
    let circle = Circle { centre_m: Vector2::zeros(), radius_m, velocity_m_s: Vector2::zeros() };
    let plane = |place: Vector3<f64>| Vector2::new(place.dot(&first), place.dot(&second));
    let bounce = Bounce::new(&circle, plane(from), plane(to));
    let cos = bounce.cos_incidence.max(1e-3);
    let caustic_m = |bend: f64| 1.0 / (1.0 / bounce.in_m + bend / radius_m);
    let opening = |caustic_m: f64| (caustic_m / (caustic_m + bounce.out_m)).sqrt();
    Glint {
        point_m: centre_m + first * bounce.point_m.x + second * bounce.point_m.y,
        length_m: bounce.length_m(),
        spreading: opening(caustic_m(2.0 / cos)) * opening(caustic_m(2.0 * cos)) / bounce.in_m,
        cos_incidence: bounce.cos_incidence,
        along_m: 0.0,
    }
}

/// Some unit vector across a unit vector.
fn any_across(along: Vector3<f64>) -> Vector3<f64> {
    let other = if along.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    along.cross(&other).normalize()
}

impl Rod {
    pub(super) fn new(bar: &Bar) -> Self {
        let (from_m, to_m) = (Vector3::from(bar.from), Vector3::from(bar.to));
        let along = (to_m - from_m).normalize();
        let first = any_across(along);
        let length_m = (to_m - from_m).norm();
        Self { from_m, along, across: [first, along.cross(&first)], length_m, radius_m: bar.radius_m }
    }

    /// Where along the axis a place lies, from the bar's beginning.
    pub(super) fn along_m(&self, place_m: Vector3<f64>) -> f64 {
        (place_m - self.from_m).dot(&self.along)
    }

    /// The end of the bar that is nearer to a place on its axis, as the ball that it is.
    pub(super) fn end(&self, along_m: f64, emitter_m: Vector3<f64>) -> Solid {
        let end_m = along_m.clamp(0.0, self.length_m);
        Solid::Ball { centre_m: self.from_m + self.along * end_m, radius_m: self.radius_m, emitter_m }
    }

    fn across_m(&self, place_m: Vector3<f64>) -> Vector2<f64> {
        let offset = place_m - self.from_m;
        Vector2::new(offset.dot(&self.across[0]), offset.dot(&self.across[1]))
    }

    /// Seen along its axis the bar is a circle, and the way rises evenly from one end of it to the other.
    fn glint(&self, emitter_m: Vector3<f64>, microphone_m: Vector3<f64>) -> Glint {
        let circle = Circle { centre_m: Vector2::zeros(), radius_m: self.radius_m, velocity_m_s: Vector2::zeros() };
        let bounce = Bounce::new(&circle, self.across_m(emitter_m), self.across_m(microphone_m));
        let (start_m, end_m) = (self.along_m(emitter_m), self.along_m(microphone_m));
        let along_m = start_m + (end_m - start_m) * bounce.in_m / bounce.length_m().max(LENGTH_MIN_M);
        let across = self.across[0] * bounce.point_m.x + self.across[1] * bounce.point_m.y;
        Glint {
            point_m: self.from_m + self.along * along_m + across,
            length_m: bounce.length_m().hypot(end_m - start_m),
            spreading: bounce.spreading(self.radius_m),
            cos_incidence: bounce.cos_incidence,
            along_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shortest way over a surface, by trying: shares nothing with Fermat's point by Newton.
    fn shortest_m(surface: impl Fn(f64, f64) -> Vector3<f64>, from: Vector3<f64>, to: Vector3<f64>) -> f64 {
        let mut best = (f64::INFINITY, 0.0, 0.0);
        let (mut middle, mut reach) = ((0.0, 0.0), (3.2, 3.2));
        for _ in 0..14 {
            for a in -40..=40 {
                for b in -40..=40 {
                    let (u, v) = (middle.0 + reach.0 * f64::from(a) / 40.0, middle.1 + reach.1 * f64::from(b) / 40.0);
                    let at = surface(u, v);
                    let length = (at - from).norm() + (at - to).norm();
                    if length < best.0 {
                        best = (length, u, v);
                    }
                }
            }
            middle = (best.1, best.2);
            reach = (reach.0 * 0.2, reach.1 * 0.2);
        }
        best.0
    }

    #[test]
    fn a_ball_is_as_far_as_its_shortest_way_and_as_loud_as_its_radius_says() {
        let (emitter, microphone) = (Vector3::new(0.0, 0.0, 0.06), Vector3::new(0.0, 0.3, -0.2));
        let (centre, radius) = (Vector3::new(1.2, 0.5, -0.7), 0.11);
        let solid = Solid::Ball { centre_m: centre, radius_m: radius, emitter_m: emitter };
        let surface = |u: f64, v: f64| centre + radius * Vector3::new(v.cos() * u.cos(), v.cos() * u.sin(), v.sin());
        let (length, _) = solid.at(microphone);
        assert!((length - shortest_m(surface, emitter, microphone)).abs() < 1e-6);
        // Backscattered at distance r from the surface: a / (2 r (a + r)).
        let (length, spreading) = solid.at(emitter);
        let r = 0.5 * length;
        assert!((spreading / (radius / (2.0 * r * (radius + r))) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_slanted_bar_is_as_far_as_its_shortest_way_and_an_upright_one_is_a_pillar() {
        let (emitter, microphone) = (Vector3::new(0.0, 0.0, 0.06), Vector3::new(0.0, 0.3, -0.2));
        let bar = Bar { from: [1.5, -2.0, 0.3], to: [1.1, 2.0, 0.8], radius_m: 0.03 };
        let rod = Rod::new(&bar);
        let surface = |u: f64, v: f64| {
            rod.from_m + rod.along * (2.0 + u) + (rod.across[0] * v.cos() + rod.across[1] * v.sin()) * bar.radius_m
        };
        let solid = Solid::Bar { rod, emitter_m: emitter };
        assert!((solid.at(microphone).0 - shortest_m(surface, emitter, microphone)).abs() < 1e-6);
        let upright = Rod::new(&Bar { from: [1.0, 0.4, -3.0], to: [1.0, 0.4, 3.0], radius_m: 0.05 });
        let (length, spreading) = Solid::Bar { rod: upright, emitter_m: emitter }.at(microphone);
        let circle = Circle { centre_m: Vector2::new(1.0, 0.4), radius_m: 0.05, velocity_m_s: Vector2::zeros() };
        let bounce = Bounce::new(&circle, emitter.xy(), microphone.xy());
        assert!((length - bounce.length_m().hypot(0.26)).abs() < 1e-9);
        assert!((spreading - bounce.spreading(0.05)).abs() < 1e-9);
    }
}
