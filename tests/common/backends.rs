//! Every backend that a comparison runs on, and small things that its cases are made of.

use noctule::imaging::backend::{Backend, Image};
use noctule::imaging::cpu::{CpuBackend, InstructionSet};
use noctule::imaging::params::ImagingParams;
use noctule::imaging::plan::ImagingPlan;
use noctule::sensor::RecordingFormat;
use noctule::signal::{Direction, MaskTable, SampleFormat};
use std::sync::Arc;

pub type Opener = Box<dyn Fn(Arc<ImagingPlan>, Arc<MaskTable>) -> Box<dyn Backend>>;

pub fn cpu(threads: usize, set: InstructionSet) -> Opener {
    Box::new(move |plan, masks| Box::new(CpuBackend::open_with(plan, masks, Some(threads), set).unwrap()))
}

/// Every backend that the suite runs on, by name.
pub fn backends() -> Vec<(String, Opener)> {
    // A second run for the sake of one adapter has no need of the CPU again.
    let gpu_only = std::env::var_os("NOCTULE_REQUIRE_ADAPTER").is_some();
    let sets = InstructionSet::ALL.into_iter().filter(|set| set.is_available() && !gpu_only);
    #[allow(unused_mut, reason = "the GPU is a feature")]
    let mut backends: Vec<_> = sets.map(|set| (format!("cpu {}", set.as_str()), cpu(2, set))).collect();
    #[cfg(feature = "gpu")]
    if super::gpu::gpu() {
        backends.push(("gpu".to_owned(), Box::new(gpu)));
    }
    backends
}

/// Any adapter, and time enough on a busy machine.
#[cfg(feature = "gpu")]
fn gpu(plan: Arc<ImagingPlan>, masks: Arc<MaskTable>) -> Box<dyn Backend> {
    Box::new(noctule::imaging::gpu::GpuBackend::open(plan, masks, true, 8000).unwrap())
}

pub fn bearings(count: usize) -> Vec<Direction> {
    let step = 170.0 / (count.max(2) - 1) as f64;
    (0..count).map(|i| Direction::horizontal((-85.0 + step * i as f64).to_radians())).collect()
}

pub fn pcm(sample_rate_hz: f64, samples: usize) -> RecordingFormat {
    RecordingFormat { format: SampleFormat::PcmF32, sample_rate_hz, samples, decimation: 1 }
}

pub fn range(range_min_m: f64, range_max_m: f64, range_step_m: Option<f64>) -> ImagingParams {
    ImagingParams { range_min_m, range_max_m, range_step_m, ..ImagingParams::default() }
}

/// An image whose channels have equal gains but for those of `left_out`.
pub fn image_with_gains(plan: &ImagingPlan, masks: &MaskTable, left_out: &[usize]) -> Image {
    let mut image = Image::empty(plan, masks);
    for report in &mut image.channels {
        let count = report.gains.len();
        let used = (0..count).filter(|channel| !left_out.contains(channel)).count();
        for (channel, gain) in report.gains.iter_mut().enumerate() {
            *gain = if left_out.contains(&channel) || used == 0 { 0.0 } else { 1.0 / used as f32 };
        }
    }
    image
}
