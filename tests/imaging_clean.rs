//! CLEAN takes echoes out with their side lobes and puts them back without, on every backend alike: what is loud stays where it is and as
//! loud, what was hidden beside it is seen, what is hidden by the robot stays hidden. The scenes are made by closed forms.

mod common;

use common::backends::{backends, cpu, image_with_gains, pcm};
use common::peaks::{imager, peak, quiet, reflector};
use common::scenes::{Case, Echo, Sweep, ping_set, random_array, random_masks};
use common::{Random, relative_l2};
use noctule::imaging::backend::Image;
use noctule::imaging::cpu::InstructionSet;
use noctule::signal::{Direction, Energyscape, SampleFormat};
use std::sync::Arc;

/// What the specification allows between the backends.
const ALLOWED: f64 = 1e-4;
/// Measured 1.3e-6.
const TWIN_BOUND: f64 = 1e-5;

fn cleaned(mut case: Case, rounds: usize) -> Case {
    case.params.clean_rounds = Some(rounds).filter(|rounds| *rounds > 0);
    case
}

/// Half the main lobe, as the sine of the bearing: it is as wide for every bearing.
const LOBE_SINE: f64 = 0.3;

/// Loudest cell farther from the echoes than their main lobes are wide, in decibels against `amplitude`.
fn beyond_db(image: &Energyscape, places: &[(f64, f64)], amplitude: f64) -> f64 {
    let grid = &image.grid;
    let away = |cell: &usize| {
        let (direction, range) = grid.direction_and_range(*cell);
        let sine = grid.directions()[direction].azimuth_rad.sin();
        let apart = |deg: &f64| (sine - deg.to_radians().sin()).abs() > LOBE_SINE;
        places.iter().all(|(range_m, deg)| apart(deg) || (grid.range_m(range) - range_m).abs() > 0.06)
    };
    let loudest = (0..grid.cell_count()).filter(away).map(|cell| image.values[cell]).fold(0.0, f32::max);
    20.0 * (f64::from(loudest) / amplitude).log10()
}

fn image_of(case: &Case, echoes: &[Echo]) -> Energyscape {
    let pings = ping_set(1, vec![case.samples(0, echoes, &mut Random(7))]);
    imager(&case.plan()).image(&pings).unwrap().energyscapes[0].clone()
}

#[test]
fn every_backend_takes_out_the_same_echoes() {
    let sweep = Sweep::new(50e3, 25e3, 250e3);
    let arrays = vec![random_array(13, 0.05, true, 6), random_array(9, 0.06, false, 21)];
    let bearings = (0..37).map(|i| Direction::horizontal((-90.0 + 5.0 * f64::from(i)).to_radians())).collect();
    let mut case = Case::new("clean", arrays, sweep, pcm(250e3, 5001), bearings);
    case.params.range_max_m = 2.5;
    case.noise = 1e-4;
    case.hidden[0][20] = true;
    let scene = [reflector(0.2, 0.52, -31.0), reflector(0.08, 1.21, 8.0), reflector(0.03, 1.23, 60.0)];
    let mut random = Random(5);
    let pings = ping_set(3, (0..2).map(|sensor| case.samples(sensor, &scene, &mut random)).collect());
    let image_with = |rounds: usize| -> Vec<(String, Image)> {
        let plan = cleaned(case.clone(), rounds).plan();
        let masks = random_masks(&plan, 7);
        let image_on = |(name, open): (String, common::backends::Opener)| {
            let mut image = image_with_gains(&plan, &masks, &[4]);
            open(Arc::clone(&plan), Arc::clone(&masks)).image(&pings, &mut image).unwrap();
            (name, image)
        };
        // The plainest one first, also where a run is for the sake of one adapter.
        let plainest = ("plain".to_owned(), cpu(1, InstructionSet::Baseline));
        std::iter::once(plainest).chain(backends()).map(image_on).collect()
    };
    let double = |image: &Image, sensor: usize| -> Vec<f64> {
        image.energyscapes[sensor].values.iter().map(|value| f64::from(*value)).collect()
    };
    let (right, wrong) = (image_with(3), image_with(1));
    for sensor in 0..2 {
        let first = double(&right[0].1, sensor);
        for ((name, image), (_, other)) in right.iter().zip(&wrong) {
            let values = &image.energyscapes[sensor].values;
            let error = relative_l2(values, &first);
            println!("{name}, sensor {sensor}: {error:.1e}");
            assert!(error < TWIN_BOUND, "{name}: {error:e}");
            let control = relative_l2(values, &double(other, sensor));
            assert!(control > 10.0 * ALLOWED, "{name}: two rounds fewer change {control:e} only");
            let hidden =
                &values[20 * image.energyscapes[0].grid.range_count()..][..image.energyscapes[0].grid.range_count()];
            assert_eq!(hidden.iter().all(|value| *value == 0.0), sensor == 0, "{name}: hidden directions");
        }
    }
}

