//! Directions of interest and the delay of every direction at every microphone. Pure.
//!
//! In: `[imaging] directions` or a CSV of them, an array. Out: [`Direction`]s and `[direction][channel]` delays in seconds: a
//! microphone at p hears a far-field wave from unit direction u earlier than the origin by p.u / c.

use super::equal_area;
use super::params::DirectionsParams;
use crate::parameter::{ParameterError, check_range};
use crate::sensor::MicrophoneArray;
use crate::signal::Direction;
use nalgebra::Vector3;

/// Most directions of one grid.
pub const DIRECTIONS_MAX: usize = 16_384;

/// The directions that `params` describes, a fan or an equal-area grid; `file` is not read.
///
/// # Errors
/// Of [`horizontal_directions`]; what an equal-area grid cannot be; elevations without such a grid; such a grid beside a file.
pub fn directions(params: &DirectionsParams) -> Result<Vec<Direction>, ParameterError> {
    let Some(count) = params.equal_area else {
        return match params.elevation_deg {
            Some(limits_deg) => Err(ParameterError::new(
                "directions.elevation_deg",
                format!("{limits_deg:?}"),
                "only beside equal_area",
            )),
            None => horizontal_directions(params),
        };
    };
    equal_area::directions(params, count)
}

/// The equally spaced horizontal directions of `params`; nothing else of it is looked at.
///
/// # Errors
/// If the count is zero or too large, or a bearing lies outside -180 to 180 degrees.
pub fn horizontal_directions(params: &DirectionsParams) -> Result<Vec<Direction>, ParameterError> {
    check_count(params.count, "directions.count")?;
    check_range("directions.start_deg", params.start_deg, -180.0, 180.0)?;
    check_range("directions.step_deg", params.step_deg.abs(), 1e-3, 180.0).map_err(|_| {
        ParameterError::new("directions.step_deg", params.step_deg, "0.001 to 180 degrees, either sign")
    })?;
    let last_deg = params.start_deg + (params.count - 1) as f64 * params.step_deg;
    if !(last_deg.abs() <= 180.0) {
        return Err(ParameterError::new(
            "directions.count",
            params.count,
            format!("a last bearing from -180 to 180 degrees; this one is {last_deg}"),
        ));
    }
    let bearing = |index: usize| (params.start_deg + index as f64 * params.step_deg).to_radians();
    Ok((0..params.count).map(|index| Direction::horizontal(bearing(index))).collect())
}

/// Directions from the text of a CSV file: a header line, then `azimuth_deg,elevation_deg` rows; the elevation may be missing.
///
/// # Errors
/// Names the line, what was found and what is allowed.
pub fn directions_from_csv(text: &str) -> Result<Vec<Direction>, ParameterError> {
    let key = "directions.file";
    let mut reader =
        csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).flexible(true).from_reader(text.as_bytes());
    let mut directions = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| ParameterError::new(key, error, "rows of azimuth_deg,elevation_deg"))?;
        let line = record.position().map_or(0, csv::Position::line);
        let field = |index: usize, limit_deg: f64| -> Result<f64, ParameterError> {
            let Some(field) = record.get(index) else { return Ok(0.0) };
            match field.parse::<f64>() {
                Ok(value) if value.abs() <= limit_deg => Ok(value.to_radians()),
                _ => Err(ParameterError::new(
                    key,
                    format!("line {line}: {field:?}"),
                    format!("an angle from -{limit_deg} to {limit_deg} degrees"),
                )),
            }
        };
        directions.push(Direction { azimuth_rad: field(0, 180.0)?, elevation_rad: field(1, 90.0)? });
    }
    check_count(directions.len(), key)?;
    Ok(directions)
}

fn check_count(count: usize, key: &str) -> Result<(), ParameterError> {
    if (1..=DIRECTIONS_MAX).contains(&count) {
        Ok(())
    } else {
        Err(ParameterError::new(key, count, format!("1 to {DIRECTIONS_MAX} directions")))
    }
}

/// Delays (p + e).u / c in seconds, `[direction][channel]`, disabled channels included; the emitter e stands in the origin where its
/// place is not to be looked at.
#[must_use]
pub fn delays_s(
    array: &MicrophoneArray,
    emitter_m: &Vector3<f64>,
    directions: &[Direction],
    speed_of_sound_m_s: f64,
) -> Vec<f64> {
    directions
        .iter()
        .flat_map(|direction| {
            let unit = direction.unit();
            array.positions_m.iter().map(move |position| (position + emitter_m).dot(&unit) / speed_of_sound_m_s)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_directions_are_symmetric_half_degrees() {
        let directions = horizontal_directions(&DirectionsParams::default()).unwrap();
        assert_eq!(directions.len(), 180);
        assert!((directions[0].azimuth_rad.to_degrees() + 89.5).abs() < 1e-12);
        assert!((directions[179].azimuth_rad.to_degrees() - 89.5).abs() < 1e-12);
    }

    #[test]
    fn a_microphone_on_the_left_hears_the_left_earlier() {
        let array =
            MicrophoneArray { positions_m: vec![Vector3::new(0.0, 0.1, 0.0)], enabled: vec![true], weights: vec![1.0] };
        let left = [Direction::horizontal(std::f64::consts::FRAC_PI_2), Direction::horizontal(0.0)];
        let delays = delays_s(&array, &Vector3::zeros(), &left, 343.0);
        assert!((delays[0] - 0.1 / 343.0).abs() < 1e-15 && delays[1].abs() < 1e-15);
    }

    #[test]
    fn a_bad_row_is_named_by_its_line() {
        let error = directions_from_csv("azimuth_deg,elevation_deg\n10,5\n200,0\n").unwrap_err();
        assert!(error.to_string().contains("line 3") && error.to_string().contains("200"), "{error}");
        assert!(directions_from_csv("azimuth_deg\n").is_err());
        let good = directions_from_csv("azimuth_deg,elevation_deg\n10,5\n-20\n").unwrap();
        assert_eq!(good.len(), 2);
        assert!((good[0].elevation_rad.to_degrees() - 5.0).abs() < 1e-12);
        assert_eq!(good[1].elevation_rad, 0.0);
    }

    #[test]
    fn bearings_beyond_half_a_turn_are_refused() {
        let params = DirectionsParams { start_deg: 0.0, step_deg: 1.0, count: 182, ..DirectionsParams::default() };
        assert_eq!(horizontal_directions(&params).unwrap_err().key, "directions.count");
        let params = DirectionsParams { start_deg: f64::NAN, ..DirectionsParams::default() };
        assert!(horizontal_directions(&params).is_err());
    }
}
