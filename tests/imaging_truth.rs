//! Known reflectors land in the right cell at the right strength, silence stays silent, and what is wrong with a channel or a
//! parameter is said. Through the whole imager, as the daemon uses it.

mod common;

use common::peaks::{imager, peak, quiet, reflector};
use common::scenes::{Case, Echo, SPEED_OF_SOUND_M_S, Sweep, ping_set, random_array, random_masks};
use common::{Random, relative_l2};
use noctule::imaging::backend::{Backend, BackendError, BackendKind, BackendReport, Image, Stage, StageOutput};
use noctule::imaging::channels::ChannelFinding;
use noctule::imaging::params::{ImagingParams, Prefer, Weighting};
use noctule::imaging::plan::ImagingPlan;
use noctule::imaging::{GPU_FAILURES_MAX, Imager, ImagerOptions};
use noctule::sensor::RecordingFormat;
use noctule::signal::{Direction, Energyscape, PingSet, SampleFormat, Samples};
use std::sync::Arc;

const FORMATS: [SampleFormat; 3] = [SampleFormat::PcmF32, SampleFormat::PcmI16, SampleFormat::Pdm];

#[test]
fn a_reflector_is_found_within_1_mm_and_half_a_degree_in_every_format() {
    for format in FORMATS {
        let case = quiet(format);
        let plan = case.plan();
        let mut imager = imager(&plan);
        for (range_m, bearing_deg, amplitude) in
            [(2.0, 30.0, 0.1), (0.6321, -47.3, 0.3), (4.871, 0.1, 0.02), (1.234, 71.9, 0.2), (3.3333, -12.2, 0.05)]
        {
            let echoes = [reflector(amplitude, range_m, bearing_deg)];
            let pings = ping_set(1, vec![case.samples(0, &echoes, &mut Random(1))]);
            let image = imager.image(&pings).unwrap();
            let (found_m, found_deg, strength) = peak(&image.energyscapes[0]);
            println!(
                "{format:?}: {range_m} m {bearing_deg} deg {amplitude}: {:.3} mm {:.3} deg {:.4}",
                1e3 * (found_m - range_m),
                found_deg - bearing_deg,
                strength / amplitude
            );
            assert!((found_m - range_m).abs() < 1e-3, "{format:?}: {found_m} m for {range_m}");
            assert!((found_deg - bearing_deg).abs() < 0.5, "{format:?}: {found_deg} deg for {bearing_deg}");
            // Measured: at most 1.9 % from fitting a bell to three bins.
            assert!((strength / amplitude - 1.0).abs() < 0.03, "{format:?}: {strength} for {amplitude}");
        }
    }
}

/// The negative control of the first test: what it would say of a decimation filter whose delay is forgotten.
#[test]
fn a_forgotten_filter_delay_would_be_seen_as_a_wrong_range() {
    let case = quiet(SampleFormat::Pdm);
    let plan = case.plan();
    let mut delayed = (*plan).clone();
    // Zeros at one end move the filter's middle, as a filter that is not compensated would.
    delayed.demodulation_taps.extend([0.0; 80]);
    let delayed = Arc::new(delayed);
    let pings = ping_set(1, vec![case.samples(0, &[reflector(0.1, 2.0, 20.0)], &mut Random(1))]);
    let found_m = |plan: &Arc<ImagingPlan>| peak(&imager(plan).image(&pings).unwrap().energyscapes[0]).0;
    let shift_m = found_m(&delayed) - found_m(&plan);
    let expected_m = 0.5 * SPEED_OF_SOUND_M_S * 40.0 / 4.5e6;
    assert!((shift_m - expected_m).abs() < 2e-4 && shift_m.abs() > 1e-3, "{shift_m} for {expected_m}");
}

#[test]
fn an_echo_of_amplitude_a_reads_a_whatever_a_is() {
    // On a bin and on a bearing of the grid, so that nothing is lost between cells.
    let case = quiet(SampleFormat::PcmF32);
    let plan = case.plan();
    let mut imager = imager(&plan);
    let (range, direction) = (313, 47);
    let bearing_deg = plan.grid.directions()[direction].azimuth_rad.to_degrees();
    for amplitude in [1e-5, 1e-3, 0.1, 0.9] {
        // A plane wave: what a point's round wave loses is another test's.
        let echo = Echo { point_m: None, ..reflector(amplitude, plan.grid.range_m(range), bearing_deg) };
        let pings = ping_set(1, vec![case.samples(0, &[echo], &mut Random(1))]);
        let image = &imager.image(&pings).unwrap().energyscapes[0];
        let ratio = f64::from(image.values[plan.grid.cell(direction, range)]) / amplitude;
        println!("{amplitude}: {ratio:.5}");
        // Measured 0.99816: the tapered sweep has 0.18 % of its energy where the passband falls off.
        assert!((ratio - 0.99816).abs() < 1e-4, "{amplitude} reads {ratio} times as much");
        assert_eq!(image.peak().0, plan.grid.cell(direction, range));
    }
}

