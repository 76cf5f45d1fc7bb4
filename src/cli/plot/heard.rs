//! What the microphones of one raw ping heard, computed by the imaging's own first two stages.

use super::no_ping;
use crate::cli::process::{backend_failure, data_failure};
use crate::cli::{Failure, exit};
use crate::config::Config;
use crate::imaging::backend::{Backend as _, Image, Stage, StageOutput};
use crate::imaging::cpu::CpuBackend;
use crate::imaging::plan::ImagingPlan;
use crate::io::picture::Picture;
use crate::io::plot::{HeardPing, heard};
use crate::io::recording_file::RecordingFile;
use crate::service::wiring;
use crate::signal::{MaskTable, PingSet, SampleFormat};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::path::Path;
use std::sync::Arc;

/// Least level of a spectrum: what a computer's zero would show as minus infinity.
const SILENCE_DB: f64 = -300.0;

/// Draws a ping of a raw recording.
///
/// # Errors
/// Exit 2 for a ping that there is not, 65, 74, 77, 78.
pub fn draw(
    config: &Config,
    sensor_index: usize,
    input: &Path,
    ping: u64,
) -> Result<Vec<(&'static str, Picture)>, Failure> {
    let mut recording = RecordingFile::open_sensor(input, wiring::file_hints(config), sensor_index)
        .map_err(|error| data_failure(&error))?;
    let shape = recording.shape();
    let bad = |message: String| Failure::new(exit::DATA, format!("{}: {message}", input.display()));
    let format = wiring::recording_for(config, shape.format, shape.sample_count)
        .map_err(|error| bad(format!("found {}, allowed: {} (recording.{})", error.found, error.allowed, error.key)))?;
    let setup =
        wiring::sensing_of_one(config, sensor_index, &format).map_err(|error| Failure::new(exit::CONFIG, error))?;
    let (plan, sensor) = (&setup.plan, &setup.sensors[0]);
    let channels = plan.sensors[0].channel_count;
    if let Some(found) = shape.channel_count.filter(|found| *found != channels) {
        return Err(bad(format!(
            "found {found} microphones, allowed: {channels}, as the array of sensor {} has",
            sensor.name
        )));
    }
    if ping >= shape.ping_count as u64 {
        return Err(no_ping(input, ping, shape.ping_count as u64));
    }
    let mut pings = PingSet::empty(1, plan.format, &[plan.raw_len(0)]);
    pings.present = [true, false, false];
    for _ in 0..=ping {
        recording.read_ping(pings.pings[0].samples_mut()).map_err(|error| data_failure(&error))?;
    }
    let (signals, envelopes) = stages(plan, &pings).map_err(|error| backend_failure(&error))?;
    let rate_hz = plan.sample_rate_hz;
    let grid = &plan.grid;
    let drawn = HeardPing {
        spectrum_db: spectrum_db(&signals),
        signals,
        sample_rate_hz: rate_hz,
        band_hz: sensor.emission.band_hz,
        envelopes,
        ranges_m: (grid.range_m(0), grid.range_m(grid.range_count() - 1)),
    };
    let kind = match shape.format {
        SampleFormat::Pdm => "PDM, demodulated",
        SampleFormat::PcmI16 => "PCM, 16 bit",
        SampleFormat::PcmF32 => "PCM, f32",
    };
    let title = format!("{}, ping {ping} of {}, sensor {}", input.display(), shape.ping_count, sensor.name);
    let facts = format!("{channels} microphones, {} samples at {:.0} Hz, {kind}", plan.sample_count, rate_hz);
    Ok(vec![("heard", heard([&title, &facts], &drawn))])
}

/// Rows of a channel each.
type Rows = Vec<Vec<f32>>;

/// Demodulated signals and the envelopes after the matched filter, by channel.
fn stages(plan: &Arc<ImagingPlan>, pings: &PingSet) -> Result<(Rows, Rows), crate::imaging::backend::BackendError> {
    let masks = Arc::new(MaskTable::default());
    let mut backend = CpuBackend::open(Arc::clone(plan), Arc::clone(&masks), None)?;
    let mut image = Image::empty(plan, &masks);
    // All microphones are shown as they are, whatever is wrong with them.
    image.channels[0].gains.iter_mut().for_each(|gain| *gain = 1.0);
    let mut signals = Vec::new();
    if let StageOutput::Real(values) = backend.image_up_to(Stage::Demodulate, pings, 0, &mut image)? {
        signals = values.chunks(plan.sample_count).map(<[f32]>::to_vec).collect();
    }
    let mut envelopes = Vec::new();
    if let StageOutput::Complex(bins) = backend.image_up_to(Stage::MatchedFilter, pings, 0, &mut image)? {
        let inverse = FftPlanner::new().plan_fft_inverse(plan.inverse_len);
        for channel in bins.chunks(plan.bin_count) {
            // The carrier turns the phase alone: the band may begin at zero.
            let mut values: Vec<Complex<f32>> = channel.iter().map(|[re, im]| Complex::new(*re, *im)).collect();
            values.resize(plan.inverse_len.max(values.len()), Complex::default());
            values.truncate(plan.inverse_len);
            inverse.process(&mut values);
            envelopes.push(values.iter().take(plan.grid.range_count()).map(|value| value.norm()).collect());
        }
    }
    Ok((signals, envelopes))
}

/// Mean power of all channels at each frequency from 0 to half the rate, decibels of a full-scale sine.
fn spectrum_db(signals: &[Vec<f32>]) -> Vec<f64> {
    let len = signals.iter().map(Vec::len).max().unwrap_or(0);
    if len < 2 {
        return Vec::new();
    }
    let forward = FftPlanner::new().plan_fft_forward(len);
    let mut power = vec![0.0_f64; len / 2 + 1];
    let finite: Vec<&Vec<f32>> = signals.iter().filter(|signal| signal.iter().all(|value| value.is_finite())).collect();
    for signal in &finite {
        let mut values: Vec<Complex<f32>> = signal.iter().map(|value| Complex::new(*value, 0.0)).collect();
        forward.process(&mut values);
        for (sum, value) in power.iter_mut().zip(&values) {
            *sum += f64::from(value.norm_sqr());
        }
    }
    let scale = 4.0 / (len as f64 * len as f64 * finite.len().max(1) as f64);
    power.into_iter().map(|sum| (10.0 * (sum * scale).log10()).max(SILENCE_DB)).collect()
}
