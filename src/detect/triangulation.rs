//! Two ranges from two places to one place: the general form of the ring's triangulation (paper 003, (i) to (xvi), corrected).
//!
//! Goes in: two readings of plain sonars, wherever and whenever they were taken. Comes out: a place and an honest covariance, or
//! nothing if no one thing explains both. With b the baseline, D^2 = (d1^2 + d2^2)/2 - b^2/4 is the distance from its middle and
//! sin theta = (d1^2 - d2^2)/(2 b D) the bearing off its normal: D is known as well as a range, theta badly. That both cones hold
//! the thing is knowledge too and goes in as a measurement. Never fuses over pings.
//!
//! What the paper prints is not this. (vi) exchanges the two ranges, which mirrors the thing in the pair's axis. (xi) and (xii)
//! add a length to an angle, so that alpha depends on the unit. (xiii) has + for -, which makes D^2 too large by b (b + 2 t), and
//! its listing leaves b out. (xiv) is counted from the second sonar's side, not the first's. The gate has its limits exchanged,
//! since cosines fall: nothing passes it. (xvi) steps by 60 degrees from pair to pair, which are 30 apart. tests/detectors_worked/ring_paper.rs
//! shows each by numbers.

use crate::geometry::{Pose2, cartesian_from_polar, wrap_angle_rad};
use nalgebra::{Matrix2, Vector2};

/// Chi-square of one degree of freedom that 1 % exceed.
pub const CHI_SQUARE_1: f64 = 6.635;
/// Chi-square of two degrees of freedom that 1 % exceed.
pub const CHI_SQUARE_2: f64 = 9.210;

/// What a plain sonar read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangeReading {
    /// Where the transducer was and looked.
    pub transducer: Pose2,
    /// Distance of the nearest thing in its cone.
    pub range_m: f64,
    /// Standard deviation of that, with what the place of the transducer is uncertain by along the line of sight.
    pub range_sigma_m: f64,
}

/// Where the thing is that two sonars heard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// Place, in the frame of the transducers.
    pub position_m: Vector2<f64>,
    /// Covariance of the place, square metres.
    pub covariance_m2: Matrix2<f64>,
}

/// The two circles as seen from the middle of the baseline.
struct Polar {
    middle_m: Vector2<f64>,
    /// Along the normal of the baseline to which the sonars look, and along the baseline.
    axes: [Vector2<f64>; 2],
    /// Distance of the thing from the middle, and its variance.
    distance_m: f64,
    distance_m2: f64,
    /// Bearing of the thing off the normal, and its variance.
    bearing_rad: f64,
    bearing_rad2: f64,
}

/// The place that two readings explain together.
///
/// Nothing, unless the triangle closes (|d1 - d2| <= b <= d1 + d2) and both cones hold it, each within what the readings' noise
/// makes likely (1 in 100 is lost). What is not a number explains nothing.
#[must_use]
pub fn triangulate(first: &RangeReading, second: &RangeReading, cone_rad: f64) -> Option<Fix> {
    let polar = polar(first, second)?;
    let (low_rad, high_rad) = shared_view(&polar, first, second, cone_rad)?;
    let beyond_rad = (low_rad - polar.bearing_rad).max(polar.bearing_rad - high_rad);
    if beyond_rad > 0.0 && beyond_rad * beyond_rad > CHI_SQUARE_1 * polar.bearing_rad2 {
        return None;
    }
    // A thing anywhere in the shared view: mean and variance of a uniform distribution, fused as if it were a normal one.
    let middle_rad = 0.5 * (low_rad + high_rad);
    let view_rad2 = (high_rad - low_rad).powi(2) / 12.0;
    let gain = polar.bearing_rad2 / (polar.bearing_rad2 + view_rad2);
    let bearing_rad = polar.bearing_rad + gain * (middle_rad - polar.bearing_rad);
    let bearing_rad2 = gain * view_rad2;
    let (sine, cosine) = bearing_rad.sin_cos();
    let out = polar.axes[0] * cosine + polar.axes[1] * sine;
    let across = polar.axes[1] * cosine - polar.axes[0] * sine;
    // The errors lie on an arc: what is off across is also too far out, by D x^2 / 2. Its mean square is 3/4 (D var)^2, but it is
    // far from normal; with 2 for 3/4 an ellipse of three deviations holds what it should.
    let out_m2 = polar.distance_m2 + 2.0 * (polar.distance_m * bearing_rad2).powi(2);
    let across_m2 = polar.distance_m * polar.distance_m * bearing_rad2;
    let covariance_m2 = out * out.transpose() * out_m2 + across * across.transpose() * across_m2;
    let position_m = polar.middle_m + out * polar.distance_m;
    let finite = position_m.iter().chain(covariance_m2.iter()).all(|value| value.is_finite());
    finite.then_some(Fix { position_m, covariance_m2 })
}