#[test]
fn two_echoes_add_up_and_the_ping_is_never_normalised_by_its_own_maximum() {
    let case = quiet(SampleFormat::PcmF32);
    let plan = case.plan();
    let mut imager = imager(&plan);
    let mut image_of = |echoes: &[Echo]| {
        let pings = ping_set(1, vec![case.samples(0, echoes, &mut Random(1))]);
        imager.image(&pings).unwrap().energyscapes[0].clone()
    };
    let weak = image_of(&[reflector(0.01, 1.5, -30.0)]);
    let both = image_of(&[reflector(0.01, 1.5, -30.0), reflector(0.5, 4.0, 40.0)]);
    let (cell, alone) = weak.peak();
    let beside = both.values[cell];
    // What the strong echo leaks there (side lobes of the array and of the sweep) is all that may differ; measured 6 %.
    assert!((beside / alone - 1.0).abs() < 0.2, "{beside} beside a strong echo, {alone} alone");
}

#[test]
fn silence_stays_silent() {
    for format in [SampleFormat::PcmF32, SampleFormat::PcmI16] {
        let case = quiet(format);
        let plan = case.plan();
        // Digital zero is a dead channel, so silence is given to the backend without the judge: see the conformance suite; here a single
        // sample of the smallest kind keeps the channels alive.
        let mut samples = Samples::zeros(format, plan.raw_len(0));
        match &mut samples {
            Samples::PcmI16(values) => values.chunks_mut(plan.raw_count).for_each(|row| row[0] = 1),
            Samples::PcmF32(values) => values.chunks_mut(plan.raw_count).for_each(|row| row[0] = 1e-6),
            Samples::Pdm(_) => panic!("format"),
        }
        let mut imager = imager(&plan);
        let image = imager.image(&ping_set(1, vec![samples])).unwrap();
        let loudest = image.energyscapes[0].peak().1;
        assert!(loudest < 1e-7, "{format:?}: {loudest}");
    }
    // A modulator that hears nothing alternates.
    let case = quiet(SampleFormat::Pdm);
    let plan = case.plan();
    let words = (0..plan.raw_count).map(|index| if index % 2 == 0 { u32::MAX } else { 0 }).collect();
    let mut imager = imager(&plan);
    let image = imager.image(&ping_set(1, vec![Samples::Pdm(words)])).unwrap();
    let loudest = image.energyscapes[0].peak().1;
    println!("idle PDM: {loudest:e}");
    assert!(loudest < 1e-6, "{loudest}");
}

#[test]
fn with_all_channels_dead_the_image_is_zero_and_every_channel_is_named() {
    for format in FORMATS {
        let case = quiet(format);
        let plan = case.plan();
        let mut imager = imager(&plan);
        // First something to hear, so that zeros are not merely what was there before.
        let echoes = [reflector(0.2, 2.0, 10.0)];
        let loud = ping_set(1, vec![case.samples(0, &echoes, &mut Random(1))]);
        assert!(imager.image(&loud).unwrap().energyscapes[0].peak().1 > 0.1);
        let dead = ping_set(2, vec![Samples::zeros(format, plan.raw_len(0))]);
        let image = imager.image(&dead).unwrap();
        assert!(image.imaged[0] && image.energyscapes[0].values.iter().all(|value| *value == 0.0), "{format:?}");
        assert_eq!(image.channels[0].bad_count(), 32, "{format:?}");
        assert_eq!(image.channels[0].used_count(), 0, "{format:?}");
    }
}

