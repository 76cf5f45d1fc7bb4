//! Every size, offset and table of the imaging, made once in f64 and shared by both twins.
//!
//! The whole of sections 2 and 3 of the specification after demodulation is linear up to the magnitude, so it is done
//! on the band only, as a complex baseband:
//!
//! 1. a complex band-pass FIR keeps the positive frequencies of the band and decimates by D (band-pass sampling);
//! 2. a transform of length N1 = N / D: index k mod N1 is the spectrum at f_k = k fs / N, for the K bins of the band;
//! 3. times `reference[k]` = 2 P(f_k) conj(S(f_k)) exp(j 2 pi f_k t_0) / (G(f_k) sum s^2 N1), with P the passband, S the emission's
//!    spectrum, G the FIR's own response (so that it cancels exactly) and t_0 = 2 range_first / c; with PHAT the spectrum is first
//!    brought to unit magnitude, and S and G give their phases only;
//! 4. per direction the sum over channels of spectrum times exp(-j 2 pi f_k p.u / c);
//! 5. folded into M bins (index k mod M: sampling every T / M aliases nothing else, since only those instants are asked
//!    for) and transformed back: the analytic signal at t_0 + i T / M, whose magnitude is the envelope, with T = N / fs.

use super::params::{Apodization, ImagingParams, RANGE_STEP_M, SMOOTHING_MIN_HZ, Weighting};
use super::steering;
use crate::parameter::{ParameterError, check_range};
use crate::sensor::{Emission, RecordingFormat, SensorSetup};
use crate::signal::{Direction, PolarGrid, SENSORS_MAX, SampleFormat};
use nalgebra::Vector3;
use std::f64::consts::PI;
use std::sync::Arc;

mod apodization;
pub mod clean;
pub mod combine;
mod filters;
mod floor;
pub mod focus;
mod reference;
mod sizes;

pub use floor::StageFloor;
pub use focus::FocusPlan;
use reference::Band;
#[cfg(feature = "gpu")]
pub(super) use sizes::is_smooth;

/// Stopband of both FIRs, decibels: what they leak stays below 1e-5 of full scale, a tenth of the accuracy asked for.
const ATTENUATION_DB: f64 = 110.0;
/// Width of each raised-cosine edge of the passband, a share of the sweep's bandwidth (specification, section 3).
const EDGE_SHARE: f64 = 0.1;
/// Time between the outputs asked for and whatever wraps around, in units of 1 / bandwidth: the passband's ringing has then
/// fallen below 1e-5, since it falls as 7 / (time * bandwidth)^3.
const RINGING_CYCLES: f64 = 100.0;
/// Time after the end of the emission in which clipping is normal: the direct path (specification, section 3).
const CLIP_GRACE_S: f64 = 2e-3;
/// Default for the largest range step.
const RANGE_STEP_DEFAULT_M: f64 = 5e-3;
/// Most demodulated samples of a ping, most of them with the passband's ringing behind, most range bins, most cells: what
/// memory and a GPU's buffers can carry.
const SAMPLES_MAX: usize = 1 << 20;
const SPAN_MAX: f64 = 4_194_304.0;
const RANGES_MAX: usize = 1 << 16;
const CELLS_MAX: usize = 1 << 24;
/// Most channels of a sensor; a PDM word has 32 bits.
const CHANNELS_MAX: usize = 256;

/// With PHAT, bins whose squared magnitude before weighting is not above this are zero: silence has no phase.
pub const PHAT_POWER_MIN: f32 = 1e-24;

