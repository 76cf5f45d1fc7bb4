//! What only shows from inside: work that the device skipped must not pass for a result.
//! A missing adapter skips these tests unless `NOCTULE_REQUIRE_GPU=1`.

#[path = "../../../tests/common/validation.rs"]
mod validation;

use super::*;
use crate::imaging::params::ImagingParams;
use crate::sensor::{Emission, MicrophoneArray, Mount, RecordingFormat, SensorSetup};
use crate::signal::{Direction, LayerName, MaskPurpose, MaskRow, SampleFormat};
use nalgebra::Vector3;

/// Two sensors of four microphones, four directions, one region on each sensor.
fn small() -> (Arc<ImagingPlan>, Arc<MaskTable>) {
    let samples = (0..500).map(|n| (0.6 * f64::from(n) + 4e-4 * f64::from(n).powi(2)).sin()).collect();
    let emission = Arc::new(Emission { samples, sample_rate_hz: 250e3, band_hz: (25e3, 40e3) });
    let place = |index: u32| Vector3::new(0.0, 0.004 * f64::from(index), 0.003 * f64::from(index % 2));
    let array =
        MicrophoneArray { positions_m: (0..4).map(place).collect(), enabled: vec![true; 4], weights: vec![1.0; 4] };
    let sensor = |name: &str| SensorSetup {
        name: name.to_owned(),
        mount: Mount::default(),
        array: array.clone(),
        emission: Arc::clone(&emission),
        emitter_m: Vector3::zeros(),
    };
    let recording =
        RecordingFormat { format: SampleFormat::PcmF32, sample_rate_hz: 250e3, samples: 3000, decimation: 1 };
    let params = ImagingParams { range_max_m: 1.5, ..ImagingParams::default() };
    let directions = [-1.0, -0.3, 0.3, 1.0].map(Direction::horizontal).to_vec();
    let hidden = vec![vec![false; 4]; 2];
    let plan = ImagingPlan::new(&[sensor("a"), sensor("b")], &hidden, &recording, &params, directions, 343.0).unwrap();
    let count = plan.grid.cell_count() as u32;
    let row = |sensor_index| MaskRow {
        purpose: MaskPurpose::Region(LayerName::CollisionAvoidance),
        sensor_index,
        first: 0,
        count: count as usize,
    };
    let masks = MaskTable {
        rows: vec![row(0), row(1)],
        cells: (0..count).collect(),
        sides: vec![1.0; count as usize],
        distances_m: vec![0.5; count as usize],
        gains: Vec::new(),
        floors: Vec::new(),
    };
    (Arc::new(plan), Arc::new(masks))
}

/// An open backend with a ping set of noise and an image, or `None` where there is no adapter and none is required.
fn opened() -> Option<(GpuBackend, PingSet, Image)> {
    validation::watch();
    if adapters().is_empty() {
        assert!(std::env::var("NOCTULE_REQUIRE_GPU").is_err(), "NOCTULE_REQUIRE_GPU is set, but there is no adapter");
        return None;
    }
    let (plan, masks) = small();
    let backend = GpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), true, 8000).unwrap();
    let mut pings = PingSet::empty(2, SampleFormat::PcmF32, &[plan.raw_len(0), plan.raw_len(1)]);
    pings.present = [true, true, false];
    for ping in &mut pings.pings {
        let Samples::PcmF32(values) = ping.samples_mut() else { unreachable!() };
        values.iter_mut().enumerate().for_each(|(index, value)| *value = (index as f32 * 0.7).sin() * 0.1);
    }
    let image = Image::empty(&plan, &masks);
    Some((backend, pings, image))
}

#[test]
fn a_skipped_write_of_the_image_or_of_the_sums_is_noticed() {
    let Some((mut backend, pings, mut image)) = opened() else { return };
    backend.image(&pings, &mut image).unwrap();
    let kernel = |backend: &GpuBackend, stage| backend.program.steps.iter().rposition(|step| step.stage == stage);
    for stage in [Stage::Envelope, Stage::MaskedEnergy] {
        let index = kernel(&backend, stage).unwrap();
        let step = backend.program.steps.remove(index);
        let error = backend.image(&pings, &mut image).unwrap_err();
        assert!(matches!(error, BackendError::Invalid(_)), "{stage:?}: {error}");
        backend.program.steps.insert(index, step);
        backend.image(&pings, &mut image).unwrap();
    }
}

