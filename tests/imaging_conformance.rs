//! Every backend equals the float64 textbook on random scenes: every stage, every raw format, odd sizes, lost channels.
//! Planted faults must turn each comparison red; nothing of an earlier ping, and no number of threads, may show.

mod common;

use common::backends::{backends, bearings, cpu, image_with_gains, pcm, range};
use common::oracle::{self, Fault};
use common::scenes::{Case, Sweep, ping_set, random_array, random_masks};
use common::{Random, relative_l2, relative_l2_complex};
use noctule::imaging::backend::{BackendError, Image, Stage, StageOutput};
use noctule::imaging::cpu::InstructionSet;
use noctule::imaging::params::{DirectionsParams, ImagingParams, Weighting};
use noctule::imaging::plan::ImagingPlan;
use noctule::sensor::RecordingFormat;
use noctule::signal::{Direction, MaskTable, PingSet, RowSums, SampleFormat, Samples};
use std::sync::Arc;

/// What the specification allows between a backend and the textbook.
const ALLOWED: f64 = 1e-4;
/// What we hold ourselves to. Measured over all cases and instruction sets: matched_filter, delay_and_sum and energyscape 3e-7 to 1.3e-6, the most
/// with PDM and PHAT: rounding of f32 samples and sums. Eight times that leaves room for another order of summation and none for a fault.
const BOUND: f64 = 1e-5;
/// Measured at most 5.5e-6, of samples that are small against the bits they are summed from.
const DEMODULATED_BOUND: f64 = 1e-5;

fn grid_3d() -> Vec<Direction> {
    let rows = [-0.4, 0.0, 0.5];
    let row =
        |elevation_rad: f64| (0..7).map(move |i| Direction { azimuth_rad: -1.2 + 0.4 * f64::from(i), elevation_rad });
    rows.into_iter().flat_map(row).collect()
}

/// The scenes: the three formats at default sizes, then everything that could be taken for granted, otherwise.
fn cases() -> Vec<Case> {
    let volume = random_array(8, 0.06, false, 3);
    let plane = random_array(64, 0.12, true, 4);
    let mut cases = vec![
        Case::standard("pcm-f32, three sensors", SampleFormat::PcmF32, 3, 12),
        Case::standard("pcm-i16", SampleFormat::PcmI16, 1, 9),
        Case::standard("pdm", SampleFormat::Pdm, 1, 9),
    ];
    let other_pdm =
        RecordingFormat { format: SampleFormat::Pdm, sample_rate_hz: 3.072e6, samples: 61_440, decimation: 8 };
    let array = random_array(16, 0.08, true, 5);
    let mut case =
        Case::new("pdm, 3.072 MHz by 8", vec![array], Sweep::new(80e3, 25e3, 384e3), other_pdm, bearings(12));
    case.params = range(0.25, 2.9, None);
    cases.push(case);

    let odd_pdm = RecordingFormat { format: SampleFormat::Pdm, sample_rate_hz: 3.6e6, samples: 45_000, decimation: 9 };
    let array = random_array(5, 0.05, true, 8);
    let mut case = Case::new("pdm, 3.6 MHz by 9", vec![array], Sweep::new(60e3, 25e3, 400e3), odd_pdm, bearings(7));
    case.params = range(0.25, 1.6, None);
    cases.push(case);

    let sweep = Sweep::new(40e3, 25e3, 192e3);
    let mut case = Case::new("volume array, 3-D grid", vec![volume.clone()], sweep, pcm(192e3, 6000), grid_3d());
    case.params = range(0.2, 4.0, None);
    cases.push(case);

    let equal_area = DirectionsParams { equal_area: Some(64), ..DirectionsParams::default() };
    let directions = noctule::imaging::steering::directions(&equal_area).unwrap();
    let flat = random_array(32, 0.06, true, 11);
    let mut case = Case::new("flat array, equal areas", vec![flat], sweep, pcm(192e3, 4200), directions);
    case.params = range(0.25, 2.1, None);
    cases.push(case);

    let sweep = Sweep::new(80e3, 20e3, 400e3);
    let mut case = Case::new("64 microphones, 8 m, 80 to 20 kHz", vec![plane], sweep, pcm(400e3, 20_001), bearings(9));
    case.params = range(0.5, 8.0, None);
    cases.push(case);

    let sweep = Sweep::new(50e3, 25e3, 250e3);
    let mut case =
        Case::new("folded to few bins, smoothed", vec![volume.clone()], sweep, pcm(250e3, 7919), bearings(10));
    case.params = ImagingParams { smoothing_hz: Some(900.0), ..range(0.37, 4.1, Some(0.031)) };
    cases.push(case);

    let mut case = Case::new("phat", vec![volume.clone()], sweep, pcm(250e3, 4000), bearings(8));
    case.params = ImagingParams { weighting: Weighting::Phat, ..range(0.3, 2.0, None) };
    cases.push(case);

    let arrays = vec![volume, random_array(13, 0.05, true, 6)];
    let mut case = Case::new("two different arrays, hidden bearings", arrays, sweep, pcm(250e3, 5001), bearings(11));
    case.params = range(0.3, 2.5, Some(0.011));
    case.hidden[0][2] = true;
    case.hidden[1][10] = true;
    cases.push(case);

    let one = vec![vec![nalgebra::Vector3::new(0.01, 0.02, 0.0)]];
    let mut case = Case::new("one microphone, one direction", one, sweep, pcm(250e3, 3000), bearings(1));
    case.params = range(0.3, 1.5, None);
    cases.push(case);

    let plane = vec![random_array(20, 0.06, true, 9)];
    let mut case = Case::new("from range zero, bearings in mirror pairs", plane, sweep, pcm(250e3, 4003), bearings(38));
    case.params = range(0.0, 2.2, None);
    cases.push(case);
    cases
}

