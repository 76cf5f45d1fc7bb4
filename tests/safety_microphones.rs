//! Contract: one or two bad microphones change nothing that matters, three to eight slow the robot down, more are a fault; dead, stuck
//! and noisy ones alike, within five ping sets.

mod checks;
mod perception_rig;
mod safety_rig;

use checks::{figure, trials};
use noctule::imaging::backend::{Backend, Image};
use noctule::imaging::channels::ChannelFinding;
use noctule::imaging::cpu::CpuBackend;
use noctule::imaging::direct_path::DirectPath;
use noctule::safety::{DaemonState, SensorFindings};
use noctule::service::wiring;
use noctule::signal::{Energyscape, PingSet, RawPing, SampleFormat, Samples, Velocity};
use noctule::sim::{SimParams, World};
use perception_rig::{Random, Rig, config, hall, recorded, row};
use safety_rig::DaemonRig;
use std::sync::Arc;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Bad {
    Zero,
    Stuck,
    /// Ten times the noise of the others: 20 dB.
    Noisy,
}

const KINDS: [Bad; 3] = [Bad::Zero, Bad::Stuck, Bad::Noisy];

fn spoil(set: &mut PingSet, sensor: usize, channels: &[usize], bad: Bad, random: &mut Random) {
    for &channel in channels {
        for value in row(set, sensor, channel) {
            *value = match bad {
                Bad::Zero => 0.0,
                Bad::Stuck => 0.125,
                // The simulator's noise is 1e-3 rms.
                Bad::Noisy => (*value + 1e-2 * random.gaussian()).clamp(-1.0, 1.0),
            };
        }
    }
}

fn some_channels(count: usize, random: &mut Random) -> Vec<usize> {
    let mut all: Vec<usize> = (0..32).collect();
    (0..count).for_each(|place| all.swap(place, place + random.below(32 - place)));
    all.truncate(count);
    all
}

/// State that so many bad channels lead to.
fn expected(count: usize) -> DaemonState {
    match count {
        0..=2 => DaemonState::Active,
        3..=8 => DaemonState::Degraded,
        _ => DaemonState::Fault,
    }
}

#[test]
fn bad_microphones_lead_to_the_right_state_within_five_sets() {
    let config = config();
    let good = recorded(&config, hall(), SimParams::default(), 6, &[]);
    let mut random = Random(28);
    let rounds = trials(30, 1);
    let (mut slowest, mut cases, mut mutants) = (0, 0, 0);
    for round in 0..rounds {
        for count in [1, 2, 3, 8, 9, 16, 32] {
            for bad in KINDS {
                if bad == Bad::Noisy && count == 32 {
                    continue;
                }
                let mut rig = Rig::new(&config);
                rig.drive(&good);
                let sensor = (round + count) % 3;
                let channels = some_channels(count, &mut random);
                let mut last_wrong = 0;
                for set in 1..=8 {
                    let outcome = rig.step(&good[set % 6], |set| spoil(set, sensor, &channels, bad, &mut random));
                    if outcome.output.state != expected(count) {
                        last_wrong = set;
                    }
                    assert!(count <= 8 || outcome.velocity == Velocity::ZERO, "{count} {bad:?}");
                    assert!(count <= 2 || outcome.velocity.linear_m_s <= 0.1, "{count} {bad:?}");
                    // The negative control: bad channels that are not counted.
                    let mut daemon = DaemonRig::in_state(DaemonState::Active);
                    let blind = daemon.group(|group| {
                        group.sensors = outcome.findings;
                        group.sensors.iter_mut().for_each(|findings| {
                            *findings =
                                SensorFindings { bad_channels: 0, direct_path: true, frozen: false, ..*findings };
                            (findings.channel_map_doubted, findings.channel_map_fits) = (false, true);
                        });
                    });
                    mutants += usize::from(blind.state == DaemonState::Active);
                }
                let state = rig.pipeline.daemon();
                assert!(last_wrong < 5, "{count} {bad:?}: {} {} at set {last_wrong}", state.state(), state.reason());
                slowest = slowest.max(last_wrong + 1);
                cases += 1;
            }
        }
    }
    figure(28, "sets until the state is right, slowest", slowest, "<= 5", cases);
    assert_eq!(mutants, 8 * cases, "a daemon that counts no bad channels stays ACTIVE");
}

/// Thirty-two noisy microphones are a noisy place: no channel differs from another. What is then heard everywhere is no free way.
#[test]
fn where_all_microphones_are_noisy_nothing_is_called_free_that_is_not() {
    let config = config();
    let wall = "guidance = false\n[[wall]]\npoints = [[0.55, -2.0], [0.55, 2.0]]\n[start]\n";
    let world = World::parse(std::path::Path::new("near.toml"), wall).expect("world");
    let good = recorded(&config, hall(), SimParams::default(), 6, &[]);
    let near = recorded(&config, world, SimParams { noise_rms: 1e-2, ..SimParams::default() }, 6, &[]);
    let mut rig = Rig::new(&config);
    rig.drive(&good);
    for index in 0..10 {
        let outcome = rig.step(&near[index % 6], |_| {});
        assert!(outcome.velocity.linear_m_s <= 0.0, "{outcome:?}");
    }
}

/// Peak of the front sensor's image beyond a metre: energy and direction.
fn peak(rig: &Rig) -> (f32, f64) {
    peak_of(&rig.pipeline.image().energyscapes[0])
}

