//! Absorption of sound by air after ISO 9613-1:1993, equations 3 to 5.
//!
//! Frequency and state of the air in, amplitude loss in neper per metre out.

use crate::sim::params::Air;

const REFERENCE_PRESSURE_KPA: f64 = 101.325;
const REFERENCE_TEMPERATURE_K: f64 = 293.15;
const TRIPLE_POINT_K: f64 = 273.16;

/// Absorption coefficient at `frequency_hz` in neper per metre (8.686 dB/m each).
pub(super) fn absorption_np_m(frequency_hz: f64, air: &Air) -> f64 {
    let temperature_k = air.temperature_c + 273.15;
    let ratio = temperature_k / REFERENCE_TEMPERATURE_K;
    let pressure = air.pressure_kpa / REFERENCE_PRESSURE_KPA;
    let saturation = 10f64.powf(-6.8346 * (TRIPLE_POINT_K / temperature_k).powf(1.261) + 4.6151);
    let humidity = air.humidity_percent * saturation / pressure;
    let oxygen_hz = pressure * (24.0 + 4.04e4 * humidity * (0.02 + humidity) / (0.391 + humidity));
    let nitrogen_hz =
        pressure * ratio.powf(-0.5) * (9.0 + 280.0 * humidity * (-4.170 * (ratio.powf(-1.0 / 3.0) - 1.0)).exp());
    let relaxation = 0.01275 * (-2239.1 / temperature_k).exp() / (oxygen_hz + frequency_hz.powi(2) / oxygen_hz)
        + 0.1068 * (-3352.0 / temperature_k).exp() / (nitrogen_hz + frequency_hz.powi(2) / nitrogen_hz);
    frequency_hz.powi(2) * (1.84e-11 / pressure * ratio.sqrt() + ratio.powf(-2.5) * relaxation)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Table 2 of ISO 9613-2 in dB/km at the exact mid-band frequencies 1000 * 2^k Hz.
    #[test]
    fn the_table_of_iso_9613_2_is_reproduced() {
        let table = [
            (10.0, 70.0, [0.4, 1.0, 1.9, 3.7, 9.7, 32.8, 117.0]),
            (20.0, 70.0, [0.3, 1.1, 2.8, 5.0, 9.0, 22.9, 76.6]),
            (15.0, 50.0, [0.5, 1.2, 2.2, 4.2, 10.8, 36.2, 129.0]),
        ];
        for (temperature_c, humidity_percent, expected) in table {
            let air = Air { temperature_c, humidity_percent, ..Air::default() };
            for (index, expected_db_km) in expected.into_iter().enumerate() {
                let frequency_hz = 125.0 * f64::from(1 << index);
                let found_db_km = absorption_np_m(frequency_hz, &air) * 20.0 / std::f64::consts::LN_10 * 1000.0;
                // The table has two or three digits; its frequencies are rounded too.
                let tolerance = 0.05 + 0.015 * expected_db_km;
                assert!((found_db_km - expected_db_km).abs() < tolerance, "{frequency_hz}: {found_db_km}");
            }
        }
    }
}