/// Directions compared: all of a small grid.
fn all_directions(case: &Case) -> Vec<usize> {
    (0..case.directions.len()).collect()
}

fn truth(case: &Case, plan: &ImagingPlan, pings: &PingSet, sensor: usize, gains: &[f32], fault: Fault) -> Vec<f64> {
    let samples = oracle::demodulate(plan, case.arrays[sensor].len(), &pings.pings[sensor].samples);
    oracle::energyscape(case, plan, sensor, &samples, gains, &all_directions(case), fault)
}

fn real(output: StageOutput) -> Vec<f32> {
    match output {
        StageOutput::Real(values) => values,
        other => panic!("expected real values, got {other:?}"),
    }
}

fn complex(output: StageOutput) -> Vec<[f32; 2]> {
    match output {
        StageOutput::Complex(values) => values,
        other => panic!("expected complex values, got {other:?}"),
    }
}

#[test]
fn energyscapes_equal_the_textbook_on_random_scenes_of_every_format_and_size() {
    for (index, case) in cases().into_iter().enumerate() {
        let plan = case.plan();
        let masks = random_masks(&plan, 7);
        let pings = case.random_pings(100 + index as u64);
        let mut image = image_with_gains(&plan, &masks, &[]);
        let gains: Vec<Vec<f32>> = image.channels.iter().map(|report| report.gains.clone()).collect();
        let truths: Vec<Vec<f64>> =
            (0..gains.len()).map(|sensor| truth(&case, &plan, &pings, sensor, &gains[sensor], Fault::None)).collect();
        for (name, open) in backends() {
            open(Arc::clone(&plan), Arc::clone(&masks)).image(&pings, &mut image).unwrap();
            for (energyscape, truth) in image.energyscapes.iter().zip(&truths) {
                let error = relative_l2(&energyscape.values, truth);
                println!("{name}: {}, sensor {}: {error:.2e}", case.name, energyscape.sensor_index);
                assert!(error < BOUND, "{name}: {}: {error:e}", case.name);
            }
            for (row, found) in image.sums.iter().enumerate() {
                check_sums(&name, &case, &plan, &masks, row, &image, &truths, found);
            }
        }
    }
}

/// Sums against the textbook image; which cells count, against the backend's own image.
#[allow(clippy::too_many_arguments, reason = "one comparison, all that it compares")]
fn check_sums(
    name: &str,
    case: &Case,
    plan: &ImagingPlan,
    masks: &MaskTable,
    row: usize,
    image: &Image,
    truths: &[Vec<f64>],
    found: &RowSums,
) {
    let sensor = masks.rows[row].sensor_index;
    let [energy, turn, flow, peak, turn_scale] = oracle::masked_energy(masks, row, plan, &truths[sensor]);
    // A cell within rounding of its floor may be in one sum and not in the other; one such cell weighs far less than this.
    for (label, found, truth, scale) in [
        ("energy", found.energy, energy, energy),
        ("turn", found.turn, turn, turn_scale),
        ("flow", found.flow, flow, flow),
        ("peak", found.peak, peak, peak),
    ] {
        let error = (f64::from(found) - truth).abs();
        assert!(error <= ALLOWED * scale, "{name}: {}: row {row} {label}: {found} for {truth}", case.name);
    }
    let own: Vec<f64> = image.energyscapes[sensor].values.iter().map(|value| f64::from(*value)).collect();
    let contradiction = oracle::entries_contradict(masks, row, plan, &own, found);
    assert_eq!(contradiction, None, "{name}: {}: row {row}", case.name);
}