#[test]
fn an_echo_stays_where_it_is_and_as_loud_and_loses_its_side_lobes() {
    let (plain, clean) = (quiet(SampleFormat::PcmF32), cleaned(quiet(SampleFormat::PcmF32), 2));
    for (range_m, bearing_deg) in [(0.4, -48.3), (0.71, 20.2), (1.5, 0.4), (3.2, -64.6), (4.7, 33.0)] {
        let echo = [reflector(0.2, range_m, bearing_deg)];
        let (before, after) = (image_of(&plain, &echo), image_of(&clean, &echo));
        let ((.., was), (is_m, is_deg, is)) = (peak(&before), peak(&after));
        let (lobe_db, left_db) =
            (beyond_db(&before, &[(range_m, bearing_deg)], 0.2), beyond_db(&after, &[(range_m, bearing_deg)], 0.2));
        println!(
            "{range_m} m {bearing_deg}: {:.2} mm {:.3} deg {:.2} dB, {lobe_db:.1} to {left_db:.1} dB",
            1e3 * (is_m - range_m),
            is_deg - bearing_deg,
            20.0 * (is / was).log10()
        );
        assert!((is_m - range_m).abs() < 1e-3 && (is_deg - bearing_deg).abs() < 0.1 && (is / was - 1.0).abs() < 0.04);
        assert!(left_db < -55.0, "{range_m} m, {bearing_deg} deg: {left_db} dB are left");
        // The negative control.
        assert!(lobe_db > -20.0, "{lobe_db}");
    }
}

#[test]
fn a_weak_echo_beside_a_loud_one_is_seen_with_its_own_level() {
    let places = [(1.5, -10.0), (1.51, 35.0)];
    let echoes = [reflector(0.2, 1.5, -10.0), reflector(0.02, 1.51, 35.0)];
    let seen = |rounds: usize| {
        let image = image_of(&cleaned(quiet(SampleFormat::PcmF32), rounds), &echoes);
        let grid = &image.grid;
        let near = |cell: &usize| {
            let (direction, range) = grid.direction_and_range(*cell);
            let bearing_deg = grid.directions()[direction].azimuth_rad.to_degrees();
            (bearing_deg - 35.0).abs() < 3.0 && (grid.range_m(range) - 1.51).abs() < 0.01
        };
        let level = (0..grid.cell_count()).filter(near).map(|cell| image.values[cell]).fold(0.0, f32::max);
        (20.0 * f64::from(level / 0.02).log10(), beyond_db(&image, &places, 0.02))
    };
    let ((level_db, ghosts_db), (_, plain_db)) = (seen(3), seen(0));
    println!("level {level_db:.2} dB, the loudest elsewhere {ghosts_db:.1} dB, without CLEAN {plain_db:.1} dB");
    assert!(level_db.abs() < 1.0 && ghosts_db < -15.0, "{level_db} {ghosts_db}");
    assert!(plain_db > 0.0, "side lobes of {plain_db} dB hide nothing");
}

#[test]
fn a_wave_front_that_is_not_of_a_point_leaves_as_well() {
    // A plane wave from 0.5 m: a wall's wave front, the mirrored emitter's, is half as wrong for the cell's own point.
    let direction = Direction::horizontal(0.3);
    let echo = [Echo { point_m: None, ..Echo::of_point(0.2, 0.5, direction) }];
    let place = [(0.5, direction.azimuth_rad.to_degrees())];
    let left_db =
        |rounds: usize| beyond_db(&image_of(&cleaned(quiet(SampleFormat::PcmF32), rounds), &echo), &place, 0.2);
    let (before_db, after_db) = (left_db(0), left_db(2));
    println!("{before_db:.1} dB before, {after_db:.1} dB after");
    assert!(before_db > -20.0 && after_db < -45.0, "{before_db} {after_db}");
}

#[test]
fn what_is_no_echo_stays_what_it_is() {
    let mut case = quiet(SampleFormat::PcmF32);
    case.noise = 1e-3;
    let rms = |image: &Energyscape| {
        let squares: f64 = image.values.iter().map(|value| f64::from(*value).powi(2)).sum();
        (squares / image.values.len() as f64).sqrt()
    };
    let (before, after) = (image_of(&case, &[]), image_of(&cleaned(case.clone(), 4), &[]));
    let change_db = 20.0 * (rms(&after) / rms(&before)).log10();
    println!("noise changes by {change_db:.2} dB, its peak by {:.2}", after.peak().1 / before.peak().1);
    assert!(change_db.abs() < 2.0 && (after.peak().1 / before.peak().1 - 1.0).abs() < 0.3);
    // Nothing comes of nothing.
    case.noise = 0.0;
    assert!(image_of(&cleaned(case, 2), &[]).values.iter().all(|value| *value == 0.0));
}
