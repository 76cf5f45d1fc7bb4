//! Microphone arrays: positions in the sensor frame, enabled channels, weights.
//!
//! Goes in: the built-in array or a CSV file, and a list of microphones to leave out. Comes out: one position, switch and
//! weight a channel. Which channels are broken today is not known here; that is judged ping by ping.

use super::table;
use crate::parameter::ParameterError;
use nalgebra::Vector3;
use std::path::Path;

/// Most microphones of one array.
pub const MICROPHONES_MAX: usize = 1024;
/// Largest distance of a microphone from the array's origin.
const EXTENT_MAX_M: f64 = 10.0;

const ERTIS_V3D1: &str = include_str!("../../fixtures/arrays/ertis_v3d1_microphones.csv");

/// Positions of the microphones of one sensor, in the order of channels (bit k of a PDM word = microphone k).
#[derive(Debug, Clone, PartialEq)]
pub struct MicrophoneArray {
    /// Positions in the sensor frame.
    pub positions_m: Vec<Vector3<f64>>,
    /// Which channels are used; a disabled channel is still part of the raw data.
    pub enabled: Vec<bool>,
    /// Apodization, one weight a channel, ones by default.
    pub weights: Vec<f32>,
}

impl MicrophoneArray {
    /// The 32 microphones of the eRTIS v3D1, all enabled.
    #[must_use]
    pub fn ertis_v3d1() -> Self {
        match Self::from_csv(ERTIS_V3D1) {
            Ok(array) => array,
            Err(error) => unreachable!("the built-in array is part of the program: {error}"),
        }
    }

    /// Reads `mic,x_m,y_m,z_m` rows under that header, microphones counted from 0 in order. A fifth column `weight` sets the
    /// apodization.
    ///
    /// # Errors
    /// Names the line, what was found and what is allowed; the key is empty.
    pub fn from_csv(text: &str) -> Result<Self, ParameterError> {
        let (header, rows) = table::rows(text, true)?;
        let header = header.unwrap_or_default().join(",");
        let columns = match header.as_str() {
            "mic,x_m,y_m,z_m" => 4,
            "mic,x_m,y_m,z_m,weight" => 5,
            _ => return Err(ParameterError::new("", format!("the header {header:?}"), "mic,x_m,y_m,z_m[,weight]")),
        };
        if !(1..=MICROPHONES_MAX).contains(&rows.len()) {
            let allowed = format!("1 to {MICROPHONES_MAX} rows");
            return Err(ParameterError::new("", format!("{} rows", rows.len()), allowed));
        }
        let mut array = Self { positions_m: Vec::new(), enabled: vec![true; rows.len()], weights: Vec::new() };
        for (index, row) in rows.iter().enumerate() {
            let [mic, x_m, y_m, z_m, weight @ ..] = row.values.as_slice() else {
                return Err(row.refuse(format!("{} numbers", row.values.len()), format!("{columns} numbers")));
            };
            if row.values.len() != columns {
                return Err(row.refuse(format!("{} numbers", row.values.len()), format!("{columns} numbers")));
            }
            if *mic != index as f64 {
                return Err(row.refuse(format!("microphone {mic}"), format!("microphone {index}: row k is channel k")));
            }
            let position_m = Vector3::new(*x_m, *y_m, *z_m);
            if !(position_m.amax() <= EXTENT_MAX_M) {
                let found = format!("a position of [{x_m}, {y_m}, {z_m}]");
                return Err(row.refuse(found, format!("metres, each from -{EXTENT_MAX_M} to {EXTENT_MAX_M}")));
            }
            let weight = weight.first().copied().unwrap_or(1.0);
            if !(0.0..=1e3).contains(&weight) {
                return Err(row.refuse(format!("a weight of {weight}"), "a number from 0 to 1000"));
            }
            array.positions_m.push(position_m);
            array.weights.push(weight as f32);
        }
        array.check_something_is_heard()?;
        Ok(array)
    }

    /// As [`MicrophoneArray::from_csv`], from a file.
    ///
    /// # Errors
    /// Names the file too; also when it cannot be read.
    pub fn from_csv_file(path: &Path) -> Result<Self, ParameterError> {
        Self::from_csv(&table::read(path)?).map_err(|error| table::in_file(path, error))
    }

    /// Number of channels in the raw data, disabled ones included.
    #[must_use]
    pub fn channel_count(&self) -> usize {
        self.positions_m.len()
    }

    /// Switches the microphones of `disabled_mics` off.
    ///
    /// # Errors
    /// A microphone that does not exist or is named twice, and a list that leaves none; the key begins with `disabled_mics`.
    pub fn disable(&mut self, disabled_mics: &[usize]) -> Result<(), ParameterError> {
        let last = self.channel_count() - 1;
        for (index, &mic) in disabled_mics.iter().enumerate() {
            let key = || format!("disabled_mics[{index}]");
            match self.enabled.get_mut(mic) {
                Some(enabled) if *enabled => *enabled = false,
                Some(_) => return Err(ParameterError::new(key(), format!("{mic} again"), "each microphone once")),
                None => return Err(ParameterError::new(key(), mic, format!("a microphone of the array: 0 to {last}"))),
            }
        }
        self.check_something_is_heard().map_err(|error| error.within("disabled_mics"))
    }

    fn check_something_is_heard(&self) -> Result<(), ParameterError> {
        if self.enabled.iter().zip(&self.weights).any(|(enabled, weight)| *enabled && *weight > 0.0) {
            return Ok(());
        }
        Err(ParameterError::new("", "no microphone in use", "at least one enabled microphone with a weight above 0"))
    }
}