#[test]
fn bad_channels_are_named_and_left_out_and_the_reflector_keeps_its_place_and_strength() {
    let case = quiet(SampleFormat::PcmF32);
    let plan = case.plan();
    let mut imager = imager(&plan);
    let mut pings = ping_set(1, vec![case.samples(0, &[reflector(0.2, 2.0, 25.0)], &mut Random(1))]);
    let Samples::PcmF32(values) = pings.pings[0].samples_mut() else { panic!("format") };
    let count = plan.raw_count;
    values[3 * count + 77] = f32::NAN;
    values[9 * count + 16_383] = f32::INFINITY;
    values[20 * count..21 * count].fill(0.125);
    values[30 * count + 9000..30 * count + 9003].fill(-1.0);
    // Clipping in the direct path is normal.
    values[12 * count + 10..12 * count + 600].fill(1.0);
    let image = imager.image(&pings).unwrap();
    let report = &image.channels[0];
    let expected = |channel| match channel {
        3 | 9 => ChannelFinding::NotFinite,
        20 => ChannelFinding::Stuck,
        30 => ChannelFinding::Clipped,
        _ => ChannelFinding::Good,
    };
    for (channel, finding) in report.findings.iter().enumerate() {
        assert_eq!(*finding, expected(channel), "channel {channel}");
    }
    assert_eq!((report.bad_count(), report.clipped_count(), report.used_count()), (4, 1, 28));
    assert!((report.gains.iter().sum::<f32>() - 1.0).abs() < 1e-6);
    let (range_m, bearing_deg, strength) = peak(&image.energyscapes[0]);
    assert!(image.energyscapes[0].values.iter().all(|value| value.is_finite()));
    assert!((range_m - 2.0).abs() < 1e-3 && (bearing_deg - 25.0).abs() < 0.5, "{range_m} m, {bearing_deg} deg");
    assert!((strength / 0.2 - 1.0).abs() < 0.02, "{strength}");
}

#[test]
fn a_near_obstacle_that_clips_most_channels_is_still_seen() {
    let case = quiet(SampleFormat::PcmI16);
    let plan = case.plan();
    let mut imager = imager(&plan);
    let pings = ping_set(1, vec![case.samples(0, &[reflector(3.0, 0.9, 5.0)], &mut Random(1))]);
    let image = imager.image(&pings).unwrap();
    assert!(image.channels[0].clipped_count() > 2, "{}", image.channels[0].clipped_count());
    let (range_m, bearing_deg, strength) = peak(&image.energyscapes[0]);
    assert!((range_m - 0.9).abs() < 5e-3 && (bearing_deg - 5.0).abs() < 1.0 && strength > 0.5);
}

/// PDM of tones below and above full scale: the judge must tell them apart.
#[test]
fn an_overloaded_modulator_is_told_from_a_loud_one() {
    let case = Case { noise: 0.0, tone: 0.0, ..Case::standard("loud", SampleFormat::Pdm, 1, 45) };
    let plan = case.plan();
    let mut imager = imager(&plan);
    for (amplitude, clipped) in [(0.8, false), (0.93, false), (1.6, true), (4.0, true)] {
        let pings = ping_set(1, vec![case.samples(0, &[reflector(amplitude, 1.5, 0.0)], &mut Random(1))]);
        let image = imager.image(&pings).unwrap();
        assert_eq!(image.channels[0].clipped_count() == 32, clipped, "amplitude {amplitude}");
    }
}

#[test]
fn elevation_is_found_by_a_3_d_grid() {
    let array = random_array(24, 0.07, false, 11);
    let directions: Vec<Direction> = (-4..=4)
        .flat_map(|e| (-6..=6).map(move |a| (f64::from(a) * 10.0, f64::from(e) * 10.0)))
        .map(|(a, e)| Direction { azimuth_rad: a.to_radians(), elevation_rad: e.to_radians() })
        .collect();
    let recording =
        RecordingFormat { format: SampleFormat::PcmF32, sample_rate_hz: 450e3, samples: 16_384, decimation: 1 };
    let sweep = Sweep::new(80e3, 25e3, 450e3);
    let case = Case { noise: 0.0, tone: 0.0, ..Case::new("3-D", vec![array], sweep, recording, directions) };
    let plan = case.plan();
    let direction = 5 * 13 + 9;
    let echo = Echo::of_point(0.1, 1.7, case.directions[direction]);
    let pings = ping_set(1, vec![case.samples(0, &[echo], &mut Random(1))]);
    let mut imager = imager(&plan);
    let (cell, _) = imager.image(&pings).unwrap().energyscapes[0].peak();
    let (found, range) = plan.grid.direction_and_range(cell);
    assert_eq!(found, direction);
    assert!((plan.grid.range_m(range) - 1.7).abs() < plan.grid.range_step_m());
}