/// Sizes and tables for all sensors. Sensors share everything but array, steering, dead zones and what they send.
#[derive(Debug, Clone)]
pub struct ImagingPlan {
    /// Format of the raw samples.
    pub format: SampleFormat,
    /// PDM words or PCM samples of one channel in a ping.
    pub raw_count: usize,
    /// PDM words per sample; 1 for PCM.
    pub decimation: usize,
    /// Real, symmetric low-pass FIR on PDM bits (+1, -1), odd length, unit gain at DC; empty for PCM. Sample j is centred on word
    /// `j * decimation`; words outside the ping count as zero.
    pub demodulation_taps: Vec<f32>,
    /// Demodulated samples of one channel, Ns.
    pub sample_count: usize,
    /// Their rate fs.
    pub sample_rate_hz: f64,
    /// D.
    pub band_decimation: usize,
    /// Complex band-pass FIR, odd length; output j = sum over i of `taps[i] * x[(j D + i - half) mod N]`, x zero beyond `sample_count`.
    pub band_taps: Vec<[f32; 2]>,
    /// N1: outputs of the FIR and length of the forward transform. N = N1 * D.
    pub forward_len: usize,
    /// k of the first bin of the band.
    pub first_bin: usize,
    /// K: bins in the band.
    pub bin_count: usize,
    /// Frequency of bin k is k times this.
    pub bin_step_hz: f64,
    /// M: length of the inverse transform.
    pub inverse_len: usize,
    /// Weighting of every bin to unit magnitude before the passband (PHAT).
    pub phat: bool,
    /// Smoothing FIR along range on the magnitude, odd length, unit sum; empty when off.
    pub smoothing_taps: Vec<f32>,
    /// The published grid: ranges of the first `range_count` outputs of the inverse transform.
    pub grid: Arc<PolarGrid>,
    /// The ranges that are focused on their exact path, if any.
    pub focus: Option<FocusPlan>,
    /// What differs between sensors.
    pub sensors: Vec<SensorPlan>,
}

/// What differs between sensors.
#[derive(Debug, Clone)]
pub struct SensorPlan {
    /// Channels in the raw data, disabled ones included.
    pub channel_count: usize,
    /// Apodization weight of each channel, zero where disabled.
    pub weights: Vec<f32>,
    /// `[direction][channel]`: (p + e).u / c, by how much the channel hears a wave from the direction earlier than the origin.
    pub delays_s: Arc<Vec<f64>>,
    /// Directions hidden by housings or obstructions: their cells are zero.
    pub hidden: Vec<bool>,
    /// Index of the first sensor with the same delays: steering is shared with it.
    pub steering_of: usize,
    /// `[bin]`, see the module's header: of what this sensor sends, zero outside its own passband. Sensors with equal emissions share one.
    pub reference: Arc<Vec<[f32; 2]>>,
    /// Time after which clipping counts: end of the emission + 2 ms.
    pub clip_after_s: f64,
}