fn polar(first: &RangeReading, second: &RangeReading) -> Option<Polar> {
    let (first_m, second_m) = (first.range_m, second.range_m);
    let apart_m = second.transducer.position_m() - first.transducer.position_m();
    let baseline_m = apart_m.norm();
    let noise_m2 = first.range_sigma_m.powi(2) + second.range_sigma_m.powi(2);
    let open_m = ((first_m - second_m).abs() - baseline_m).max(baseline_m - first_m - second_m);
    // Written so that NaN is nothing.
    if !(baseline_m > 0.0 && first_m >= 0.0 && second_m >= 0.0 && noise_m2 >= 0.0) {
        return None;
    }
    if !(open_m <= 0.0 || open_m * open_m <= CHI_SQUARE_1 * noise_m2) {
        return None;
    }
    let squared_m2 = 0.5 * (first_m * first_m + second_m * second_m) - 0.25 * baseline_m * baseline_m;
    if !(squared_m2 > 0.0 && squared_m2.is_finite()) {
        return None;
    }
    let distance_m = squared_m2.sqrt();
    let along = apart_m / baseline_m;
    let normal = Vector2::new(along.y, -along.x);
    let looks = cartesian_from_polar(1.0, first.transducer.heading_rad)
        + cartesian_from_polar(1.0, second.transducer.heading_rad);
    let normal = if looks.dot(&normal) < 0.0 { -normal } else { normal };
    let sine = ((first_m * first_m - second_m * second_m) / (2.0 * baseline_m * distance_m)).clamp(-1.0, 1.0);
    let squares_m2 = (first_m * first.range_sigma_m).hypot(second_m * second.range_sigma_m);
    let sine_sigma = squares_m2 / (baseline_m * distance_m);
    // Near the baseline's own line the bearing goes with the root of an error: secants over one and three deviations, not the
    // slope.
    let bearing_rad = sine.asin();
    let secant_rad =
        |sigmas: f64| ((sine + sigmas * sine_sigma).clamp(-1.0, 1.0).asin() - bearing_rad).abs() / sigmas.abs();
    let bearing_sigma_rad = [-3.0, -1.0, 1.0, 3.0].map(secant_rad).into_iter().fold(0.0, f64::max);
    Some(Polar {
        middle_m: 0.5 * (first.transducer.position_m() + second.transducer.position_m()),
        axes: [normal, along],
        distance_m,
        distance_m2: (0.5 * squares_m2 / distance_m).powi(2),
        bearing_rad,
        bearing_rad2: bearing_sigma_rad * bearing_sigma_rad,
    })
}