/// Measured 1.0000 for both; with more noise than echo in a bin the bin's phase would be the noise's.
const PHAT_TOLERANCE: f32 = 5e-3;

#[test]
fn phat_reads_about_one_for_one_echo_of_any_strength() {
    for amplitude in [0.01, 0.5] {
        let mut case = Case { noise: 1e-5, ..quiet(SampleFormat::PcmF32) };
        case.params.weighting = Weighting::Phat;
        let plan = case.plan();
        let (range, direction) = (340, 90);
        let bearing_deg = plan.grid.directions()[direction].azimuth_rad.to_degrees();
        let echo = Echo { point_m: None, ..reflector(amplitude, plan.grid.range_m(range), bearing_deg) };
        let pings = ping_set(1, vec![case.samples(0, &[echo], &mut Random(1))]);
        let (cell, strength) = imager(&plan).image(&pings).unwrap().energyscapes[0].peak();
        println!("{amplitude}: {strength:.4}");
        assert_eq!(cell, plan.grid.cell(direction, range));
        assert!((strength - 1.0).abs() < PHAT_TOLERANCE, "{amplitude} reads {strength}");
    }
}

#[test]
fn smoothing_widens_an_echo_and_keeps_its_place() {
    let case = quiet(SampleFormat::PcmF32);
    let mut smoothed = case.clone();
    smoothed.params.smoothing_hz = Some(4000.0);
    let pings = ping_set(1, vec![case.samples(0, &[reflector(0.1, 2.0, 30.0)], &mut Random(1))]);
    let image_of = |case: &Case| imager(&case.plan()).image(&pings).unwrap().energyscapes[0].clone();
    let (plain, smooth) = (image_of(&case), image_of(&smoothed));
    let wide = |image: &Energyscape| {
        let half = 0.5 * image.peak().1;
        let row = image.grid.direction_and_range(image.peak().0).0;
        let cells = image.grid.cell(row, 0)..image.grid.cell(row, image.grid.range_count() - 1);
        image.values[cells].iter().filter(|value| **value > half).count()
    };
    assert!(wide(&smooth) > wide(&plain) && smooth.peak().1 < plain.peak().1);
    assert!((peak(&smooth).0 - 2.0).abs() < 1e-3);
    assert!(smooth.values.iter().all(|value| *value >= 0.0));
}

#[test]
fn the_range_axis_starts_at_the_minimum_ends_within_the_maximum_and_keeps_the_step() {
    for (min, max, step) in
        [(0.3, 5.0, None), (0.25, 3.7, Some(0.01)), (0.5, 6.0, Some(0.0021)), (0.1, 1.0, Some(0.09))]
    {
        let mut case = Case::standard("axis", SampleFormat::PcmF32, 1, 30);
        case.params =
            ImagingParams { range_min_m: min, range_max_m: max, range_step_m: step, ..ImagingParams::default() };
        let grid = &case.plan().grid;
        let wanted = step.unwrap_or(5e-3);
        assert_eq!(grid.range_first_m(), min);
        assert!(grid.range_step_m() <= wanted * (1.0 + 1e-9) && grid.range_step_m() >= 0.99 * wanted * (1.0 - 1e-9));
        let last = grid.range_m(grid.range_count() - 1);
        assert!(last <= max * (1.0 + 1e-12) && last + grid.range_step_m() > max, "{last} for {max}");
    }
}

#[test]
fn the_default_step_is_fine_enough_for_the_bandwidth() {
    let mut case = Case::standard("step", SampleFormat::PcmF32, 1, 30);
    assert!((case.plan().grid.range_step_m() / 5e-3 - 1.0).abs() < 0.01);
    case.sweep = Sweep::new(80e3, 20e3, 450e3);
    let finest = SPEED_OF_SOUND_M_S / (2.4 * 60e3);
    let step = case.plan().grid.range_step_m();
    assert!(step <= finest && step >= 0.99 * finest, "{step} for {finest}");
}

