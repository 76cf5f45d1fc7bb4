//! Contract: each sensor's image is made with what that sensor sends, on every backend as the float64 textbook has it: sweeps in
//! opposite directions, parts of the band, other durations, in every raw format. Another's reference must turn it red.

mod common;

use common::backends::{backends, bearings, image_with_gains, pcm, range};
use common::oracle::{self, Fault};
use common::scenes::{Case, EMITTER_M, Echo, SPEED_OF_SOUND_M_S, Sweep, ping_set, random_array, random_masks};
use common::{Random, relative_l2};
use noctule::imaging::params::{Apodization, Beamformer, ImagingParams, Weighting};
use noctule::imaging::plan::ImagingPlan;
use noctule::sensor::{RecordingFormat, SensorSetup};
use noctule::signal::{Direction, PingSet, SampleFormat};
use std::sync::Arc;

/// Measured over all cases and backends: 5e-7 to 2.8e-6, the most with PHAT; with one emission for all 3e-7 to 1.3e-6
/// (tests/imaging_conformance.rs).
const BOUND: f64 = 1e-5;

/// One scene: the same sensors and grid, each sensor with a sweep of its own. The textbook is asked sensor by sensor.
struct Mixed {
    name: &'static str,
    cases: Vec<Case>,
}

impl Mixed {
    fn new(name: &'static str, common: &Case, sweeps: &[Sweep]) -> Self {
        let cases = sweeps.iter().map(|sweep| Case { sweep: *sweep, ..common.clone() }).collect();
        Self { name, cases }
    }

    fn sensors(&self) -> Vec<SensorSetup> {
        self.cases.iter().enumerate().map(|(index, case)| case.sensors()[index].clone()).collect()
    }

    fn plan_of(&self, sensors: &[SensorSetup]) -> Arc<ImagingPlan> {
        let case = &self.cases[0];
        let (recording, directions) = (&case.recording, case.directions.clone());
        let plan = ImagingPlan::new(sensors, &case.hidden, recording, &case.params, directions, SPEED_OF_SOUND_M_S);
        Arc::new(plan.unwrap_or_else(|error| panic!("{}: {error}", self.name)))
    }

    fn plan(&self) -> Arc<ImagingPlan> {
        self.plan_of(&self.sensors())
    }

    /// Random echoes of each sensor's own sweep, and of every other sensor's as they would come across.
    fn pings(&self, seed: u64) -> PingSet {
        let mut random = Random(seed);
        let samples = self.cases.iter().enumerate().map(|(sensor, case)| {
            let echoes = case.random_echoes(&mut random);
            case.samples(sensor, &echoes, &mut random)
        });
        ping_set(seed, samples.collect())
    }

    /// What the textbook makes of a sensor's ping with the sweep of sensor `reference`.
    fn truth(&self, plan: &ImagingPlan, pings: &PingSet, sensor: usize, reference: usize, gains: &[f32]) -> Vec<f64> {
        let case = &self.cases[reference];
        let samples = oracle::demodulate(plan, case.arrays[sensor].len(), &pings.pings[sensor].samples);
        let directions: Vec<usize> = (0..case.directions.len()).collect();
        oracle::energyscape(case, plan, sensor, &samples, gains, &directions, Fault::None)
    }
}

fn scenes() -> Vec<Mixed> {
    let down = Sweep::new(50e3, 25e3, 450e3);
    let up = Sweep::new(25e3, 50e3, 450e3);
    let third = |start_hz: f64, end_hz: f64, rate_hz: f64| Sweep::new(start_hz, end_hz, rate_hz);
    let thirds = |rate_hz| [third(60e3, 48e3, rate_hz), third(48e3, 36e3, rate_hz), third(36e3, 24e3, rate_hz)];
    let mut scenes =
        vec![Mixed::new("down, up, down", &Case::standard("", SampleFormat::PcmF32, 3, 12), &[down, up, down])];
    let pdm = RecordingFormat { format: SampleFormat::Pdm, sample_rate_hz: 3.6e6, samples: 45_000, decimation: 9 };
    let arrays = vec![random_array(5, 0.05, true, 8), random_array(7, 0.06, true, 9), random_array(5, 0.05, true, 8)];
    let mut common = Case::new("", arrays.clone(), down, pdm, bearings(7));
    common.params = range(0.25, 1.6, None);
    scenes.push(Mixed::new("thirds of the band, pdm", &common, &thirds(400e3)));

    let mut common = Case::new("", arrays.clone(), down, pcm(250e3, 5001), bearings(9));
    common.params = ImagingParams { apodization: Apodization::LowSideLobes, ..range(0.3, 2.5, Some(0.011)) };
    common.hidden[1][4] = true;
    let short = Sweep { duration_s: 0.8e-3, ..Sweep::new(30e3, 55e3, 250e3) };
    let long = Sweep { duration_s: 3.1e-3, taper: 0.25, ..Sweep::new(45e3, 20e3, 250e3) };
    scenes.push(Mixed::new(
        "other durations, overlapping bands",
        &common,
        &[short, long, Sweep::new(50e3, 25e3, 250e3)],
    ));

    let mut common = Case::new("", arrays, down, pcm(250e3, 4000), bearings(8));
    common.params = ImagingParams { weighting: Weighting::Phat, ..range(0.3, 2.0, None) };
    scenes.push(Mixed::new("phat, thirds of the band", &common, &thirds(250e3)));
    scenes
}

