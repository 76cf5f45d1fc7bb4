//! What the air does: the speed of sound from its temperature.

/// Coldest and warmest air accepted, degrees Celsius: beyond it no sensor of this kind works.
pub const AIR_TEMPERATURE_C: (f64, f64) = (-40.0, 85.0);

/// Speed of sound in dry air at `air_temperature_c`: 331.3 sqrt(1 + T / 273.15), so 343.2 m/s at 20 degrees Celsius.
#[must_use]
pub fn speed_of_sound_m_s(air_temperature_c: f64) -> f64 {
    331.3 * (1.0 + air_temperature_c / 273.15).sqrt()
}