#[test]
fn parameters_that_cannot_work_are_refused_by_their_key() {
    let refused = |change: &dyn Fn(&mut Case)| {
        let mut case = Case::standard("refused", SampleFormat::PcmF32, 1, 30);
        change(&mut case);
        let sensors = case.sensors();
        let directions = case.directions.clone();
        let hidden = vec![vec![false; directions.len()]; sensors.len()];
        let plan = ImagingPlan::new(&sensors, &hidden, &case.recording, &case.params, directions, SPEED_OF_SOUND_M_S);
        plan.map(|_| ()).expect_err("must be refused").key
    };
    assert_eq!(refused(&|case| case.params.range_max_m = 6.3), "imaging.range_max_m");
    assert_eq!(refused(&|case| case.params.range_max_m = 0.2), "imaging.range_max_m");
    assert_eq!(refused(&|case| case.params.range_max_m = f64::NAN), "imaging.range_max_m");
    assert_eq!(refused(&|case| case.params.range_min_m = -0.1), "imaging.range_min_m");
    assert_eq!(refused(&|case| case.params.range_min_m = f64::NAN), "imaging.range_min_m");
    assert_eq!(refused(&|case| case.params.range_step_m = Some(0.0)), "imaging.range_step_m");
    assert_eq!(refused(&|case| case.params.range_step_m = Some(f64::NAN)), "imaging.range_step_m");
    assert_eq!(refused(&|case| case.params.smoothing_hz = Some(-1.0)), "imaging.smoothing_hz");
    assert_eq!(refused(&|case| case.params.smoothing_hz = Some(f64::INFINITY)), "imaging.smoothing_hz");
    assert_eq!(refused(&|case| case.recording.samples = 0), "recording.samples");
    assert_eq!(refused(&|case| case.recording.samples = 1 << 22), "recording.samples");
    assert_eq!(refused(&|case| case.recording.sample_rate_hz = 200e3), "emission.file");
    assert_eq!(refused(&|case| case.directions.clear()), "imaging.directions");
    assert_eq!(refused(&|case| case.arrays[0].clear()), "sensor[0].array");
    assert_eq!(refused(&|case| case.arrays[0] = random_array(257, 0.1, true, 1)), "sensor[0].array");
    assert_eq!(
        refused(&|case| {
            case.recording.sample_rate_hz = 90e3;
            case.sweep = Sweep::new(50e3, 25e3, 90e3);
        }),
        "emission.start_hz"
    );
    assert_eq!(
        refused(&|case| {
            *case = Case::standard("refused", SampleFormat::Pdm, 1, 30);
            case.arrays[0] = random_array(33, 0.1, true, 1);
        }),
        "sensor[0].array"
    );
}

/// A GPU that fails when it is told to, and otherwise leaves a mark on the image.
struct FaultyGpu {
    failures: Vec<Option<BackendError>>,
    report: BackendReport,
}

impl FaultyGpu {
    fn boxed(failures: Vec<Option<BackendError>>) -> Box<dyn Backend> {
        let report =
            BackendReport { kind: BackendKind::Gpu, adapter: "faulty".into(), reason: "test".into(), threads: 1 };
        Box::new(Self { failures, report })
    }
}

impl Backend for FaultyGpu {
    fn image(&mut self, pings: &PingSet, image: &mut Image) -> Result<(), BackendError> {
        let failure = if self.failures.is_empty() { None } else { self.failures.remove(0) };
        // Half-done results, as a lost device leaves them.
        image.energyscapes[0].values.fill(if failure.is_some() { f32::NAN } else { 1.0 });
        image.sums.iter_mut().for_each(|sums| sums.energy = -1.0);
        (image.backend, image.sequence, image.imaged) = (BackendKind::Gpu, pings.sequence, pings.present);
        failure.map_or(Ok(()), Err)
    }

    fn image_up_to(&mut self, _: Stage, _: &PingSet, _: usize, _: &mut Image) -> Result<StageOutput, BackendError> {
        Err(BackendError::Unavailable("test".into()))
    }

    fn stage_times_ns(&self) -> [u64; Stage::ALL.len()] {
        [1; Stage::ALL.len()]
    }

    fn report(&self) -> &BackendReport {
        &self.report
    }
}