impl ImagingPlan {
    /// Makes every size and table.
    ///
    /// `hidden` has one list a sensor with one entry a direction. Sensors may send different emissions, all at the demodulated
    /// sample rate; the band is then wide enough for all of them. Keys of errors are dotted paths from the root of the configuration.
    ///
    /// # Errors
    /// If a value lies outside its limits, or values do not go together: a band beyond half the sample rate, a range beyond the
    /// end of the recording.
    pub fn new(
        sensors: &[SensorSetup],
        hidden: &[Vec<bool>],
        recording: &RecordingFormat,
        params: &ImagingParams,
        directions: Vec<Direction>,
        speed_of_sound_m_s: f64,
    ) -> Result<ImagingPlan, ParameterError> {
        check_sensors(sensors, hidden, recording, directions.len())?;
        check_range("speed_of_sound_m_s", speed_of_sound_m_s, 50.0, 10_000.0)?;
        let rate_hz = recording.demodulated_rate_hz();
        let bands = Band::of(sensors, rate_hz)?;
        let (band, widths_hz) = (Band::around(&bands), Band::widths_hz(&bands));
        let sensors = &apodized(sensors, params, &directions, &bands, speed_of_sound_m_s)[..];
        let step_m = checked_step(params, recording, widths_hz.1, speed_of_sound_m_s)?;
        let smoothing_half = params.smoothing_hz.map_or(0.0, |cutoff_hz| rate_hz / cutoff_hz);

        let delays = plane_wave_delays(sensors, params, &directions, speed_of_sound_m_s);
        let steer_s = delays.iter().flat_map(|table| table.iter()).fold(0.0, |most: f64, delay| most.max(delay.abs()));
        let last_s = 2.0 * params.range_max_m / speed_of_sound_m_s + steer_s;
        let sent = sensors.iter().map(|sensor| sensor.emission.samples.len()).max().unwrap_or(0);
        let used = checked_span(last_s * rate_hz + smoothing_half, rate_hz, widths_hz.0)? + sent;
        let wanted = sizes::Wanted {
            sample_rate_hz: rate_hz,
            width_hz: band.width_hz(),
            span_min: recording.demodulated_samples().max(used),
            inverse_per_span: speed_of_sound_m_s / (2.0 * rate_hz * step_m),
            channels: sensors.iter().map(|sensor| sensor.array.channel_count()).sum(),
            directions: directions.len() * sensors.len(),
            attenuation_db: ATTENUATION_DB,
        };
        let sizes = sizes::choose(&wanted).ok_or_else(|| {
            ParameterError::new("imaging.range_step_m", step_m, "a step for which a transform length exists")
        })?;

        let span = sizes.forward_len * sizes.decimation;
        let bin_step_hz = rate_hz / span as f64;
        let first_bin = (((band.low_hz - band.edge_hz) / bin_step_hz).floor() + 1.0).max(1.0) as usize;
        let last_bin = ((band.high_hz + band.edge_hz) / bin_step_hz).ceil() as usize - 1;
        let grid = make_grid(params, directions, speed_of_sound_m_s / (2.0 * bin_step_hz * sizes.inverse_len as f64))?;
        let mut plan = ImagingPlan {
            format: recording.format,
            raw_count: recording.samples,
            decimation: recording.decimation,
            demodulation_taps: demodulation_taps(recording, &band),
            sample_count: recording.demodulated_samples(),
            sample_rate_hz: rate_hz,
            band_decimation: sizes.decimation,
            band_taps: band_taps(&band, rate_hz, sizes.decimation),
            forward_len: sizes.forward_len,
            first_bin,
            bin_count: last_bin + 1 - first_bin,
            bin_step_hz,
            inverse_len: sizes.inverse_len,
            phat: params.weighting == Weighting::Phat,
            smoothing_taps: Vec::new(),
            focus: None,
            grid: Arc::new(grid),
            sensors: sensor_plans(sensors, hidden, &delays, rate_hz),
        };
        reference::fill(&mut plan, &bands, sensors, 2.0 * params.range_min_m / speed_of_sound_m_s);
        plan.smoothing_taps = smoothing_taps(&plan, params)?;
        plan.focus = focus::focus(&plan, sensors, params, &bands, speed_of_sound_m_s)?;
        Ok(plan)
    }

    /// Whether any range is imaged with plane waves.
    #[must_use]
    pub fn has_plane_waves(&self) -> bool {
        self.focus.as_ref().is_none_or(|focus| focus.range_count < self.grid.range_count())
    }

    /// Raw values of one ping of a sensor: words (PDM) or channels times samples (PCM).
    #[must_use]
    pub fn raw_len(&self, sensor_index: usize) -> usize {
        match self.format {
            SampleFormat::Pdm => self.raw_count,
            SampleFormat::PcmI16 | SampleFormat::PcmF32 => self.raw_count * self.sensors[sensor_index].channel_count,
        }
    }
}

/// Says so when the configured range step is too coarse to read an echo's peak: specification, section 3.
#[must_use]
pub fn step_warning(params: &ImagingParams, emission: &Emission, speed_of_sound_m_s: f64) -> Option<String> {
    let limit_m = speed_of_sound_m_s / (2.4 * (emission.band_hz.1 - emission.band_hz.0));
    params.range_step_m.filter(|step_m| *step_m > limit_m * (1.0 + 1e-9)).map(|step_m| {
        format!("imaging.range_step_m = {step_m}: above {limit_m:.4} m an echo's peak can fall between two bins and read several dB low")
    })
}