#[test]
fn every_stage_equals_the_textbook() {
    for (index, case) in cases().into_iter().enumerate() {
        let plan = case.plan();
        let masks = random_masks(&plan, 7);
        let pings = case.random_pings(200 + index as u64);
        let mut random = Random(index as u64);
        let bins: Vec<usize> = (0..12).map(|_| random.index(plan.bin_count)).collect();
        let sensor = case.arrays.len() - 1;
        let channels = case.arrays[sensor].len();
        let samples = oracle::demodulate(&plan, channels, &pings.pings[sensor].samples);
        let matched: Vec<Vec<oracle::Complex>> = bins
            .iter()
            .map(|bin| {
                let of = |row: &Vec<f64>| oracle::matched_filter(&case, &plan, row, plan.first_bin + bin);
                samples.iter().map(|row| of(row).scaled(1.0 / channels as f64)).collect()
            })
            .collect();
        for (name, open) in backends() {
            let mut backend = open(Arc::clone(&plan), Arc::clone(&masks));
            let mut image = image_with_gains(&plan, &masks, &[]);
            let mut up_to = |stage| backend.image_up_to(stage, &pings, sensor, &mut image).unwrap();
            let error = relative_l2(&real(up_to(Stage::Demodulate)), &samples.concat());
            println!("{name}: {}: demodulate {error:.2e}", case.name);
            assert!(error < DEMODULATED_BOUND, "{name}: {}: demodulate {error:e}", case.name);

            let spectra = complex(up_to(Stage::MatchedFilter));
            let (mut found, mut expected) = (Vec::new(), Vec::new());
            for (bin, matched) in bins.iter().zip(&matched) {
                found.extend((0..channels).map(|channel| spectra[channel * plan.bin_count + bin]));
                expected.extend_from_slice(matched);
            }
            let error = relative_l2_complex(&found, &expected);
            println!("{name}: {}: matched_filter {error:.2e}", case.name);
            assert!(error < BOUND, "{name}: {}: matched_filter {error:e}", case.name);

            let beams = complex(up_to(Stage::DelayAndSum));
            let (mut found, mut expected) = (Vec::new(), Vec::new());
            for (bin, matched) in bins.iter().zip(&matched) {
                for direction in 0..case.directions.len() {
                    found.push(beams[direction * plan.bin_count + bin]);
                    let absolute = plan.first_bin + bin;
                    expected.push(oracle::delay_and_sum(&case, &plan, sensor, direction, absolute, matched));
                }
            }
            let error = relative_l2_complex(&found, &expected);
            println!("{name}: {}: delay_and_sum {error:.2e}", case.name);
            assert!(error < BOUND, "{name}: {}: delay_and_sum {error:e}", case.name);

            let alone = real(up_to(Stage::Focus));
            let StageOutput::Sums(sums) = up_to(Stage::MaskedEnergy) else { panic!("sums") };
            open(Arc::clone(&plan), Arc::clone(&masks)).image(&pings, &mut image).unwrap();
            assert_eq!(alone, image.energyscapes[sensor].values, "{name}: {}: focus", case.name);
            for (row, sums) in sums.iter().enumerate() {
                let expected = if masks.rows[row].sensor_index == sensor { image.sums[row] } else { RowSums::SILENT };
                assert_eq!(*sums, expected, "{name}: {}: masked_energy, row {row}", case.name);
            }
        }
    }
}

#[test]
fn planted_faults_turn_the_comparison_red() {
    let case = Case::standard("faults", SampleFormat::PcmF32, 1, 20);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    let pings = case.random_pings(300);
    let mut image = image_with_gains(&plan, &masks, &[]);
    let gains = image.channels[0].gains.clone();
    for (name, open) in backends() {
        open(Arc::clone(&plan), Arc::clone(&masks)).image(&pings, &mut image).unwrap();
        let values = &image.energyscapes[0].values;
        let error = |fault| relative_l2(values, &truth(&case, &plan, &pings, 0, &gains, fault));
        assert!(error(Fault::None) < BOUND);
        for fault in [
            Fault::LateMicrophone(11),
            Fault::SwappedChannels(4, 5),
            Fault::DelaySign,
            Fault::Scale,
            Fault::ShiftedDirection(3),
            Fault::LostMirror(1),
            Fault::RangeOffset,
            Fault::NoQuadrature,
            Fault::NoEmitter,
            Fault::PlaneWave,
        ] {
            let error = error(fault);
            println!("{name}: {fault:?}: {error:.2e}");
            assert!(error > 10.0 * ALLOWED, "{name}: {fault:?} changes the image by {error:e} only");
        }
    }
}