#[test]
fn energyscapes_of_mixed_emissions_equal_the_textbook_and_need_each_sensors_own_reference() {
    for (index, scene) in scenes().into_iter().enumerate() {
        let plan = scene.plan();
        let masks = random_masks(&plan, 7);
        let pings = scene.pings(500 + index as u64);
        let mut image = image_with_gains(&plan, &masks, &[]);
        let gains: Vec<Vec<f32>> = image.channels.iter().map(|report| report.gains.clone()).collect();
        let truth = |sensor: usize, reference: usize| scene.truth(&plan, &pings, sensor, reference, &gains[sensor]);
        for (name, open) in backends() {
            open(Arc::clone(&plan), Arc::clone(&masks)).image(&pings, &mut image).unwrap();
            for (sensor, energyscape) in image.energyscapes.iter().enumerate() {
                let error = relative_l2(&energyscape.values, &truth(sensor, sensor));
                println!("{name}: {}, sensor {sensor}: {error:.2e}", scene.name);
                assert!(error < BOUND, "{name}: {}, sensor {sensor}: {error:e}", scene.name);
            }
            // Negative control: measured 0.9 and more.
            let exchanged = relative_l2(&image.energyscapes[0].values, &truth(0, 1));
            assert!(exchanged > 0.3, "{name}: {}: another's sweep passes: {exchanged:e}", scene.name);
        }
    }
}

#[test]
fn the_beamformers_that_take_cells_one_by_one_agree_between_the_backends_on_parts_of_the_band() {
    let arrays = vec![random_array(9, 0.05, true, 3); 2];
    let sweeps = [Sweep::new(50e3, 38e3, 250e3), Sweep::new(38e3, 26e3, 250e3)];
    for beamformer in [Beamformer::DelayMultiplyAndSum, Beamformer::MinimumVariance] {
        let mut common = Case::new("", arrays.clone(), sweeps[0], pcm(250e3, 3000), bearings(7));
        common.params = ImagingParams { beamformer, ..range(0.3, 1.2, None) };
        let scene = Mixed::new("parts of the band", &common, &sweeps);
        let plan = scene.plan();
        let masks = random_masks(&plan, 7);
        let pings = scene.pings(9);
        let mut image = image_with_gains(&plan, &masks, &[]);
        let mut first: Option<Vec<Vec<f64>>> = None;
        for (name, open) in backends() {
            open(Arc::clone(&plan), Arc::clone(&masks)).image(&pings, &mut image).unwrap();
            let found: Vec<Vec<f32>> = image.energyscapes.iter().map(|scape| scape.values.clone()).collect();
            assert!(found.iter().flatten().all(|value| value.is_finite()), "{name}: {beamformer:?}");
            assert!(found.iter().all(|values| values.iter().any(|value| *value > 1e-3)), "{name}: silence");
            let truth = first.get_or_insert_with(|| {
                found.iter().map(|values| values.iter().map(|value| f64::from(*value)).collect()).collect()
            });
            for (values, truth) in found.iter().zip(truth) {
                let error = relative_l2(values, truth);
                // What minimum variance is held to elsewhere (tests/imaging_focus.rs).
                assert!(error < 1e-4, "{name}: {beamformer:?}: {error:e}");
            }
        }
    }
}