/// The bearings from the middle of the baseline at which both cones hold a thing at this distance; nothing if there are none.
fn shared_view(polar: &Polar, first: &RangeReading, second: &RangeReading, cone_rad: f64) -> Option<(f64, f64)> {
    let (mut low_rad, mut high_rad) = (-std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_2);
    for reading in [first, second] {
        let from_m = reading.transducer.position_m() - polar.middle_m;
        let crossing_rad = |side: f64| {
            let along = cartesian_from_polar(1.0, reading.transducer.heading_rad + side * 0.5 * cone_rad);
            // Where the rim of the cone crosses the circle of that distance: one crossing, the transducer being inside.
            let inside_m2 = polar.distance_m * polar.distance_m - from_m.norm_squared();
            let ahead_m = from_m.dot(&along);
            let crossing_m = from_m + along * ((ahead_m * ahead_m + inside_m2.max(0.0)).sqrt() - ahead_m);
            wrap_angle_rad(crossing_m.dot(&polar.axes[1]).atan2(crossing_m.dot(&polar.axes[0])))
        };
        let (left_rad, right_rad) = (crossing_rad(1.0), crossing_rad(-1.0));
        // Bearings rise along the baseline, which may run either way round.
        low_rad = low_rad.max(left_rad.min(right_rad));
        high_rad = high_rad.min(left_rad.max(right_rad));
    }
    (low_rad < high_rad).then_some((low_rad, high_rad))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    /// A normal number: the sum of twelve uniform ones.
    fn normal(random: &mut ChaCha8Rng) -> f64 {
        (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
    }

    fn sonar(index: usize, ring_m: f64) -> Pose2 {
        let heading_rad = (30.0 * index as f64).to_radians();
        let at_m = cartesian_from_polar(ring_m, heading_rad);
        Pose2 { x_m: at_m.x, y_m: at_m.y, heading_rad }
    }

    fn off_rad(sonar: &Pose2, point_m: Vector2<f64>) -> f64 {
        let local_m = sonar.local_from_parent(point_m);
        local_m.y.atan2(local_m.x).abs()
    }

    /// Mean normalised square error, share within three deviations, and how many fixes there were.
    fn trial(range_m: f64, sigma_m: f64, cone_deg: f64, seed: u64) -> (f64, f64, usize) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let cone_rad = cone_deg.to_radians();
        let pair = [sonar(0, 0.1), sonar(1, 0.1)];
        let (mut sum, mut inside, mut count) = (0.0, 0, 0);
        for _ in 0..4000 {
            let point_m = cartesian_from_polar(range_m, (15.0 + 60.0 * (random.random::<f64>() - 0.5)).to_radians());
            if pair.iter().any(|sonar| off_rad(sonar, point_m) > 0.5 * cone_rad) {
                continue;
            }
            let [first, second] = pair.map(|transducer| RangeReading {
                transducer,
                range_m: (point_m - transducer.position_m()).norm() + sigma_m * normal(&mut random),
                range_sigma_m: sigma_m,
            });
            let Some(fix) = triangulate(&first, &second, cone_rad) else { continue };
            let error_m = fix.position_m - point_m;
            let inverse = fix.covariance_m2.try_inverse().expect("a covariance");
            let squared = (error_m.transpose() * inverse * error_m)[0];
            sum += squared;
            inside += usize::from(squared < 9.0);
            count += 1;
        }
        (sum / count as f64, inside as f64 / count as f64, count)
    }

    #[test]
    fn the_covariance_is_honest_at_every_range_and_noise() {
        for (range_m, sigma_m, cone_deg) in [
            (0.3, 0.002, 90.0),
            (0.3, 0.01, 90.0),
            (0.7, 0.005, 60.0),
            (1.0, 0.002, 60.0),
            (1.0, 0.01, 60.0),
            (1.4, 0.02, 60.0),
        ] {
            let (mean, inside, count) = trial(range_m, sigma_m, cone_deg, 7);
            assert!(count > 1000, "{range_m} {sigma_m}: {count} fixes");
            // Two for two degrees of freedom; the uniform view is no normal distribution, which makes it less, never more.
            assert!((0.8..2.3).contains(&mean), "{range_m} m, {sigma_m} m: {mean}");
            assert!(inside > 0.97, "{range_m} m, {sigma_m} m: {inside} within three deviations");
        }
    }

    #[test]
    fn without_noise_the_place_is_exact_wherever_the_robot_stood() {
        let place = |x_m, y_m, heading_deg: f64| Pose2 { x_m, y_m, heading_rad: heading_deg.to_radians() };
        let point_m = Vector2::new(0.9, 0.35);
        for pair in [[place(0.0, 0.0, 10.0), place(0.1, 0.2, 5.0)], [place(0.1, 0.2, 5.0), place(0.0, 0.0, 10.0)]] {
            let [first, second] = pair.map(|transducer| RangeReading {
                transducer,
                range_m: (point_m - transducer.position_m()).norm(),
                range_sigma_m: 1e-6,
            });
            let fix = triangulate(&first, &second, 80f64.to_radians()).expect("both hear it");
            assert!((fix.position_m - point_m).norm() < 1e-6, "{:?}", fix.position_m);
        }
    }

    #[test]
    fn what_no_one_thing_explains_is_nothing_and_noise_alone_loses_little() {
        let read =
            |index: usize, range_m: f64| RangeReading { transducer: sonar(index, 0.1), range_m, range_sigma_m: 0.002 };
        let cone_rad = 60f64.to_radians();
        assert!(triangulate(&read(0, 1.0), &read(1, 1.0), cone_rad).is_some());
        assert!(triangulate(&read(0, 1.0), &read(1, 1.2), cone_rad).is_none(), "the triangle does not close");
        assert!(triangulate(&read(0, 0.02), &read(1, 0.02), cone_rad).is_none(), "nearer than the baseline is long");
        assert!(triangulate(&read(0, 1.0), &read(1, 1.04), cone_rad).is_none(), "outside the cones by far");
        assert!(triangulate(&read(0, f64::NAN), &read(1, 1.0), cone_rad).is_none());
        assert!(triangulate(&read(0, 1.0), &read(0, 1.0), cone_rad).is_none(), "no baseline");
        assert!(triangulate(&read(0, 1.0), &read(1, 1.0), 20f64.to_radians()).is_none(), "cones that never meet");
    }

    #[test]
    fn near_the_baselines_own_line_the_covariance_is_not_optimistic() {
        // Two transducers in line with the thing: q = 0.
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let place = |x_m: f64| Pose2 { x_m, y_m: 0.0, heading_rad: std::f64::consts::FRAC_PI_2 };
        let pair = [place(-0.05), place(0.05)];
        for (along_m, off_m) in [(0.5, 0.0), (0.5, 0.02), (0.5, 0.1)] {
            let point_m = Vector2::new(along_m, off_m);
            let (mut sum, mut count) = (0.0, 0.0);
            for _ in 0..4000 {
                let [first, second] = pair.map(|transducer| RangeReading {
                    transducer,
                    range_m: (point_m - transducer.position_m()).norm() + 0.003 * normal(&mut random),
                    range_sigma_m: 0.003,
                });
                let Some(fix) = triangulate(&first, &second, std::f64::consts::PI) else { continue };
                let error_m = fix.position_m - point_m;
                sum += (error_m.transpose() * fix.covariance_m2.try_inverse().expect("one") * error_m)[0];
                count += 1.0;
            }
            // The place itself is at the very rim of what both sonars are taken to look at, which pulls the fix inward a little.
            assert!(sum / count < 3.0 && count > 3900.0, "{off_m} m off: {} in {count}", sum / count);
        }
    }
}