#[test]
fn left_out_channels_drop_out_of_the_sum_and_the_rest_keeps_its_scale() {
    let case = Case::standard("left out", SampleFormat::PcmF32, 1, 20);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    let mut pings = case.random_pings(400);
    let left_out = [0, 7, 31];
    let mut image = image_with_gains(&plan, &masks, &left_out);
    let gains = image.channels[0].gains.clone();
    let truth = truth(&case, &plan, &pings, 0, &gains, Fault::None);
    // What a left-out channel holds must not matter, not even as zero times NaN.
    let Samples::PcmF32(values) = pings.pings[0].samples_mut() else { panic!("format") };
    for (channel, poison) in left_out.into_iter().zip([f32::NAN, f32::INFINITY, 1e38]) {
        values[channel * plan.raw_count..][..plan.raw_count].fill(poison);
    }
    for (name, open) in backends() {
        open(Arc::clone(&plan), Arc::clone(&masks)).image(&pings, &mut image).unwrap();
        let error = relative_l2(&image.energyscapes[0].values, &truth);
        assert!(error < BOUND, "{name}: {error:e}");
    }
}

#[test]
fn with_every_channel_left_out_the_image_is_zero_and_the_sums_are_silent() {
    let case = Case::standard("all left out", SampleFormat::PcmF32, 1, 45);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    let pings = case.random_pings(500);
    let all: Vec<usize> = (0..32).collect();
    for (name, open) in backends() {
        let mut backend = open(Arc::clone(&plan), Arc::clone(&masks));
        let mut image = image_with_gains(&plan, &masks, &[]);
        backend.image(&pings, &mut image).unwrap();
        assert!(image.sums.iter().any(|sums| sums.energy > 0.0), "{name}: the scene is not silent");
        let mut image = image_with_gains(&plan, &masks, &all);
        backend.image(&pings, &mut image).unwrap();
        assert!(image.energyscapes[0].values.iter().all(|value| *value == 0.0), "{name}");
        assert!(image.sums.iter().all(|sums| *sums == RowSums::SILENT), "{name}");
        assert!(image.imaged[0], "{name}");
    }
}

#[test]
fn an_absent_sensor_is_not_imaged_and_the_others_do_not_notice() {
    let case = Case::standard("absent", SampleFormat::PcmF32, 3, 30);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    let mut pings = case.random_pings(600);
    for (name, open) in backends() {
        let mut backend = open(Arc::clone(&plan), Arc::clone(&masks));
        let mut whole = image_with_gains(&plan, &masks, &[]);
        pings.present = [true; 3];
        backend.image(&pings, &mut whole).unwrap();
        for absent in 0..3 {
            let mut image = image_with_gains(&plan, &masks, &[]);
            pings.present = [true; 3];
            pings.present[absent] = false;
            backend.image(&pings, &mut image).unwrap();
            assert_eq!(image.imaged, pings.present, "{name}");
            for sensor in 0..3 {
                let values = &image.energyscapes[sensor].values;
                if sensor == absent {
                    assert!(values.iter().all(|value| *value == 0.0), "{name}");
                } else {
                    assert_eq!(values, &whole.energyscapes[sensor].values, "{name}: sensor {sensor} without {absent}");
                }
            }
            for (row, sums) in masks.rows.iter().zip(image.sums.iter().zip(&whole.sums)) {
                let expected = if row.sensor_index == absent { RowSums::SILENT } else { *sums.1 };
                assert_eq!(*sums.0, expected, "{name}");
            }
        }
    }
}

