//! Faults that are put into ping sets: each changes what it names, on the sensor it is set for, until it is cleared, and nothing else.
//! Expected values are written out by hand.

use noctule::signal::{PingSet, SampleFormat, Samples};
use noctule::sim::{Fault, Faults};
use noctule::time::Stamp;

const CHANNELS: usize = 4;
const ROW: usize = 64;

/// Set `number` of two sensors; every value of every set is another one.
fn set(number: u64, format: SampleFormat) -> PingSet {
    let len = if format == SampleFormat::Pdm { ROW } else { CHANNELS * ROW };
    let mut pings = PingSet::empty(2, format, &[len; 2]);
    pings.sequence = number;
    pings.present = [true, true, false];
    for (sensor, ping) in pings.pings.iter_mut().enumerate() {
        ping.sequence = number;
        ping.emitted_at = Stamp { boottime_ns: 1_000_000_000 * number, wall_ns: 0 };
        let value = |n: usize| ((n * 37 + sensor * 11 + 5 * number as usize) % 199) as f32 / 400.0 - 0.25;
        match ping.samples_mut() {
            Samples::Pdm(words) => {
                words.iter_mut().enumerate().for_each(|(n, word)| *word = (value(n) * 4e6) as i32 as u32 & 0xf);
            }
            Samples::PcmI16(values) => {
                values.iter_mut().enumerate().for_each(|(n, to)| *to = (value(n) * 32768.0) as i16);
            }
            Samples::PcmF32(values) => values.iter_mut().enumerate().for_each(|(n, to)| *to = value(n)),
        }
    }
    pings.emitted_at = pings.pings[0].emitted_at;
    pings
}

fn faults() -> Faults {
    Faults::new(&[CHANNELS; 2], 1)
}

const FORMATS: [SampleFormat; 3] = [SampleFormat::Pdm, SampleFormat::PcmI16, SampleFormat::PcmF32];

const OF_SAMPLES: [Fault; 8] = [
    Fault::EmitterDead { rms: 0.01 },
    Fault::Zeros,
    Fault::Clipped { gain: 100.0 },
    Fault::DeadChannels { count: 2 },
    Fault::StuckChannels { count: 2 },
    Fault::HotChannels { count: 2, rms: 0.1 },
    Fault::SwappedChannels { pairs: 1 },
    Fault::RateError { ratio: 1.1 },
];

#[test]
fn a_fault_of_samples_changes_them_on_its_sensor_only_and_is_gone_when_cleared() {
    for format in FORMATS {
        for fault in OF_SAMPLES {
            let mut faults = faults();
            faults.set(1, Some(fault));
            let mut pings = set(3, format);
            assert!(faults.apply(&mut pings), "{}", fault.name());
            let good = set(3, format);
            assert_eq!(pings.pings[0], good.pings[0], "{} {format:?}", fault.name());
            assert_ne!(pings.pings[1].samples, good.pings[1].samples, "{} {format:?}", fault.name());
            assert_eq!(pings.pings[1].sequence, 3);
            assert_eq!(pings.pings[1].samples.len(), good.pings[1].samples.len());
            faults.clear();
            let mut pings = set(4, format);
            assert!(!faults.apply(&mut pings));
            assert_eq!(pings, set(4, format), "{}", fault.name());
        }
    }
}

fn rows(samples: &Samples) -> Vec<Vec<f32>> {
    match samples {
        Samples::PcmF32(values) => values.chunks(ROW).map(<[f32]>::to_vec).collect(),
        other => panic!("{:?}", other.format()),
    }
}

#[test]
fn channels_die_stick_heat_and_swap_as_many_as_are_named() {
    let before = rows(&set(1, SampleFormat::PcmF32).pings[0].samples);
    let after = |fault| {
        let mut faults = faults();
        faults.set(0, Some(fault));
        let mut pings = set(1, SampleFormat::PcmF32);
        faults.apply(&mut pings);
        rows(&pings.pings[0].samples)
    };
    let dead = after(Fault::DeadChannels { count: 1 });
    assert!(dead[0].iter().all(|value| *value == 0.0) && dead[1..] == before[1..]);
    let stuck = after(Fault::StuckChannels { count: 3 });
    assert!(stuck[..3].iter().flatten().all(|value| *value == 1.0) && stuck[3] == before[3]);
    let hot = after(Fault::HotChannels { count: 1, rms: 0.05 });
    let power: f32 = hot[0].iter().zip(&before[0]).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / ROW as f32;
    assert!((0.02..0.08).contains(&power.sqrt()) && hot[1..] == before[1..], "{power}");
    let swapped = after(Fault::SwappedChannels { pairs: 1 });
    assert_eq!((&swapped[0], &swapped[1], &swapped[2]), (&before[1], &before[0], &before[2]));
    let clipped = after(Fault::Clipped { gain: 100.0 });
    let cut = clipped.iter().flatten().filter(|value| value.abs() == 1.0).count();
    assert!(cut > CHANNELS * ROW * 9 / 10, "{cut}");
    let slow = after(Fault::RateError { ratio: 2.0 });
    assert_eq!((slow[1][0], slow[1][5], slow[1][40]), (before[1][0], before[1][10], before[1][ROW - 1]));
}

