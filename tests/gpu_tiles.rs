//! Work that no single binding holds is cut into banks of sensors and tiles of directions, and nobody sees it in the image.
//! A small limit is injected, so that a small grid is cut as 4,000 directions of three sensors are under WebGPU's own.
#![cfg(feature = "gpu")]

mod common;

use common::gpu::gpu;
use common::relative_l2;
use common::scenes::{Case, Sweep, random_array, random_masks};
use noctule::imaging::AGREEMENT_MAX;
use noctule::imaging::backend::{Backend, BackendError, Image, Stage, StageOutput};
use noctule::imaging::cpu::CpuBackend;
use noctule::imaging::gpu::GpuBackend;
use noctule::imaging::params::ImagingParams;
use noctule::imaging::plan::ImagingPlan;
use noctule::sensor::RecordingFormat;
use noctule::signal::{Direction, MaskTable, SampleFormat};
use std::sync::Arc;

/// Three sensors, two of them with the same array; directions with and without a mirror image; some hidden.
fn case(smoothed: bool) -> Case {
    let shared = random_array(12, 0.06, true, 3);
    let arrays = vec![shared.clone(), random_array(9, 0.05, false, 4), shared];
    let recording =
        RecordingFormat { format: SampleFormat::PcmF32, sample_rate_hz: 250e3, samples: 4000, decimation: 1 };
    let direction =
        |i: u32| Direction { azimuth_rad: -1.4 + 0.04 * f64::from(i % 71), elevation_rad: 0.3 * f64::from(i / 71) };
    let directions: Vec<Direction> = (0..142).map(direction).collect();
    let mut case = Case::new("tiles", arrays, Sweep::new(50e3, 25e3, 250e3), recording, directions);
    case.params = ImagingParams { range_min_m: 0.3, range_max_m: 2.0, ..ImagingParams::default() };
    case.params.smoothing_hz = smoothed.then_some(2000.0);
    case.hidden[0][5] = true;
    case.hidden[2][140] = true;
    case
}

fn cut(plan: &Arc<ImagingPlan>, masks: &Arc<MaskTable>, binding_bytes: u64) -> Result<GpuBackend, BackendError> {
    GpuBackend::open_within(Arc::clone(plan), Arc::clone(masks), true, 8000, binding_bytes)
}

fn doubles(values: &[f32]) -> Vec<f64> {
    values.iter().map(|value| f64::from(*value)).collect()
}

/// Distance of the worst sensor from the CPU backend.
fn distance(case: &Case, backend: &mut GpuBackend, plan: &Arc<ImagingPlan>, masks: &Arc<MaskTable>) -> f64 {
    let pings = case.random_pings(9);
    let (mut image, mut truth) = (Image::empty(plan, masks), Image::empty(plan, masks));
    backend.image(&pings, &mut image).unwrap();
    let mut cpu = CpuBackend::open(Arc::clone(plan), Arc::clone(masks), Some(1)).unwrap();
    cpu.image(&pings, &mut truth).unwrap();
    for (found, wanted) in image.sums.iter().zip(&truth.sums) {
        assert!((found.energy - wanted.energy).abs() <= 1e-4 * wanted.energy, "{found:?} {wanted:?}");
        assert!((found.peak - wanted.peak).abs() <= 1e-4 * wanted.peak, "{found:?} {wanted:?}");
    }
    let pairs = image.energyscapes.iter().zip(&truth.energyscapes);
    pairs.map(|(found, wanted)| relative_l2(&found.values, &doubles(&wanted.values))).fold(0.0, f64::max)
}

#[test]
fn an_image_that_is_cut_into_tiles_or_banks_equals_the_cpus() {
    if !gpu() {
        return;
    }
    for smoothed in [false, true] {
        let case = case(smoothed);
        let plan = case.plan();
        let masks = random_masks(&plan, 5);
        let image_bytes = 4 * 3 * plan.grid.cell_count() as u64;
        // A megabyte holds what three sensors deliver and their energyscapes, but not all spectra; half the latter needs banks, too.
        assert!(image_bytes < 1 << 20);
        for (binding_bytes, banks) in [(1 << 20, 1), (image_bytes / 2, 3)] {
            let mut backend = cut(&plan, &masks, binding_bytes).unwrap();
            assert_eq!(backend.bank_count(), banks);
            assert!(backend.tile_count() > 2 * banks, "{}", backend.tile_count());
            let distance = distance(&case, &mut backend, &plan, &masks);
            assert!(distance <= AGREEMENT_MAX, "{distance} with {} tiles", backend.tile_count());
        }
        let whole = cut(&plan, &masks, u64::MAX).unwrap();
        assert_eq!((whole.bank_count(), whole.tile_count()), (1, 1));
    }
}