#[test]
fn nothing_of_an_earlier_ping_shows() {
    for format in [SampleFormat::PcmF32, SampleFormat::Pdm] {
        let case = Case::standard("dirty scratch", format, 1, 30);
        let plan = case.plan();
        let masks = random_masks(&plan, 7);
        let (first, second) = (case.random_pings(700), case.random_pings(701));
        let silence = Samples::zeros(SampleFormat::PcmF32, plan.raw_count * 32);
        for (name, open) in backends() {
            let fresh = |pings: &PingSet| {
                let mut image = image_with_gains(&plan, &masks, &[]);
                open(Arc::clone(&plan), Arc::clone(&masks)).image(pings, &mut image).unwrap();
                (image.energyscapes[0].values.clone(), image.sums)
            };
            let mut used = open(Arc::clone(&plan), Arc::clone(&masks));
            let mut image = image_with_gains(&plan, &masks, &[]);
            for pings in [&first, &second, &first, &second] {
                used.image(pings, &mut image).unwrap();
                let (values, sums) = fresh(pings);
                assert!(image.energyscapes[0].values == values && image.sums == sums, "{name}");
            }
            if format == SampleFormat::PcmF32 {
                used.image(&ping_set(9, vec![silence.clone()]), &mut image).unwrap();
                assert!(image.energyscapes[0].values.iter().all(|value| *value == 0.0), "{name}: silence after noise");
            }
        }
    }
}

#[test]
fn any_number_of_cpu_threads_gives_the_same_bits() {
    for format in [SampleFormat::PcmF32, SampleFormat::PcmI16, SampleFormat::Pdm] {
        let case = Case::standard("threads", format, if format == SampleFormat::PcmF32 { 3 } else { 1 }, 11);
        let plan = case.plan();
        let masks = random_masks(&plan, 7);
        let pings = case.random_pings(800);
        let mut reference: Option<Image> = None;
        for threads in [1, 2, 3, 5] {
            let mut backend = cpu(threads, InstructionSet::best())(Arc::clone(&plan), Arc::clone(&masks));
            let mut image = image_with_gains(&plan, &masks, &[]);
            backend.image(&pings, &mut image).unwrap();
            let reference = reference.get_or_insert_with(|| image.clone());
            for (found, expected) in image.energyscapes.iter().zip(&reference.energyscapes) {
                assert!(found.values == expected.values, "{format:?} on {threads} threads");
            }
            assert_eq!(image.sums, reference.sums, "{format:?} on {threads} threads");
        }
    }
}

#[test]
fn a_ping_of_another_shape_is_refused_with_what_was_found_and_what_is_allowed() {
    let case = Case::standard("shape", SampleFormat::PcmF32, 1, 45);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    for (name, open) in backends() {
        let mut backend = open(Arc::clone(&plan), Arc::clone(&masks));
        let mut image = image_with_gains(&plan, &masks, &[]);
        for samples in [
            Samples::PcmF32(vec![0.0; plan.raw_count * 31]),
            Samples::PcmI16(vec![0; plan.raw_count * 32]),
            Samples::Pdm(Vec::new()),
        ] {
            let text = backend.image(&ping_set(1, vec![samples]), &mut image).unwrap_err().to_string();
            assert!(text.contains("524288 values of PcmF32"), "{name}: {text}");
        }
    }
}

/// The sums of a value that is not finite: infinite energy, never silence.
#[test]
fn a_huge_sample_becomes_infinite_energy_rather_than_silence() {
    let case = Case::standard("overflow", SampleFormat::PcmF32, 1, 45);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    let mut pings = case.random_pings(900);
    let Samples::PcmF32(values) = pings.pings[0].samples_mut() else { panic!("format") };
    values.iter_mut().for_each(|value| *value *= 1e37);
    for (name, open) in backends() {
        let mut image = image_with_gains(&plan, &masks, &[]);
        match open(Arc::clone(&plan), Arc::clone(&masks)).image(&pings, &mut image) {
            Ok(()) => {}
            // The GPU hands such a ping set back, to be done again on the CPU.
            Err(BackendError::Invalid(_)) if name == "gpu" => continue,
            Err(error) => panic!("{name}: {error}"),
        }
        let region = image.sums[0];
        assert!(region.energy == f32::INFINITY && region.peak == f32::INFINITY, "{name}: {region:?}");
        assert!(region.nearest_distance_m.is_finite() && !region.turn.is_nan(), "{name}: {region:?}");
    }
}

#[test]
fn the_oracles_own_transform_is_the_definition_of_a_spectrum() {
    let samples: Vec<f64> = (0..100).map(|n| f64::from(n * n * 37).sin()).collect();
    let values = oracle::transform(&samples, 128);
    for k in [0, 1, 17, 64, 100] {
        let truth = oracle::spectrum_at(&samples, 128.0, k as f64);
        assert!(values[k].plus(truth.scaled(-1.0)).magnitude() < 1e-11);
    }
}