fn check_sensors(
    sensors: &[SensorSetup],
    hidden: &[Vec<bool>],
    recording: &RecordingFormat,
    direction_count: usize,
) -> Result<(), ParameterError> {
    if !(1..=SENSORS_MAX).contains(&sensors.len()) || hidden.len() != sensors.len() {
        return Err(ParameterError::new("sensor", sensors.len(), format!("1 to {SENSORS_MAX} sensors")));
    }
    if !(1..=steering::DIRECTIONS_MAX).contains(&direction_count) {
        let allowed = format!("1 to {} directions", steering::DIRECTIONS_MAX);
        return Err(ParameterError::new("imaging.directions", direction_count, allowed));
    }
    let channels_max = if recording.format == SampleFormat::Pdm { 32 } else { CHANNELS_MAX };
    for (index, (sensor, hidden)) in sensors.iter().zip(hidden).enumerate() {
        let array = &sensor.array;
        let channels = array.channel_count();
        if !(1..=channels_max).contains(&channels) {
            let allowed = format!("1 to {channels_max} microphones");
            return Err(ParameterError::new(format!("sensor[{index}].array"), channels, allowed));
        }
        if array.weights.len() != channels || array.enabled.len() != channels || hidden.len() != direction_count {
            let allowed = "as many weights and switches as microphones, as many hidden flags as directions";
            return Err(ParameterError::new(format!("sensor[{index}].array"), channels, allowed));
        }
        let usable = |weight: &f32| *weight >= 0.0 && weight.is_finite();
        if !array.weights.iter().all(usable) || !array.positions_m.iter().all(|p| p.iter().all(|x| x.abs() < 100.0)) {
            let allowed = "weights not below zero and positions within 100 m";
            return Err(ParameterError::new(format!("sensor[{index}].array"), "a value out of bounds", allowed));
        }
    }
    Ok(())
}

/// Delays of every sensor: from the emitter's place, unless nothing is to be known of near points at all.
fn plane_wave_delays(
    sensors: &[SensorSetup],
    params: &ImagingParams,
    directions: &[Direction],
    speed_of_sound_m_s: f64,
) -> Vec<Arc<Vec<f64>>> {
    let of_sensor = |sensor: &SensorSetup| {
        let emitter_m = if params.focus_to_m == Some(0.0) { Vector3::zeros() } else { sensor.emitter_m };
        Arc::new(steering::delays_s(&sensor.array, &emitter_m, directions, speed_of_sound_m_s))
    };
    sensors.iter().map(of_sensor).collect()
}

/// The sensors with the weights that are asked for.
fn apodized(
    sensors: &[SensorSetup],
    params: &ImagingParams,
    directions: &[Direction],
    bands: &[Band],
    speed_of_sound_m_s: f64,
) -> Vec<SensorSetup> {
    let mut sensors = sensors.to_vec();
    if params.apodization == Apodization::LowSideLobes {
        for (sensor, band) in sensors.iter_mut().zip(bands) {
            sensor.array.weights = apodization::low_side_lobes(sensor, directions, band, speed_of_sound_m_s);
        }
    }
    sensors
}

/// Largest range step allowed.
fn checked_step(
    params: &ImagingParams,
    recording: &RecordingFormat,
    widest_hz: f64,
    speed_of_sound_m_s: f64,
) -> Result<f64, ParameterError> {
    let samples = recording.demodulated_samples();
    if !(1..=SAMPLES_MAX).contains(&samples) {
        let allowed = format!("1 to {SAMPLES_MAX} samples after demodulation");
        return Err(ParameterError::new("recording.samples", recording.samples, allowed));
    }
    check_range("imaging.range_min_m", params.range_min_m, 0.0, 1000.0)?;
    let heard_m = 0.5 * speed_of_sound_m_s * samples as f64 / recording.demodulated_rate_hz();
    if !(params.range_max_m > params.range_min_m && params.range_max_m <= heard_m) {
        let allowed = format!(
            "above imaging.range_min_m = {} and at most {heard_m:.3}, where the recording ends",
            params.range_min_m
        );
        return Err(ParameterError::new("imaging.range_max_m", params.range_max_m, allowed));
    }
    let finest_m = speed_of_sound_m_s / (2.4 * widest_hz);
    let step_m = params.range_step_m.unwrap_or(RANGE_STEP_DEFAULT_M.min(finest_m));
    check_range("imaging.range_step_m", step_m, *RANGE_STEP_M.start(), *RANGE_STEP_M.end())?;
    if let Some(cutoff_hz) = params.smoothing_hz {
        check_range("imaging.smoothing_hz", cutoff_hz, SMOOTHING_MIN_HZ, speed_of_sound_m_s / (4.0 * step_m))?;
    }
    Ok(step_m)
}

