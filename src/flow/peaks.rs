//! Walls as local maxima of Gamma(d), the mean energy on the flow line of lateral distance d (paper 000, eq. 14).
//!
//! Goes in: lateral distances, ascending, and their Gamma. Comes out: peaks above a threshold that stand out, refined by a
//! parabola, strongest first. Allocates nothing; knows no sensors.

use super::params::PeakParams;
use crate::signal::{WALL_PEAKS_MAX, WallPeak, WallPeaks};

/// Finds the walls. `gammas` has one finite value a line; the first and the last line are never peaks, since what lies
/// beyond them is not known. Of a plateau the middle counts.
pub(super) fn find(laterals_m: impl Fn(usize) -> f64, gammas: &[f64], params: &PeakParams) -> WallPeaks {
    let mut walls = WallPeaks::default();
    let mut index = 1;
    while index + 1 < gammas.len() {
        let plateau = gammas[index..].iter().take_while(|gamma| **gamma == gammas[index]).count();
        let last = index + plateau - 1;
        let is_maximum =
            gammas[index - 1] < gammas[index] && gammas.get(last + 1).is_some_and(|next| *next < gammas[index]);
        if is_maximum && gammas[index] > params.threshold && prominence(gammas, index, last) >= params.prominence {
            insert(&mut walls, refined(&laterals_m, gammas, index, last));
        }
        index = last + 1;
    }
    separate(&mut walls, params.separation_m);
    walls
}

/// Height of a peak above the higher of the two lowest points between it and higher ground (or the end) on either side.
fn prominence(gammas: &[f64], first: usize, last: usize) -> f64 {
    let peak = gammas[first];
    let lowest = |lowest: f64, gamma: &f64| lowest.min(*gamma);
    let left = gammas[..first].iter().rev().take_while(|gamma| **gamma <= peak).fold(peak, lowest);
    let right = gammas[last + 1..].iter().take_while(|gamma| **gamma <= peak).fold(peak, lowest);
    peak - left.max(right)
}

/// The peak between its neighbours: the vertex of the parabola through three lines, if they are equally spaced.
fn refined(laterals_m: impl Fn(usize) -> f64, gammas: &[f64], first: usize, last: usize) -> WallPeak {
    let middle_m = 0.5 * (laterals_m(first) + laterals_m(last));
    let (before_m, after_m) = (laterals_m(first) - laterals_m(first - 1), laterals_m(last + 1) - laterals_m(last));
    if first != last || (before_m - after_m).abs() > 1e-6 {
        return WallPeak { lateral_m: middle_m, strength: gammas[first] };
    }
    let (left, peak, right) = (gammas[first - 1], gammas[first], gammas[first + 1]);
    // Both differences are above zero at a maximum, so the sum is, and the offset stays within half a step.
    let offset = 0.5 * (left - right) / ((left - peak) + (right - peak));
    WallPeak { lateral_m: middle_m + offset * before_m, strength: peak - 0.25 * (left - right) * offset }
}

/// Inserts by strength, dropping the weakest when full.
fn insert(walls: &mut WallPeaks, wall: WallPeak) {
    let place = walls.as_slice().iter().position(|other| other.strength < wall.strength).unwrap_or(walls.count);
    if place >= WALL_PEAKS_MAX {
        return;
    }
    walls.count = (walls.count + 1).min(WALL_PEAKS_MAX);
    walls.peaks[place..walls.count].rotate_right(1);
    walls.peaks[place] = wall;
}

/// Drops every peak that is nearer than `separation_m` to a stronger one.
fn separate(walls: &mut WallPeaks, separation_m: f64) {
    let found = *walls;
    *walls = WallPeaks::default();
    for wall in found.as_slice() {
        let apart = |other: &WallPeak| (other.lateral_m - wall.lateral_m).abs() >= separation_m;
        if walls.as_slice().iter().all(apart) {
            walls.peaks[walls.count] = *wall;
            walls.count += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARAMS: PeakParams = PeakParams { threshold: 0.2, prominence: 0.1, separation_m: 0.2 };

    fn walls(gamma: impl Fn(f64) -> f64) -> WallPeaks {
        let lateral = |index: usize| -2.0 + 0.05 * index as f64;
        let gammas: Vec<f64> = (0..81).map(|index| gamma(lateral(index))).collect();
        find(lateral, &gammas, &PARAMS)
    }

    fn bump(at_m: f64, height: f64) -> impl Fn(f64) -> f64 {
        move |lateral_m| height * (-(lateral_m - at_m).powi(2) / (2.0 * 0.06f64.powi(2))).exp()
    }

    #[test]
    fn two_walls_are_found_between_the_lines_strongest_first() {
        let found = walls(|lateral_m| bump(0.83, 1.0)(lateral_m) + bump(-1.11, 0.5)(lateral_m));
        assert_eq!(found.count, 2);
        assert!((found.peaks[0].lateral_m - 0.83).abs() < 0.01 && (found.peaks[1].lateral_m + 1.11).abs() < 0.01);
        assert!((found.peaks[0].strength - 1.0).abs() < 0.05);
    }

    #[test]
    fn mirrored_lines_give_mirrored_walls() {
        let scene = |lateral_m: f64| bump(0.42, 0.9)(lateral_m) + bump(1.3, 0.4)(lateral_m);
        let (left, right) = (walls(scene), walls(|lateral_m| scene(-lateral_m)));
        for (left, right) in left.as_slice().iter().zip(right.as_slice()) {
            assert!((left.lateral_m + right.lateral_m).abs() < 1e-9 && (left.strength - right.strength).abs() < 1e-12);
        }
        assert_eq!((left.count, right.count), (2, 2));
    }

    #[test]
    fn low_flat_and_shouldering_maxima_are_no_walls() {
        assert_eq!(walls(bump(0.5, 0.19)).count, 0, "below the threshold");
        assert_eq!(walls(|_| 1.0).count, 0, "no maximum");
        let shoulder =
            |lateral_m: f64| bump(0.5, 1.0)(lateral_m).max(0.25 * f64::from((lateral_m - 0.9).abs() < 0.12)).max(0.2);
        assert_eq!(walls(shoulder).count, 1, "a ripple of 0.05 does not stand out");
    }

    #[test]
    fn a_weaker_maximum_right_beside_a_wall_is_part_of_it() {
        let found = walls(|lateral_m| bump(0.5, 1.0)(lateral_m) + bump(0.67, 0.9)(lateral_m));
        assert_eq!(found.count, 1);
    }
}
