//! One bench per stage of the imaging, named by its stem (demodulate, matched_filter, delay_and_sum, envelope, masked_energy), and the
//! whole ping set (image) and the judging of its channels (channels), on the default configuration.
//!
//! `cargo bench --bench stages`; ids are `<backend>-<format>-<sensors>-sensors-<threads>-threads/<stage>`. The GPU is whatever adapter there
//! is, a software one included; without one its rows are missing.

#[path = "../tests/common/mod.rs"]
mod common;

use common::scenes::{Case, random_masks};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use noctule::imaging::backend::{Backend, Image, Stage};
use noctule::imaging::cpu::CpuBackend;
use noctule::imaging::plan::ImagingPlan;
use noctule::signal::{MaskTable, PingSet, SampleFormat};
use std::sync::Arc;
use std::time::Duration;

/// The backends by name; the number of threads is part of it.
fn backends(plan: &Arc<ImagingPlan>, masks: &Arc<MaskTable>) -> Vec<(String, Box<dyn Backend>)> {
    let cpu = |threads: usize| -> Box<dyn Backend> {
        Box::new(CpuBackend::open(Arc::clone(plan), Arc::clone(masks), Some(threads)).unwrap())
    };
    #[allow(unused_mut, reason = "the GPU is a feature")]
    let mut backends: Vec<_> = [1, 2].into_iter().map(|threads| (format!("cpu {threads}"), cpu(threads))).collect();
    #[cfg(feature = "gpu")]
    if let Ok(gpu) = noctule::imaging::gpu::GpuBackend::open(Arc::clone(plan), Arc::clone(masks), true, 10_000) {
        backends.push(("gpu 1".to_owned(), Box::new(gpu)));
    }
    backends
}

fn stages(criterion: &mut Criterion) {
    for (format, name) in
        [(SampleFormat::PcmF32, "pcm-f32"), (SampleFormat::PcmI16, "pcm-i16"), (SampleFormat::Pdm, "pdm")]
    {
        for sensors in 1..=3 {
            let case = Case::standard("bench", format, sensors, 1);
            let plan = case.plan();
            let masks = random_masks(&plan, 7);
            let pings = case.random_pings(1);
            let mut image = Image::empty(&plan, &masks);
            for (backend_name, mut backend) in backends(&plan, &masks) {
                let (kind, threads) = backend_name.split_once(' ').unwrap();
                let group = format!("{kind}-{name}-{sensors}-sensors-{threads}-threads");
                one_backend(criterion, &group, &mut *backend, &pings, &mut image);
            }
            let group = format!("cpu-{name}-{sensors}-sensors-1-threads");
            criterion.bench_function(&format!("{group}/channels"), |bencher| {
                bencher.iter(|| {
                    for (index, (report, ping)) in image.channels.iter_mut().zip(&pings.pings).enumerate() {
                        report.judge(&plan, index, &ping.samples);
                    }
                });
            });
        }
    }
}

fn one_backend(criterion: &mut Criterion, name: &str, backend: &mut dyn Backend, pings: &PingSet, image: &mut Image) {
    let mut group = criterion.benchmark_group(name);
    group.sample_size(20).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    for stage in Stage::ALL {
        // The backend times its own stages: one stage alone would start from a cache that no ping meets.
        group.bench_function(BenchmarkId::from_parameter(stage.stem()), |bencher| {
            bencher.iter_custom(|iterations| {
                let mut sum = Duration::ZERO;
                for _ in 0..iterations {
                    backend.image(pings, image).unwrap();
                    sum += Duration::from_nanos(backend.stage_times_ns()[stage as usize].max(1));
                }
                sum
            });
        });
    }
    group.bench_function(BenchmarkId::from_parameter("image"), |bencher| {
        bencher.iter(|| backend.image(pings, image).unwrap());
    });
    group.finish();
}

criterion_group!(benches, stages);
criterion_main!(benches);