#[test]
fn the_output_of_every_stage_is_the_same_with_and_without_tiles() {
    if !gpu() {
        return;
    }
    let case = case(false);
    let plan = case.plan();
    let masks = random_masks(&plan, 5);
    let pings = case.random_pings(3);
    let mut whole = cut(&plan, &masks, u64::MAX).unwrap();
    let mut tiled = cut(&plan, &masks, 2 * plan.grid.cell_count() as u64 * 4).unwrap();
    assert!(tiled.bank_count() == 3 && tiled.tile_count() > 3);
    let mut image = Image::empty(&plan, &masks);
    for stage in Stage::ALL {
        for sensor in 0..3 {
            let wanted = whole.image_up_to(stage, &pings, sensor, &mut image).unwrap();
            let found = tiled.image_up_to(stage, &pings, sensor, &mut image).unwrap();
            assert!(wanted != StageOutput::Real(vec![0.0]));
            assert!(found == wanted, "{} of sensor {sensor}", stage.stem());
        }
    }
}

#[test]
fn a_binding_that_cannot_be_cut_is_refused_in_words() {
    let case = case(false);
    let plan = case.plan();
    let masks = random_masks(&plan, 5);
    let error = cut(&plan, &masks, 1 << 16).unwrap_err();
    assert!(matches!(&error, BackendError::Unavailable(text) if text.contains("65536 are allowed")), "{error}");
}

/// 4,000 directions by 2,064 ranges of three sensors: in tiles under the limit that every WebGPU device has.
fn largest_grid() -> Case {
    let mut case = Case::standard("4,000 directions", SampleFormat::PcmF32, 3, 1);
    let direction = |i: u32| Direction {
        azimuth_rad: -1.5 + 0.0375 * f64::from(i % 80),
        elevation_rad: -0.6 + 0.025 * f64::from(i / 80),
    };
    case.directions = (0..4000).map(direction).collect();
    case.hidden = vec![vec![false; 4000]; 3];
    case.params = ImagingParams { range_min_m: 0.3, range_max_m: 5.42, range_step_m: Some(0.0025), ..case.params };
    case
}

/// The sizes that the specification names, without the work.
#[test]
fn the_largest_grids_and_arrays_fit_the_limits_of_every_webgpu_device() {
    let mut many = Case::standard("256 microphones", SampleFormat::PcmF32, 3, 1);
    many.arrays = vec![random_array(256, 0.2, true, 8); 3];
    // Counted 180 MB with tiles of 32 MiB, 99 MB of it energyscapes; and 155 MB, two thirds of it samples; so wide an array is focused at every range.
    for (case, most_bytes, cut) in [(largest_grid(), 185_000_000, true), (many, 160_000_000, false)] {
        let plan = case.plan();
        let masks = random_masks(&plan, 5);
        let memory = noctule::imaging::gpu::memory(&plan, &masks).unwrap();
        assert!(memory.largest_binding_bytes <= 128 << 20, "{}: {memory:?}", case.name);
        assert!(memory.buffer_bytes <= most_bytes, "{}: {memory:?}", case.name);
        assert_eq!(memory.tile_count > 1, cut, "{}: {memory:?}", case.name);
    }
}

/// Takes seconds on a software adapter: with `NOCTULE_FULL=1` only.
#[test]
fn the_largest_grid_equals_the_cpus() {
    if std::env::var_os("NOCTULE_FULL").is_none() || !gpu() {
        return;
    }
    let case = largest_grid();
    let plan = case.plan();
    let masks = random_masks(&plan, 5);
    let mut backend = GpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), true, 120_000).unwrap();
    let distance = distance(&case, &mut backend, &plan, &masks);
    println!("{distance:.2e} from the CPU; {} tiles, {} bytes", backend.tile_count(), backend.buffer_bytes());
    assert!(distance <= AGREEMENT_MAX, "{distance}");
}
