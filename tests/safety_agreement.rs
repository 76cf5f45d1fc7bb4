//! Check 23: GPU and CPU image alike, each as the textbook says, and the robot decides the same with either; an image that is wrong by
//! 1 % is called wrong. Skipped without any adapter, unless `NOCTULE_REQUIRE_GPU=1`.
#![cfg(feature = "gpu")]

mod checks;
mod common;

use checks::{figure, trials};
use common::gpu::gpu;
use common::oracle::{self, Fault};
use common::scenes::{Case, random_masks};
use common::{Random, relative_l2};
use noctule::config::Config;
use noctule::control::Controller;
use noctule::geometry::Pose2;
use noctule::imaging::Imager;
use noctule::imaging::backend::{Backend, BackendKind, Image};
use noctule::imaging::drill::{DeviceFault, Drill};
use noctule::imaging::gpu::GpuBackend;
use noctule::service::pipeline::Pipeline;
use noctule::service::{simulator, wiring};
use noctule::signal::{LayerName, SampleFormat, Velocity};
use noctule::sim::{SimParams, World};
use noctule::time::Stamp;
use std::sync::Arc;

/// Largest relative L2 distance that check 23 allows.
const ALLOWED: f64 = 1e-4;
/// Time enough for a software adapter on a busy machine.
const AMPLE_MS: u64 = 8000;

fn peak_cell(values: &[f64]) -> usize {
    values
        .iter()
        .enumerate()
        .fold((0, f64::MIN), |best, (cell, value)| if *value > best.1 { (cell, *value) } else { best })
        .0
}

fn as_f64(values: &[f32]) -> Vec<f64> {
    values.iter().map(|value| f64::from(*value)).collect()
}

/// What is wrong with an image, judged by the truth.
fn disagreement(found: &[f32], truth: &[f64]) -> (f64, bool) {
    (relative_l2(found, truth), peak_cell(&as_f64(found)) != peak_cell(truth))
}

#[test]
fn gpu_and_cpu_agree_with_the_textbook_to_1e_4_and_on_the_strongest_cell_in_200_random_scenes() {
    if !gpu() {
        return;
    }
    let count = trials(200, 8);
    let formats = [SampleFormat::PcmF32, SampleFormat::PcmI16, SampleFormat::PcmF32, SampleFormat::Pdm];
    let cases = formats.map(|format| Case::standard("agreement", format, 1, 30));
    let mut rigs: Vec<(GpuBackend, Imager, Image)> = cases
        .iter()
        .map(|case| {
            let (plan, masks) = (case.plan(), random_masks(&case.plan(), 7));
            let gpu = GpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), true, AMPLE_MS).unwrap();
            let cpu = Imager::with_backends(Arc::clone(&plan), Arc::clone(&masks), None, Some(2), "").unwrap();
            let image = Image::empty(&plan, &masks);
            (gpu, cpu, image)
        })
        .collect();
    let mut worst: f64 = 0.0;
    for trial in 0..count {
        let case = &cases[trial % 4];
        let (gpu, cpu, image) = &mut rigs[trial % 4];
        let plan = Arc::clone(cpu.plan());
        let pings = case.random_pings(2300 + trial as u64);
        let by_cpu = cpu.image(&pings).unwrap();
        image.channels.clone_from(&by_cpu.channels);
        gpu.image(&pings, image).unwrap();
        let samples = oracle::demodulate(&plan, case.arrays[0].len(), &pings.pings[0].samples);
        let directions: Vec<usize> = (0..case.directions.len()).collect();
        let gains = &by_cpu.channels[0].gains;
        let truth = oracle::energyscape(case, &plan, 0, &samples, gains, &directions, Fault::None);
        let of_cpu = as_f64(&by_cpu.energyscapes[0].values);
        for (who, values, truth) in [
            ("cpu and textbook", &by_cpu.energyscapes[0].values, &truth),
            ("gpu and textbook", &image.energyscapes[0].values, &truth),
            ("gpu and cpu", &image.energyscapes[0].values, &of_cpu),
        ] {
            let (distance, elsewhere) = disagreement(values, truth);
            worst = worst.max(distance);
            assert!(
                distance <= ALLOWED && !elsewhere,
                "scene {trial}, {who}: {distance:.1e}, peak elsewhere: {elsewhere}"
            );
        }
        // Negative control: 1 % more energy, and the strongest cell a row further.
        let more: Vec<f32> = image.energyscapes[0].values.iter().map(|value| value * 1.01).collect();
        assert!(disagreement(&more, &of_cpu).0 > ALLOWED);
        let mut moved = image.energyscapes[0].values.clone();
        moved.rotate_right(plan.grid.range_count());
        assert!(disagreement(&moved, &of_cpu).1);
    }
    figure(23, "largest relative L2 distance of GPU, CPU and textbook", format!("{worst:.1e}"), "<= 1e-4", count);
}