#[test]
fn a_ping_set_that_the_gpu_fails_is_done_again_on_the_cpu_and_said_so() {
    let case = Case::standard("fallback", SampleFormat::PcmF32, 1, 20);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    let pings = case.random_pings(1);
    let mut reference =
        Imager::open(Arc::clone(&plan), Arc::clone(&masks), Prefer::Cpu, ImagerOptions::default()).unwrap();
    let reference = reference.image(&pings).unwrap().clone();

    let timeout = || Some(BackendError::Timeout { limit_ms: 60 });
    let gpu = FaultyGpu::boxed(vec![timeout(), timeout(), None, timeout(), timeout(), timeout()]);
    let mut imager =
        Imager::with_backends(Arc::clone(&plan), Arc::clone(&masks), Some(gpu), Some(2), "not used").unwrap();
    let mut redone = 0;
    for failed in [true, true, false, true, true, true, true] {
        let image = imager.image(&pings).unwrap();
        if failed {
            assert_eq!(image.backend, BackendKind::Cpu);
            assert!(image.energyscapes == reference.energyscapes && image.sums == reference.sums);
        } else {
            assert_eq!(image.backend, BackendKind::Gpu);
        }
        redone += u64::from(failed);
        if redone < 5 {
            // Two failures, a good ping set, two failures: never three in a row.
            assert_eq!((imager.kind(), imager.redone_count()), (BackendKind::Gpu, redone));
        }
    }
    // After the third in a row the GPU is not asked any more.
    assert_eq!((GPU_FAILURES_MAX, imager.redone_count(), imager.kind()), (3, 5, BackendKind::Cpu));
    assert!(imager.report().reason.contains("60 ms"), "{}", imager.report().reason);
    assert!(matches!(imager.last_failure(), Some(BackendError::Timeout { .. })));
}

#[test]
fn a_lost_gpu_is_given_up_at_once_and_the_ping_set_is_not_lost() {
    let case = Case::standard("lost", SampleFormat::PcmF32, 1, 45);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    let pings = case.random_pings(1);
    let gpu = FaultyGpu::boxed(vec![Some(BackendError::Lost("unplugged".into()))]);
    let mut imager = Imager::with_backends(plan, masks, Some(gpu), Some(1), "not used").unwrap();
    let image = imager.image(&pings).unwrap();
    assert_eq!(image.backend, BackendKind::Cpu);
    assert!(image.energyscapes[0].values.iter().all(|value| value.is_finite()));
    assert_eq!(imager.kind(), BackendKind::Cpu);
    assert!(imager.report().reason.contains("unplugged"));
}

#[test]
fn the_counted_floor_is_that_of_the_default_sizes() {
    // 32 channels, 180 directions, 1092 bins, 2048 and 1250 points, 123 and 95 taps, 941 ranges, counted by hand.
    let floor = Case::standard("floor", SampleFormat::Pdm, 1, 1).plan().floor(1000);
    println!("{floor:?}");
    assert_eq!((floor[0].operations, floor[0].bytes), (32 * 16_384 * 95, 4 * 163_840 + 32 * 16_384 * 4));
    assert_eq!(floor[1].operations, 32 * (2 * 2048 * 123 + 3 * 2048 * 11) + 4 * 32 * 1092);
    assert_eq!((floor[2].operations, floor[2].bytes), (2 * 32 * 180 * 1092, 8 * (32 + 180) * 1092));
    // 80 ranges focused: a transform of 2500 points a channel, ten taps of a complex value, a turn.
    assert_eq!(floor[4].operations, 32 * (3.0 * 2500.0 * 2500_f64.log2()) as u64 + 24 * 32 * 180 * 80 + 3 * 180 * 80);
    assert_eq!(floor[5].operations, 2 * 180 * 941 + 5 * 1000);
    let three = Case::standard("floor", SampleFormat::Pdm, 3, 1).plan().floor(3000);
    assert!(
        floor.iter().zip(&three).all(|(one, all)| 3 * one.operations == all.operations && 3 * one.bytes == all.bytes)
    );
}

/// Slow but independent of the peak finders above: the whole image against the textbook, for the default configuration.
#[test]
fn the_default_image_equals_the_textbook_in_every_direction() {
    let case = Case::standard("default", SampleFormat::PcmF32, 1, 2);
    let plan = case.plan();
    let pings = case.random_pings(77);
    let mut imager = imager(&plan);
    let image = imager.image(&pings).unwrap();
    let samples = common::oracle::demodulate(&plan, 32, &pings.pings[0].samples);
    let directions: Vec<usize> = (0..case.directions.len()).collect();
    let gains = &image.channels[0].gains;
    let truth = common::oracle::energyscape(&case, &plan, 0, &samples, gains, &directions, common::oracle::Fault::None);
    let error = relative_l2(&image.energyscapes[0].values, &truth);
    assert!(error < 1e-5, "{error:e}");
}