fn peak_of(image: &Energyscape) -> (f32, f64) {
    let grid = &image.grid;
    let mut best = (0.0, 0.0);
    for (direction, row) in image.values.chunks_exact(grid.range_count()).enumerate() {
        for (bin, energy) in row.iter().enumerate() {
            if grid.range_m(bin) > 1.0 && *energy > best.0 {
                best = (*energy, grid.directions()[direction].azimuth_rad.to_degrees());
            }
        }
    }
    best
}

#[test]
fn one_or_two_bad_microphones_move_energy_by_a_decibel_and_bearing_by_a_degree_at_most() {
    let config = config();
    let pillar = "guidance = false\n[[pillar]]\ncentre = [1.8, 0.7]\nradius_m = 0.1\n[start]\n";
    let world = World::parse(std::path::Path::new("pillar.toml"), pillar).expect("world");
    let good = recorded(&config, world, SimParams::default(), 2, &[]);
    let runs = trials(300, 12);
    let mut random = Random(2);
    let mut rig = Rig::new(&config);
    for index in 0..6 {
        rig.step(&good[index % 2], |_| {});
    }
    let (energy, bearing_deg) = peak(&rig);
    let (mut most_db, mut most_deg, mut masked) = (0.0_f64, 0.0_f64, 0);
    for run in 0..runs {
        let channels = some_channels(1 + run % 2, &mut random);
        let bad = KINDS[run % 3];
        rig.step(&good[run % 2], |set| spoil(set, 0, &channels, bad, &mut random));
        let gains = &rig.pipeline.image().channels[0].gains;
        masked += channels.iter().filter(|channel| gains[**channel] == 0.0).count();
        let total: f32 = gains.iter().sum();
        assert!((total - 1.0).abs() < 1e-5, "renormalised to {total}");
        let (found, at_deg) = peak(&rig);
        most_db = most_db.max((20.0 * f64::from(found / energy).log10()).abs());
        most_deg = most_deg.max((at_deg - bearing_deg).abs());
        // And none of it is remembered.
        rig.step(&good[(run + 1) % 2], |_| {});
        assert_eq!(rig.pipeline.image().channels[0].used_count(), 32);
    }
    figure(
        28,
        "energy and bearing with one or two bad microphones",
        format!("{most_db:.2} dB, {most_deg:.2} deg"),
        "<= 1 dB, <= 1 deg",
        runs,
    );
    assert!(most_db <= 1.0 && most_deg <= 1.0);
    assert_eq!(masked, (0..runs).map(|run| 1 + run % 2).sum::<usize>(), "every bad channel was left out");
    // The negative control: eight dead channels that keep their weight lose more.
    let setup = rig.pipeline.setup();
    let masks = wiring::masks(&config, setup).expect("masks");
    let mut backend = CpuBackend::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), Some(1)).expect("CPU");
    let mut image = Image::empty(&setup.plan, masks.table());
    let mut set = good[0].clone();
    spoil(&mut set, 0, &[0, 1, 2, 3, 4, 5, 6, 7], Bad::Zero, &mut random);
    backend.image(&set, &mut image).expect("imaged");
    let lost_db = 20.0 * f64::from(peak_of(&image.energyscapes[0]).0 / energy).log10();
    assert!(lost_db < -1.0, "{lost_db}");
}

/// Bits and rows of some channels taken from a simulator with ten times the noise.
fn spliced(quiet: &Samples, noisy: &Samples, channels: &[usize]) -> Samples {
    match (quiet, noisy) {
        (Samples::Pdm(quiet), Samples::Pdm(noisy)) => {
            let mask = channels.iter().fold(0, |mask, channel| mask | 1 << channel);
            Samples::Pdm(quiet.iter().zip(noisy).map(|(quiet, noisy)| quiet & !mask | noisy & mask).collect())
        }
        (Samples::PcmI16(quiet), Samples::PcmI16(noisy)) => {
            let count = quiet.len() / 32;
            let pick = |index: usize| if channels.contains(&(index / count)) { noisy[index] } else { quiet[index] };
            Samples::PcmI16((0..quiet.len()).map(pick).collect())
        }
        _ => panic!("PDM or 16-bit PCM"),
    }
}

#[test]
fn noisy_microphones_are_told_by_name_in_every_format() {
    let mut random = Random(282);
    let mut cases = 0;
    for format in [SampleFormat::Pdm, SampleFormat::PcmI16] {
        let mut config = config();
        config.recording.format = format;
        let setup = wiring::sensing(&config).expect("setup");
        let quiet = recorded(&config, hall(), SimParams::default(), 5, &[]);
        let noisy = recorded(&config, hall(), SimParams { noise_rms: 1e-2, ..SimParams::default() }, 5, &[]);
        for count in [1, 2, 8, 16] {
            let mut channels = some_channels(count, &mut random);
            channels.sort_unstable();
            let mut path = DirectPath::new(&setup.plan, &setup.sensors, setup.speed_of_sound_m_s);
            for set in 0..5 {
                let (good, bad) = (&quiet[set].pings[0], &noisy[set].pings[0]);
                let samples = Arc::new(spliced(&good.samples, &bad.samples, &channels));
                path.listen(&setup.plan, &RawPing { samples, ..good.clone() });
            }
            let told: Vec<usize> = (0..32).filter(|k| path.unfit(0)[*k] != ChannelFinding::Good).collect();
            assert_eq!(told, channels, "{format:?}");
            cases += 1;
        }
    }
    figure(28, "noisy channels of PDM and 16 bits told by name after five sets", "all, no other", "all", cases);
}
