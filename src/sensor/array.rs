//! Microphone arrays: positions in the sensor frame, enabled channels, weights.

use nalgebra::Vector3;

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
    /// Number of channels in the raw data, disabled ones included.
    #[must_use]
    pub fn channel_count(&self) -> usize {
        self.positions_m.len()
    }
}