/// A pipeline of the default robot whose images come from `backend`, or from the CPU.
fn pipeline(config: &Config, open: impl FnOnce(&wiring::SensingSetup) -> Option<Box<dyn Backend>>) -> Pipeline {
    let setup = wiring::sensing(config).unwrap();
    let masks = wiring::masks(config, &setup).unwrap();
    let gpu = open(&setup);
    let imager =
        Imager::with_backends(Arc::clone(&setup.plan), Arc::clone(masks.table()), gpu, Some(2), "the reference")
            .unwrap();
    Pipeline::new(config, setup, masks, imager, 1, Stamp::default())
}

fn lavapipe(config: &Config, setup: &wiring::SensingSetup) -> Box<dyn Backend> {
    let masks = wiring::masks(config, setup).unwrap();
    Box::new(GpuBackend::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), true, AMPLE_MS).unwrap())
}

/// How often two robots with the same ears decided otherwise, and how often one would go on where the other avoids a collision.
#[derive(Debug, Default, PartialEq, Eq)]
struct Disagreements {
    scenes: usize,
    collisions: usize,
    layers: usize,
    velocities: usize,
    unsafe_ones: usize,
    /// The first one, in words.
    first: Option<String>,
}

/// Puts the robot of both pipelines at random places of the default world and lets both decide.
fn compare(config: &Config, reference: &mut Pipeline, other: &mut Pipeline, count: usize, seed: u64) -> Disagreements {
    let world = World::default_world().unwrap();
    let setup = reference.setup().clone();
    let mut simulator = simulator(config, &setup, world, SimParams::default(), seed).unwrap();
    let mut pings = simulator.empty_ping_set();
    let (mut random, mut found) = (Random(seed), Disagreements::default());
    let mut now = Stamp { boottime_ns: 1_000_000_000, wall_ns: 0 };
    while found.scenes < count {
        simulator.set_pose(Pose2 {
            x_m: random.uniform(0.3, 9.7),
            y_m: random.uniform(0.3, 7.7),
            heading_rad: random.uniform(-3.1, 3.1),
        });
        if simulator.clearance_m() < 0.01 {
            continue;
        }
        found.scenes += 1;
        now = now.plus_ns(100_000_000);
        simulator.ping_set(now, &mut pings);
        let decided_at = now.plus_ns(50_000_000);
        let wanted = Velocity::forward_m_s(0.3);
        // Every scene with a controller that has just begun. One that remembers places it was carried away from tells, after a
        // hundred scenes, of a rounding a hundred scenes ago, and not of what the two backends hear now.
        let decide = |pipeline: &mut Pipeline| {
            let cues = pipeline.process(decided_at, &mut pings.clone(), wanted, None).unwrap().cues;
            Controller::new(&config.control, &config.platform).step(decided_at, &cues, wanted)
        };
        let (a, b) = (decide(reference), decide(other));
        let avoids = |layer| layer == LayerName::CollisionAvoidance;
        found.collisions += usize::from(avoids(a.layer));
        found.layers += usize::from(a.layer != b.layer);
        found.unsafe_ones += usize::from(avoids(a.layer) && !avoids(b.layer));
        let apart = (a.velocity.linear_m_s - b.velocity.linear_m_s).abs()
            + (a.velocity.angular_rad_s - b.velocity.angular_rad_s).abs();
        found.velocities += usize::from(!(apart <= 1e-3));
        if (a.layer != b.layer || !(apart <= 1e-3)) && found.first.is_none() {
            found.first = Some(format!("scene {}: {a:?} {b:?}", found.scenes));
        }
    }
    found
}

#[test]
fn the_same_layer_decides_with_either_backend_and_never_is_a_collision_missed() {
    if !gpu() {
        return;
    }
    let mut config = Config::default();
    config.recording.format = SampleFormat::PcmF32;
    let count = trials(200, 24);
    let mut reference = pipeline(&config, |_| None);
    let mut other = pipeline(&config, |setup| Some(lavapipe(&config, setup)));
    let found = compare(&config, &mut reference, &mut other, count, 23);
    assert_eq!(other.image().backend, BackendKind::Gpu, "the GPU imaged to the end");
    assert_eq!(other.imager().redone_count(), 0);
    figure(23, "scenes in which another layer decided", found.layers, "0", count);
    figure(23, "collisions that only the CPU saw", found.unsafe_ones, "0", count);
    assert!(found.collisions > count / 20 && found.collisions < count, "{found:?}: scenes of both kinds are needed");
    assert_eq!((found.layers, found.unsafe_ones, found.velocities), (0, 0, 0), "{found:?}");
    // Negative control: a GPU that hears a tenth of what there is passes every check of form and decides otherwise.
    let mut reference = pipeline(&config, |_| None);
    let mut deaf = pipeline(&config, |setup| {
        let masks = wiring::masks(&config, setup).unwrap();
        let cpu = noctule::imaging::cpu::CpuBackend::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), Some(2));
        Some(Box::new(Drill::new(Box::new(cpu.unwrap()), Box::new(|_| Some(DeviceFault::TooLarge(-0.9))))))
    });
    let found = compare(&config, &mut reference, &mut deaf, 40, 23);
    assert!(found.layers > 0 && found.unsafe_ones > 0, "{found:?}");
}
