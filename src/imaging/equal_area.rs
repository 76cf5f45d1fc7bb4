//! Equal-area grids of directions over the front hemisphere. Pure.
//!
//! In: how many directions, and between which elevations. Out: [`Direction`]s, every one the middle of a cell of the same solid angle.
//!
//! Zones of elevation, cut into cells of equal azimuth (Leopardi 2006, "A partition of the unit sphere into regions of equal area and
//! small diameter", ETNA 25, on the half of the sphere that an array in a plane can tell): the number of cells of a zone is a whole
//! number, and the zone's borders are then moved to where its cells have the area of all others. Left mirrors right and up mirrors
//! down, and one zone lies level: its middles are an ordinary fan at elevation 0. A golden spiral has neither.

use super::params::DirectionsParams;
use super::steering::DIRECTIONS_MAX;
use crate::parameter::{ParameterError, check_range};
use crate::signal::Direction;
use std::f64::consts::{FRAC_PI_2, PI};

/// Fewest directions of a hemisphere: below this the zones at the poles get no cell.
pub const EQUAL_AREA_MIN: usize = 32;

/// The equal-area directions of `params`, of `count` on the whole hemisphere: from the lowest elevation up, from right to left.
///
/// # Errors
/// If the count is too small or too large, a fan is described beside it, or no direction lies between the elevations.
pub(super) fn directions(params: &DirectionsParams, count: usize) -> Result<Vec<Direction>, ParameterError> {
    if !(EQUAL_AREA_MIN..=DIRECTIONS_MAX).contains(&count) {
        let allowed = format!("{EQUAL_AREA_MIN} to {DIRECTIONS_MAX} directions");
        return Err(ParameterError::new("directions.equal_area", count, allowed));
    }
    let fan = DirectionsParams::default();
    if (params.start_deg, params.step_deg, params.count) != (fan.start_deg, fan.step_deg, fan.count) {
        let found = format!("{count} beside start_deg, step_deg or count");
        return Err(ParameterError::new("directions.equal_area", found, "a fan or an equal-area grid, not both"));
    }
    let mut directions = hemisphere(count);
    if let Some([low_deg, high_deg]) = params.elevation_deg {
        check_range("directions.elevation_deg[0]", low_deg, -90.0, 90.0)?;
        check_range("directions.elevation_deg[1]", high_deg, -90.0, 90.0)?;
        directions.retain(|direction| (low_deg..=high_deg).contains(&direction.elevation_rad.to_degrees()));
    }
    if directions.is_empty() {
        let found = format!("{:?}", params.elevation_deg.unwrap_or_default());
        return Err(ParameterError::new(
            "directions.elevation_deg",
            found,
            "a low and a high elevation with a zone between",
        ));
    }
    Ok(directions)
}

/// Middles of `count` cells of equal area on the half of the unit sphere in front.
fn hemisphere(count: usize) -> Vec<Direction> {
    let numbers = cells_of_zones(count);
    let mut directions = Vec::with_capacity(count);
    let mut below = 0;
    for (zone, cells) in numbers.iter().enumerate() {
        // The sine of the elevation grows with the area below; its mean over the zone is its middle.
        let level = 2 * zone + 1 == numbers.len();
        let sine = (2 * below + cells) as f64 / count as f64 - 1.0;
        let elevation_rad = if level { 0.0 } else { sine.asin() };
        // From both ends alike, so that left mirrors right to the last bit.
        let azimuth = |cell: usize| (2 * cell + 1) as f64 - *cells as f64;
        directions.extend(
            (0..*cells)
                .map(|cell| Direction { azimuth_rad: azimuth(cell) * (FRAC_PI_2 / *cells as f64), elevation_rad }),
        );
        below += cells;
    }
    directions
}