/// An echo of the sensor's own sweep stands at its place with its amplitude; the same echo of another's sweep does not.
#[test]
fn an_echo_of_ones_own_sweep_is_seen_and_that_of_anothers_is_not() {
    let mut common = Case::standard("", SampleFormat::PcmF32, 2, 4);
    (common.noise, common.tone) = (0.0, 0.0);
    common.params = range(0.5, 3.0, None);
    let pairs = [
        // By correlation in float64 16.0 dB for sweeps of one band in opposite directions, 30.9 dB for halves that touch (their
        // passbands' edges overlap); the image looks for the leak in every direction and finds up to 1.2 dB more of it.
        ("opposite", [Sweep::new(50e3, 25e3, 450e3), Sweep::new(25e3, 50e3, 450e3)], 14.0),
        ("halves", [Sweep::new(50e3, 37.5e3, 450e3), Sweep::new(37.5e3, 25e3, 450e3)], 28.0),
    ];
    for (name, sweeps, least_db) in pairs {
        let scene = Mixed::new("rejection", &common, &sweeps);
        let plan = scene.plan();
        let masks = random_masks(&plan, 7);
        let ahead = Direction::horizontal((-1.5_f64).to_radians());
        let mut image = image_with_gains(&plan, &masks, &[]);
        for (backend, open) in backends() {
            let mut backend_open = open(Arc::clone(&plan), Arc::clone(&masks));
            let mut peak_of = |sent: usize| {
                let echo = [Echo::of_point(0.1, 1.5, ahead)];
                let samples = scene.cases[sent].samples(0, &echo, &mut Random(1));
                let silence = scene.cases[1].samples(1, &[], &mut Random(1));
                backend_open.image(&ping_set(1, vec![samples, silence]), &mut image).unwrap();
                let (cell, peak) = image.energyscapes[0].peak();
                let (_, range) = plan.grid.direction_and_range(cell);
                (f64::from(peak), plan.grid.range_m(range))
            };
            let (own, range_m) = peak_of(0);
            let (foreign, _) = peak_of(1);
            let rejection_db = 20.0 * (own / foreign).log10();
            println!("{backend}: {name}: own {own:.4} at {range_m:.3} m, another's {rejection_db:.1} dB below");
            // Between two bins of 5 mm an echo 10.8 mm wide reads 0.6 dB low.
            assert!((own / 0.1 - 1.0).abs() < 0.08 && (range_m - 1.5).abs() < 0.01, "{own} at {range_m}");
            assert!(rejection_db > least_db, "{backend}: {name}: {rejection_db}");
        }
    }
    assert!(EMITTER_M.norm() < 0.1, "the scene's emitter is at the sensor");
}

#[test]
fn sensors_with_equal_emissions_share_a_reference_and_the_band_holds_all_sweeps() {
    let scene = &scenes()[0];
    let plan = scene.plan();
    assert!(Arc::ptr_eq(&plan.sensors[0].reference, &plan.sensors[2].reference));
    assert!(!Arc::ptr_eq(&plan.sensors[0].reference, &plan.sensors[1].reference));
    // A sweep the other way fills the same band: the plan is that of one emission for all.
    let same = scene.plan_of(&vec![scene.sensors()[0].clone(); 3]);
    assert_eq!((plan.first_bin, plan.bin_count, &plan.band_taps), (same.first_bin, same.bin_count, &same.band_taps));
    assert_eq!(plan.sensors[0].reference, same.sensors[0].reference);
    let thirds = &scenes()[1];
    let plan = thirds.plan();
    for (index, sensor) in plan.sensors.iter().enumerate() {
        let energy = |from_hz: f64, to_hz: f64| -> f64 {
            let bins = sensor.reference.iter().enumerate().filter(|(bin, _)| {
                let frequency_hz = (plan.first_bin + bin) as f64 * plan.bin_step_hz;
                (from_hz..to_hz).contains(&frequency_hz)
            });
            bins.map(|(_, value)| f64::from(value[0]).hypot(f64::from(value[1])).powi(2)).sum()
        };
        let top_hz = 60e3 - 12e3 * index as f64;
        let (inside, all) = (energy(top_hz - 13.2e3, top_hz + 1.2e3), energy(0.0, 1e6));
        assert_eq!(inside, all, "sensor {index}: nothing outside its own part and its edges");
        assert!(all > 0.0);
    }
}
