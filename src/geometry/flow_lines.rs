//! The region of acoustic flow following: a fan of lines parallel to the robot's x axis (specification, section 7).
//!
//! Goes in: `{ shape = "flow-lines", lateral_m = [a, b], step_m = s, x_m = [a, b] }`. Comes out: the lateral distances of
//! the lines. Where such a line lies in a sensor's image is not known here.

use super::shape::{COORDINATE_MAX_M, check_interval};
use crate::parameter::{ParameterError, check_positive};
use serde::Serialize;
use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, MapAccess, Visitor};
use std::fmt;

/// Most flow lines of one region.
pub const FLOW_LINES_MAX: usize = 1000;

/// Equally spaced lines of constant lateral distance, robot frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(into = "Written")]
pub struct FlowLinesRegion {
    /// Lateral distance of the first and (at most) of the last line, left positive.
    pub lateral_m: [f64; 2],
    /// Distance between lines.
    pub step_m: f64,
    /// The stretch of the lines that counts, in x.
    pub x_m: [f64; 2],
}

impl FlowLinesRegion {
    /// Number of lines, at least one for a valid region.
    #[must_use]
    pub fn count(&self) -> usize {
        // Ten steps of 0.1 reach 1.0 although they add up to a little less.
        ((self.lateral_m[1] - self.lateral_m[0]) / self.step_m + 1e-9).floor() as usize + 1
    }

    /// Lateral distances of the lines, ascending.
    #[must_use]
    pub fn laterals_m(&self) -> Vec<f64> {
        (0..self.count()).map(|index| self.lateral_m[0] + index as f64 * self.step_m).collect()
    }

    /// Judges the numbers; `key` is the dotted path of the region itself.
    ///
    /// # Errors
    /// The first number that is not allowed, with its key.
    pub fn validate(&self, key: &str) -> Result<(), ParameterError> {
        let numbers = check_interval("lateral_m", &self.lateral_m, false)
            .and(check_interval("x_m", &self.x_m, true))
            .and(check_positive("step_m", self.step_m, COORDINATE_MAX_M));
        let count = numbers.and_then(|()| {
            if self.count() <= FLOW_LINES_MAX {
                return Ok(());
            }
            let found = format!("{} (a fan of {} lines)", self.step_m, self.count());
            Err(ParameterError::new("step_m", found, format!("a step that makes at most {FLOW_LINES_MAX} lines")))
        });
        count.map_err(|error| error.within(key))
    }
}

#[derive(Clone, Copy, Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    FlowLines,
}

/// The region as the configuration writes it.
#[derive(Clone, Serialize)]
struct Written {
    shape: Kind,
    lateral_m: [f64; 2],
    step_m: f64,
    x_m: [f64; 2],
}

impl From<FlowLinesRegion> for Written {
    fn from(region: FlowLinesRegion) -> Self {
        let FlowLinesRegion { lateral_m, step_m, x_m } = region;
        Self { shape: Kind::FlowLines, lateral_m, step_m, x_m }
    }
}

/// Judges `shape` before any other key: of a circle it says that it is no fan, not that it has a key too many.
struct RegionVisitor;

impl<'de> Visitor<'de> for RegionVisitor {
    type Value = FlowLinesRegion;

    fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("{ shape = \"flow-lines\", ... }")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<FlowLinesRegion, A::Error> {
        let (mut kind, mut lateral_m, mut step_m, mut x_m) = (None::<Kind>, None, None, None);
        let mut stray = None;
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "shape" => kind = Some(map.next_value()?),
                "lateral_m" => lateral_m = Some(map.next_value()?),
                "step_m" => step_m = Some(map.next_value()?),
                "x_m" => x_m = Some(map.next_value()?),
                _ => {
                    map.next_value::<IgnoredAny>()?;
                    stray = stray.or(Some(key));
                }
            }
        }
        if let Some(key) = stray {
            return Err(A::Error::unknown_field(&key, &["shape", "lateral_m", "step_m", "x_m"]));
        }
        let missing = A::Error::missing_field;
        kind.ok_or_else(|| missing("shape"))?;
        Ok(FlowLinesRegion {
            lateral_m: lateral_m.ok_or_else(|| missing("lateral_m"))?,
            step_m: step_m.ok_or_else(|| missing("step_m"))?,
            x_m: x_m.ok_or_else(|| missing("x_m"))?,
        })
    }
}

impl<'de> Deserialize<'de> for FlowLinesRegion {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(RegionVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn region() -> FlowLinesRegion {
        FlowLinesRegion { lateral_m: [-2.0, 2.0], step_m: 0.05, x_m: [-1.0, 3.0] }
    }

    #[test]
    fn lines_include_both_ends_and_the_x_axis() {
        let laterals = region().laterals_m();
        assert_eq!(laterals.len(), 81);
        assert!((laterals[80] - 2.0).abs() < 1e-12 && laterals[40].abs() < 1e-12);
    }

    #[test]
    fn what_is_written_is_read_again() {
        let text = toml::to_string(&region()).unwrap();
        assert!(text.contains("shape = \"flow-lines\""), "{text}");
        assert_eq!(toml::from_str::<FlowLinesRegion>(&text).unwrap(), region());
        assert!(toml::from_str::<FlowLinesRegion>(&text.replace("flow-lines", "circle")).is_err());
        assert!(toml::from_str::<FlowLinesRegion>(&format!("{text}\nextra = 1")).is_err());
    }

    #[test]
    fn a_fan_that_is_too_fine_or_turned_round_or_nan_is_refused() {
        let refused = |region: FlowLinesRegion| region.validate("regions[0]").unwrap_err().key;
        assert!(region().validate("regions[0]").is_ok());
        assert_eq!(refused(FlowLinesRegion { step_m: 1e-3, ..region() }), "regions[0].step_m");
        assert_eq!(refused(FlowLinesRegion { step_m: f64::NAN, ..region() }), "regions[0].step_m");
        assert_eq!(refused(FlowLinesRegion { lateral_m: [1.0, -1.0], ..region() }), "regions[0].lateral_m");
        assert_eq!(refused(FlowLinesRegion { x_m: [f64::NAN, 1.0], ..region() }), "regions[0].x_m");
    }
}
