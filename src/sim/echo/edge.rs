//! Diffraction by a straight hard edge: the uniform theory of Kouyoumjian and Pathak (1974), eq. 25, hard case, normal
//! incidence; e^(+j omega t), so a delay is e^(-j omega tau).
//!
//! Wedge and directions in, the complex diffraction coefficient out (unit: square root of metre). Spreading is not here.

use rustfft::num_complex::Complex;
use std::f64::consts::{FRAC_PI_4, PI};

/// Diffraction coefficient of a wedge whose open side spans `opening_rad`; directions are angles from one face.
///
/// `distance_m` is s s'/(s + s') of the distances edge to source and edge to receiver.
pub(super) fn coefficient(
    opening_rad: f64,
    from_rad: f64,
    to_rad: f64,
    distance_m: f64,
    wave_number_rad_m: f64,
) -> Complex<f64> {
    let n = opening_rad / PI;
    let (minus, plus) = (to_rad - from_rad, to_rad + from_rad);
    let sum = [(PI, minus), (-PI, minus), (PI, plus), (-PI, plus)]
        .into_iter()
        .map(|(boundary, beta)| term(n, boundary, beta, wave_number_rad_m * distance_m))
        .sum::<Complex<f64>>();
    -Complex::from_polar(1.0 / (2.0 * n * (2.0 * PI * wave_number_rad_m).sqrt()), -FRAC_PI_4) * sum
}

/// cot((pi +- beta) / 2n) F(kL a+-(beta)); `boundary` is +pi or -pi for the upper or lower sign.
fn term(n: f64, boundary: f64, beta: f64, kl: f64) -> Complex<f64> {
    let turns = ((boundary + beta) / (2.0 * PI * n)).round();
    // The cotangent's pole and the zero of F cancel exactly on the boundary; a microradian beside it both are finite.
    let off_boundary = 2.0 * PI * n * turns - beta - boundary;
    let nudged = if off_boundary.abs() < 1e-6 { 1e-6f64.copysign(off_boundary) } else { off_boundary };
    let cotangent = 1.0 / ((boundary + beta + (off_boundary - nudged)) / (2.0 * n)).tan();
    let sign = if boundary > 0.0 { 1.0 } else { -1.0 };
    let half = 0.5 * (nudged + boundary);
    transition(kl * 2.0 * half.cos().powi(2)) * (sign * cotangent)
}

/// The transition function F(x) = 2 j sqrt(x) e^(jx) times the integral of e^(-j t^2) from sqrt(x) to infinity.
fn transition(x: f64) -> Complex<f64> {
    if x > 10.0 {
        let inverse = Complex::new(0.0, 0.5 / x);
        // The asymptotic series in j/2x; the first term left out is below 4e-4 here.
        let squared = inverse * inverse;
        return Complex::new(1.0, 0.0) + inverse + squared * 3.0 + squared * inverse * 15.0 + squared * squared * 105.0;
    }
    let root = x.sqrt();
    let mut power = Complex::new(root, 0.0);
    let mut integral = power;
    for order in 1..70u32 {
        power *= Complex::new(0.0, -x / f64::from(order));
        let term = power / f64::from(2 * order + 1);
        integral += term;
        if term.norm_sqr() < 1e-26 {
            break;
        }
    }
    let rest = Complex::from_polar(0.5 * PI.sqrt(), -FRAC_PI_4) - integral;
    Complex::new(0.0, 2.0 * root) * Complex::from_polar(1.0, x) * rest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Keller's coefficient of a hard half plane, far from its shadow boundaries.
    fn keller_half_plane(from_rad: f64, to_rad: f64, wave_number_rad_m: f64) -> f64 {
        let sum = 1.0 / (0.5 * (to_rad - from_rad)).cos() + 1.0 / (0.5 * (to_rad + from_rad)).cos();
        sum.abs() / (2.0 * (2.0 * PI * wave_number_rad_m).sqrt())
    }

    #[test]
    fn far_from_the_boundaries_it_is_kellers_coefficient() {
        for (from_rad, to_rad) in [(0.5, 0.5), (2.2, 2.4), (4.5, 4.4)] {
            let found = coefficient(2.0 * PI, from_rad, to_rad, 500.0, 687.0).norm();
            let expected = keller_half_plane(from_rad, to_rad, 687.0);
            assert!((found / expected - 1.0).abs() < 2e-3, "{from_rad}: {found} {expected}");
        }
    }

    /// On the reflection boundary half of the reflected field must be missing: D sqrt(s'/(s(s+s')))/s' = 1/(2 (s+s')).
    #[test]
    fn on_the_reflection_boundary_it_supplies_half_the_mirror_image() {
        for n in [2.0, 1.5, 1.3] {
            for (side, sign) in [(-1e-4, -1.0), (1e-4, 1.0)] {
                let angle = 0.5 * PI + side;
                let d = coefficient(n * PI, angle, angle, 0.5, 687.0);
                let spread = (1.0 / 2.0f64).sqrt(); // s = s' = 1
                let field = d * spread;
                assert!((field.re - sign * 0.25).abs() < 0.02 && field.im.abs() < 0.02, "{n} {side}: {field}");
            }
        }
    }

    #[test]
    fn the_transition_function_is_smooth_where_the_series_hands_over() {
        let (below, above) = (transition(9.999_999), transition(10.000_001));
        assert!((below - above).norm() < 5e-4, "{below} {above}");
        assert!((transition(1e6) - Complex::new(1.0, 0.0)).norm() < 1e-5);
    }

    #[test]
    fn a_flat_wall_has_no_edge() {
        let d = coefficient(PI, 0.9, 1.1, 0.5, 687.0);
        assert!(d.norm() < 1e-9, "{d}");
    }
}
