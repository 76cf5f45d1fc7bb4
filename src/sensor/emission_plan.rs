//! Who sends what, and when: the plan of the sensors' emissions.
//!
//! Goes in: `[emission]` and the `emission` of each `[[sensor]]`. Comes out: each sensor's own sweep, and how long after the first sensor
//! of a ping set it fires. Never makes a sample and never judges whether the turns fit a ping period; the configuration does.

use super::emission::{EmissionParams, EmissionShape};
use crate::parameter::ParameterError;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// When the sensors of a ping set fire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EmissionPlan {
    /// All at once.
    #[default]
    Together,
    /// One after another, in the order of the configuration, a slot apart.
    InTurn,
}

/// What the sensors send, as far as they do not say so themselves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sweeps {
    /// All the sweep of `[emission]`.
    #[default]
    Same,
    /// Every second sensor the sweep from the other end: down, up, down.
    Alternate,
    /// The band of `[emission]` in as many equal parts as there are sensors, the first sensor the part that the sweep begins with. Between
    /// two parts a fifth of a part's width is left out, where the passbands of both have their edges.
    Bands,
}

/// Gap between two parts of the band, a share of a part: two edges of the matched filter's passband, a tenth each. Of three parts of 25
/// kHz in 2.5 ms it brings a foreign one from 27 to 36 dB below one's own, and the echo from 29 to 33 mm.
const GUARD_SHARE: f64 = 0.2;

/// `emission = { ... }` of a `[[sensor]]`: what it sends other than `[emission]` says.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorEmission {
    /// Form of the sweep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shape: Option<EmissionShape>,
    /// Frequency at the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_hz: Option<f64>,
    /// Frequency at the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_hz: Option<f64>,
    /// Duration.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    /// Share of the duration that each end's taper takes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taper: Option<f64>,
    /// File of samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
}

impl EmissionParams {
    /// What sensor `index` of `count` sends: `[emission]`, then `sweeps`, then what the sensor says itself.
    #[must_use]
    pub fn of_sensor(&self, index: usize, count: usize, own: Option<&SensorEmission>) -> EmissionParams {
        let mut params = self.clone();
        match self.sweeps {
            Sweeps::Alternate if index % 2 == 1 => (params.start_hz, params.end_hz) = (self.end_hz, self.start_hz),
            Sweeps::Bands => {
                let parts = count.max(1) as f64;
                let part_hz = (self.end_hz - self.start_hz) / (parts + GUARD_SHARE * (parts - 1.0));
                params.start_hz = self.start_hz + part_hz * (1.0 + GUARD_SHARE) * index as f64;
                // Not a rounding error beyond the common end.
                params.end_hz = if index + 1 == count { self.end_hz } else { params.start_hz + part_hz };
            }
            Sweeps::Same | Sweeps::Alternate => {}
        }
        let Some(own) = own else { return params };
        params.shape = own.shape.unwrap_or(params.shape);
        params.start_hz = own.start_hz.unwrap_or(params.start_hz);
        params.end_hz = own.end_hz.unwrap_or(params.end_hz);
        params.duration_s = own.duration_s.unwrap_or(params.duration_s);
        params.taper = own.taper.unwrap_or(params.taper);
        // The common file is that of a common shape.
        params.file = own.file.clone().or(params.file.filter(|_| params.shape == EmissionShape::Csv));
        params
    }

    /// Judges what makes a plan of the sweeps.
    ///
    /// # Errors
    /// `sweeps` of samples that nobody can cut or turn round, or `slot_s` without turns.
    pub(super) fn validate_plan(&self) -> Result<(), ParameterError> {
        if self.shape == EmissionShape::Csv && self.sweeps != Sweeps::Same {
            let found = format!("{:?} beside shape = \"csv\"", self.sweeps).to_lowercase();
            let allowed =
                "\"same\": samples from a file are sent as they are; give each [[sensor]] an emission of its own";
            return Err(ParameterError::new("sweeps", found, allowed));
        }
        match self.slot_s {
            Some(slot_s) if self.plan == EmissionPlan::Together => {
                Err(ParameterError::new("slot_s", slot_s, "no slot, or plan = \"in-turn\""))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_sends_its_part_of_the_common_sweep_and_its_own_words_win() {
        let same = EmissionParams::default();
        assert_eq!(same.of_sensor(2, 3, None), same);
        let ends = |params: &EmissionParams, index| {
            let sweep = params.of_sensor(index, 3, None);
            (sweep.start_hz, sweep.end_hz)
        };
        let alternate = EmissionParams { sweeps: Sweeps::Alternate, ..same.clone() };
        assert_eq!([0, 1, 2].map(|index| ends(&alternate, index)), [(50e3, 25e3), (25e3, 50e3), (50e3, 25e3)]);
        let bands = EmissionParams { sweeps: Sweeps::Bands, start_hz: 88e3, end_hz: 20e3, ..same.clone() };
        let found = [0, 1, 2].map(|index| ends(&bands, index));
        for ((start_hz, end_hz), wanted) in found.into_iter().zip([(88e3, 68e3), (64e3, 44e3), (40e3, 20e3)]) {
            assert!((start_hz - wanted.0).abs() < 1e-6 && (end_hz - wanted.1).abs() < 1e-6, "{found:?}");
        }
        let own = SensorEmission { start_hz: Some(30e3), duration_s: Some(1e-3), ..SensorEmission::default() };
        let found = alternate.of_sensor(1, 3, Some(&own));
        assert_eq!((found.start_hz, found.end_hz, found.duration_s, found.taper), (30e3, 50e3, 1e-3, 0.1));
        let csv = EmissionParams { shape: EmissionShape::Csv, file: Some("a.csv".into()), ..same };
        let own = SensorEmission { shape: Some(EmissionShape::Linear), ..SensorEmission::default() };
        assert_eq!(csv.of_sensor(0, 1, Some(&own)).validate(), Ok(()), "the common file is not the sensor's");
    }
}