#[test]
fn pdm_bits_swap_and_stick_in_their_places() {
    let words = |fault| {
        let mut faults = faults();
        faults.set(0, Some(fault));
        let mut pings = set(2, SampleFormat::Pdm);
        faults.apply(&mut pings);
        match &*pings.pings[0].samples {
            Samples::Pdm(words) => words.clone(),
            _ => Vec::new(),
        }
    };
    let before = match &*set(2, SampleFormat::Pdm).pings[0].samples {
        Samples::Pdm(words) => words.clone(),
        _ => Vec::new(),
    };
    let swapped = words(Fault::SwappedChannels { pairs: 1 });
    assert!(before.iter().zip(&swapped).all(|(a, b)| a & !3 == b & !3 && a & 1 == b >> 1 & 1 && a >> 1 & 1 == b & 1));
    assert!(words(Fault::StuckChannels { count: 1 }).iter().all(|word| word & 1 == 1));
    assert!(words(Fault::DeadChannels { count: 1 }).windows(2).all(|pair| pair[0] & 1 != pair[1] & 1));
    let overdriven = words(Fault::Clipped { gain: 100.0 });
    assert!(overdriven.chunks(16).all(|block| block.iter().all(|word| *word == block[0])));
}

#[test]
fn a_frozen_sensor_repeats_its_first_samples_under_new_numbers() {
    let mut faults = faults();
    faults.set(1, Some(Fault::Frozen));
    let mut first = set(1, SampleFormat::PcmI16);
    assert!(!faults.apply(&mut first), "the first set is the original");
    for number in 2..5 {
        let mut pings = set(number, SampleFormat::PcmI16);
        assert!(faults.apply(&mut pings));
        assert_eq!(pings.pings[1].samples, first.pings[1].samples);
        assert_eq!(pings.pings[1].sequence, number);
        assert_eq!(pings.pings[0], set(number, SampleFormat::PcmI16).pings[0]);
    }
}

#[test]
fn numbers_left_out_stay_left_out_and_repeated_ones_are_used_again() {
    let mut faults = faults();
    let mut numbers = Vec::new();
    for number in 20..30 {
        match number {
            22 => faults.set(0, Some(Fault::Gaps { missing: 2 })),
            24 => faults.set(0, Some(Fault::Duplicate)),
            26 => faults.set(0, Some(Fault::Backward)),
            28 => faults.clear(),
            _ => {}
        }
        let mut pings = set(number, SampleFormat::PcmF32);
        faults.apply(&mut pings);
        numbers.push(pings.pings[0].sequence);
        assert_eq!(pings.pings[1].sequence, number);
    }
    assert_eq!(numbers, [20, 21, 24, 27, 21, 21, 11, 11, 32, 33]);
}

#[test]
fn stamps_move_and_the_set_is_as_old_as_its_oldest_ping() {
    let after = |fault| {
        let mut faults = faults();
        faults.set(0, Some(fault));
        let mut pings = set(2, SampleFormat::PcmF32);
        faults.apply(&mut pings);
        (pings.pings[0].emitted_at.boottime_ns, pings.emitted_at.boottime_ns, pings.present)
    };
    let both = [true, true, false];
    assert_eq!(after(Fault::Desync { late_ns: 7 }), (2_000_000_007, 2_000_000_000, both));
    assert_eq!(after(Fault::Future { ahead_ns: 9 }), (2_000_000_009, 2_000_000_000, both));
    assert_eq!(after(Fault::Past { behind_ns: 5 }), (1_999_999_995, 1_999_999_995, both));
    assert_eq!(after(Fault::Dropped), (2_000_000_000, 2_000_000_000, [false, true, false]));
}

#[test]
fn the_seed_decides_the_noise() {
    let noise = |seed| {
        let mut faults = Faults::new(&[CHANNELS; 2], seed);
        faults.set(0, Some(Fault::EmitterDead { rms: 0.01 }));
        let mut pings = set(1, SampleFormat::PcmF32);
        faults.apply(&mut pings);
        rows(&pings.pings[0].samples)
    };
    assert_eq!(noise(5), noise(5));
    assert_ne!(noise(5), noise(6));
}