/// Samples until the last range has been heard and what wraps around has rung out.
fn checked_span(heard: f64, rate_hz: f64, width_hz: f64) -> Result<usize, ParameterError> {
    let used = heard + RINGING_CYCLES / width_hz * rate_hz;
    if !(used <= SPAN_MAX) {
        let allowed = format!("a band of at least {:.0} Hz", (RINGING_CYCLES * rate_hz / SPAN_MAX).ceil());
        return Err(ParameterError::new("emission.end_hz", format!("a band of {width_hz} Hz"), allowed));
    }
    Ok(used.ceil() as usize)
}

fn make_grid(params: &ImagingParams, directions: Vec<Direction>, step_m: f64) -> Result<PolarGrid, ParameterError> {
    let ranges = ((params.range_max_m - params.range_min_m) / step_m * (1.0 + 1e-12)).floor() as usize + 1;
    if ranges > RANGES_MAX || ranges * directions.len() > CELLS_MAX {
        let found = format!("{step_m} m, that is {ranges} ranges by {} directions", directions.len());
        let allowed = format!("at most {RANGES_MAX} ranges and {CELLS_MAX} cells");
        return Err(ParameterError::new("imaging.range_step_m", found, allowed));
    }
    Ok(PolarGrid::new(directions, params.range_min_m, step_m, ranges))
}

/// Low-pass for PDM: only what the decimation would fold into the band has to be stopped.
fn demodulation_taps(recording: &RecordingFormat, band: &Band) -> Vec<f32> {
    if recording.format != SampleFormat::Pdm {
        return Vec::new();
    }
    let top_hz = band.high_hz + band.edge_hz;
    let pass = top_hz / recording.sample_rate_hz;
    let stop = (recording.demodulated_rate_hz() - top_hz) / recording.sample_rate_hz;
    filters::low_pass(pass, stop, ATTENUATION_DB).into_iter().map(|tap| tap as f32).collect()
}

/// Complex band-pass: only what the decimation would fold into the band has to be stopped.
fn band_taps(band: &Band, rate_hz: f64, decimation: usize) -> Vec<[f32; 2]> {
    if decimation == 1 {
        return vec![[1.0, 0.0]];
    }
    let pass = 0.5 * band.width_hz() / rate_hz;
    let stop = 1.0 / decimation as f64 - pass;
    let taps = filters::low_pass(pass, stop, ATTENUATION_DB);
    let half = (taps.len() / 2) as f64;
    let turn = |index: usize| -2.0 * PI * band.centre_hz() / rate_hz * (index as f64 - half);
    let modulated = taps.iter().enumerate().map(|(index, tap)| (turn(index).sin_cos(), tap));
    modulated.map(|((sin, cos), tap)| [(tap * cos) as f32, (tap * sin) as f32]).collect()
}

fn smoothing_taps(plan: &ImagingPlan, params: &ImagingParams) -> Result<Vec<f32>, ParameterError> {
    let Some(cutoff_hz) = params.smoothing_hz else { return Ok(Vec::new()) };
    let taps = filters::gaussian(cutoff_hz / (plan.bin_step_hz * plan.inverse_len as f64));
    if taps.len() > plan.inverse_len / 2 {
        let allowed = "a cut-off whose filter is shorter than half the recording";
        return Err(ParameterError::new("imaging.smoothing_hz", cutoff_hz, allowed));
    }
    Ok(taps.into_iter().map(|tap| tap as f32).collect())
}

fn sensor_plans(
    sensors: &[SensorSetup],
    hidden: &[Vec<bool>],
    delays: &[Arc<Vec<f64>>],
    rate_hz: f64,
) -> Vec<SensorPlan> {
    let one = |(index, sensor): (usize, &SensorSetup)| {
        let steering_of = (0..index).find(|&first| delays[first] == delays[index]).unwrap_or(index);
        let weights = sensor.array.weights.iter().zip(&sensor.array.enabled);
        SensorPlan {
            channel_count: sensor.array.channel_count(),
            weights: weights.map(|(weight, enabled)| if *enabled { *weight } else { 0.0 }).collect(),
            delays_s: Arc::clone(&delays[steering_of]),
            hidden: hidden[index].clone(),
            steering_of,
            reference: Arc::default(),
            clip_after_s: sensor.emission.samples.len() as f64 / rate_hz + CLIP_GRACE_S,
        }
    };
    sensors.iter().enumerate().map(one).collect()
}
