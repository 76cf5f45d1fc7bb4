//! What the air does: the speed of sound from its temperature.

/// Coldest and warmest air accepted, degrees Celsius: beyond it no sensor of this kind works.
pub const AIR_TEMPERATURE_C: (f64, f64) = (-40.0, 85.0);

/// Speed of sound in dry air at `air_temperature_c`: 331.3 sqrt(1 + T / 273.15), so 343.2 m/s at 20 degrees Celsius.
#[must_use]
pub fn speed_of_sound_m_s(air_temperature_c: f64) -> f64 {
    331.3 * (1.0 + air_temperature_c / 273.15).sqrt()
}

/// Temperature of dry air in which sound travels at `speed_of_sound_m_s`: 20.0 degrees Celsius at 343.2 m/s, and 1.65 K a
/// metre per second there. The inverse of [`speed_of_sound_m_s`]; NaN stays NaN.
#[must_use]
pub fn air_temperature_c(speed_of_sound_m_s: f64) -> f64 {
    273.15 * ((speed_of_sound_m_s / 331.3).powi(2) - 1.0)
}

/// By how much the temperature rises for each metre per second, kelvins.
#[must_use]
pub fn kelvins_per_m_s(speed_of_sound_m_s: f64) -> f64 {
    2.0 * 273.15 * speed_of_sound_m_s / (331.3 * 331.3)
}