/// A device may hand out memory that was cleared: what stands in the result before must not matter.
#[test]
fn work_left_out_never_passes_whether_the_result_held_poison_or_zeros_before() {
    let Some((mut backend, mut pings, mut image)) = opened() else { return };
    for poison in [readback::POISON, 0] {
        let words = vec![poison; backend.poison.size() as usize / 4];
        backend.gpu.queue.write_buffer(&backend.poison, 0, bytemuck::cast_slice(&words));
        for stage in [Stage::Envelope, Stage::MaskedEnergy] {
            let index = backend.program.steps.iter().rposition(|step| step.stage == stage).unwrap();
            let step = backend.program.steps.remove(index);
            pings.sequence += 1;
            let imaged = backend.image(&pings, &mut image);
            let error = imaged.and_then(|()| crate::imaging::guard::check(&pings, &image)).unwrap_err().to_string();
            let seen = ["never written", "bears the mark", "all zeros"].iter().any(|words| error.contains(words));
            assert!(seen, "{stage:?} left out, {poison:#x} before: {error}");
            backend.program.steps.insert(index, step);
        }
        pings.sequence += 1;
        backend.image(&pings, &mut image).unwrap();
        crate::imaging::guard::check(&pings, &image).unwrap();
    }
}

#[test]
fn an_old_result_does_not_pass_for_a_new_one() {
    let Some((mut backend, mut pings, mut image)) = opened() else { return };
    backend.image(&pings, &mut image).unwrap();
    // Negative control: the result just made is good under its own nonce, and only under that.
    pings.sequence += 1;
    backend.nonce[0] += 1;
    backend.staging.request();
    backend.staging.wait(&backend.gpu, Instant::now(), SLOW_LIMIT).unwrap();
    let error = backend.take_result(&pings, pings.present, &mut image).unwrap_err();
    assert!(error.to_string().contains("bears the mark"), "{error}");
    backend.nonce[0] -= 1;
    backend.staging.request();
    backend.staging.wait(&backend.gpu, Instant::now(), SLOW_LIMIT).unwrap();
    backend.take_result(&pings, pings.present, &mut image).unwrap();
}

#[test]
fn two_devices_never_share_an_epoch() {
    let Some((first, _, _)) = opened() else { return };
    let Some((second, _, _)) = opened() else { return };
    assert_ne!(first.nonce[2], second.nonce[2]);
}

#[test]
fn a_validation_error_is_an_error_and_the_next_ping_set_is_imaged() {
    let Some((mut backend, pings, mut image)) = opened() else { return };
    // A write beyond the end of a buffer: wgpu's default handler would panic.
    backend.gpu.queue.write_buffer(&backend.program.params, 1 << 20, &[0; 16]);
    let error = backend.image(&pings, &mut image).unwrap_err();
    assert!(matches!(error, BackendError::Invalid(_)), "{error}");
    backend.image(&pings, &mut image).unwrap();
}

#[test]
fn a_ping_set_given_up_is_drained_before_the_next() {
    let Some((mut backend, pings, mut image)) = opened() else { return };
    backend.limit = Duration::ZERO;
    let error = backend.image(&pings, &mut image).unwrap_err();
    assert!(matches!(error, BackendError::Timeout { limit_ms: 0 }), "{error}");
    assert!(backend.staging.is_pending());
    backend.limit = Duration::from_secs(8);
    backend.image(&pings, &mut image).unwrap();
    assert!(image.sums[0].energy > 0.0);
}

/// The small plan cut into tiles of one quad of beams; its image equals the uncut one. The faults that a cut can have show.
#[test]
fn a_tile_that_is_left_out_or_goes_to_the_wrong_place_is_noticed() {
    let Some((mut whole, pings, mut truth)) = opened() else { return };
    whole.image(&pings, &mut truth).unwrap();
    let (plan, masks) = small();
    // The samples of both sensors are the largest thing that cannot be cut; one by one they leave room for a few rows.
    let least = Blueprint::new(&plan, &masks, 1 << 20).map(|blueprint| blueprint.bytes(Resource::Pcm) / 2).unwrap();
    let mut tiled = GpuBackend::open_within(plan, masks, true, 8000, least).unwrap();
    assert_eq!(tiled.bank_count(), 2);
    let mut image = truth.clone();
    tiled.image(&pings, &mut image).unwrap();
    assert_eq!(image.energyscapes, truth.energyscapes);
    assert_eq!(image.sums, truth.sums);

    let last = tiled.program.steps.iter().rposition(|step| step.stage == Stage::Envelope).unwrap();
    let step = tiled.program.steps.remove(last);
    let error = tiled.image(&pings, &mut image).unwrap_err();
    assert!(error.to_string().contains("never written"), "{error}");
    tiled.program.steps.insert(last, step);

    // The second bank's sums made from the first one's sensor.
    let bank = tiled.program.steps.iter().rposition(|step| step.stage == Stage::MaskedEnergy).unwrap();
    let step = tiled.program.steps.remove(bank);
    assert!(tiled.image(&pings, &mut image).is_err());
    tiled.program.steps.insert(bank, step);

    // Rows of the last tile turned round: every value is a good one, in a wrong direction.
    let targets = tiled.program.targets.len();
    let turned: Vec<[u32; 2]> = tiled.program.targets.iter().rev().copied().collect();
    assert!(targets == 8 && turned != tiled.program.targets);
    tiled.gpu.queue.write_buffer(tiled.program.buffer(Resource::Targets), 0, bytemuck::cast_slice(&turned));
    tiled.image(&pings, &mut image).unwrap();
    assert_ne!(image.energyscapes, truth.energyscapes);
}