/// Number of cells of each zone, from the lowest up: symmetric, an odd number of zones as high as a cell is wide.
fn cells_of_zones(count: usize) -> Vec<usize> {
    let side_rad = (2.0 * PI / count as f64).sqrt();
    let half = (0.5 * (PI / side_rad - 1.0)).round().max(1.0) as usize;
    let height_rad = PI / (2 * half + 1) as f64;
    let mut upper = Vec::with_capacity(half);
    let mut above = 0;
    for zone in 0..half {
        let border_rad = FRAC_PI_2 - (zone + 1) as f64 * height_rad;
        let wanted = (0.5 * count as f64 * (1.0 - border_rad.sin())).round() as usize;
        let cells = wanted.saturating_sub(above).max(1);
        above += cells;
        upper.push(cells);
    }
    let level = count - 2 * above;
    upper.iter().copied().chain([level]).chain(upper.iter().rev().copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(count: usize) -> Vec<Direction> {
        let params = DirectionsParams { equal_area: Some(count), ..DirectionsParams::default() };
        directions(&params, count).unwrap()
    }

    /// Share of `draws` points, spread evenly by a golden spiral, that lies nearest to each direction.
    fn shares(directions: &[Direction], draws: usize) -> Vec<f64> {
        let units: Vec<_> = directions.iter().map(Direction::unit).collect();
        let mut counts = vec![0.0; units.len()];
        let golden = PI * (3.0 - 5f64.sqrt());
        for draw in 0..2 * draws {
            let z = 1.0 - (2 * draw + 1) as f64 / (2 * draws) as f64;
            let (turn, across) = (golden * draw as f64, (1.0 - z * z).sqrt());
            let point = nalgebra::Vector3::new(across * turn.cos(), across * turn.sin(), z);
            if point.x > 0.0 {
                let near = (0..units.len()).max_by(|a, b| units[*a].dot(&point).total_cmp(&units[*b].dot(&point)));
                counts[near.unwrap()] += 1.0;
            }
        }
        counts.iter().map(|count| count / draws as f64).collect()
    }

    #[test]
    fn there_are_as_many_as_were_asked_for_and_a_fan_among_them() {
        for count in [32, 33, 100, 500, 501, 1000, 2000, 3999, 4000, 16_384] {
            let grid = grid(count);
            assert_eq!(grid.len(), count);
            let level: Vec<_> = grid.iter().filter(|direction| direction.elevation_rad == 0.0).collect();
            let expected = (0.5 * PI * count as f64).sqrt();
            assert!((level.len() as f64 / expected - 1.0).abs() < 0.3, "{count}: {} for {expected}", level.len());
            assert!(level.windows(2).all(|pair| pair[0].azimuth_rad < pair[1].azimuth_rad));
        }
    }

    #[test]
    fn left_mirrors_right_and_up_mirrors_down_exactly() {
        let grid = grid(2000);
        let has = |azimuth_rad: f64, elevation_rad: f64| {
            grid.iter()
                .any(|other| other.azimuth_rad == azimuth_rad && (other.elevation_rad - elevation_rad).abs() < 1e-12)
        };
        for direction in &grid {
            assert!(has(-direction.azimuth_rad, direction.elevation_rad), "{direction:?} has no mirror");
            assert!(has(direction.azimuth_rad, -direction.elevation_rad), "{direction:?} has no mirror below");
        }
    }

    #[test]
    fn cells_have_equal_areas_and_neighbours_equal_distances() {
        for count in [500, 1000] {
            let grid = grid(count);
            // What lies nearest is not the cell of equal area itself: measured 0.83 to 1.17 of the mean, counting included.
            for share in shares(&grid, 200 * count) {
                assert!((0.75..1.3).contains(&(share * count as f64)), "{count}: {}", share * count as f64);
            }
            let side_rad = (2.0 * PI / count as f64).sqrt();
            let units: Vec<_> = grid.iter().map(Direction::unit).collect();
            for (index, unit) in units.iter().enumerate() {
                let others = units.iter().enumerate().filter(|(other, _)| *other != index);
                let nearest_rad = others.map(|(_, other)| unit.angle(other)).fold(f64::INFINITY, f64::min);
                assert!((0.6..1.2).contains(&(nearest_rad / side_rad)), "{count}: {}", nearest_rad / side_rad);
            }
        }
    }

    #[test]
    fn limits_cut_the_hemisphere_and_nonsense_is_refused() {
        let with = |equal_area, elevation_deg| {
            let params =
                DirectionsParams { equal_area: Some(equal_area), elevation_deg, ..DirectionsParams::default() };
            directions(&params, equal_area)
        };
        let cut = with(2000, Some([-30.0, 30.0])).unwrap();
        // Half of the area: sin 30 degrees.
        assert!((cut.len() as f64 / 1000.0 - 1.0).abs() < 0.06, "{}", cut.len());
        assert!(cut.iter().all(|direction| direction.elevation_rad.abs() <= 30f64.to_radians()));
        assert_eq!(with(31, None).unwrap_err().key, "directions.equal_area");
        assert_eq!(with(99_999, None).unwrap_err().key, "directions.equal_area");
        assert_eq!(with(500, Some([20.0, 10.0])).unwrap_err().key, "directions.elevation_deg");
        assert_eq!(with(500, Some([f64::NAN, 10.0])).unwrap_err().key, "directions.elevation_deg[0]");
        let both = DirectionsParams { equal_area: Some(500), count: 10, ..DirectionsParams::default() };
        assert_eq!(directions(&both, 500).unwrap_err().key, "directions.equal_area");
    }
}
