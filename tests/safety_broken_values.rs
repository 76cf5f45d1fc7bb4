//! Contract: no value that is no number, wherever it enters (samples, a backend's result, gains, the wanted velocity), ever makes a
//! way free or a command that is not finite; what breaks an image stops the robot within Z1.

mod checks;
mod perception_rig;

use checks::{figure, trials};
use noctule::config::Config;
use noctule::control::{ControlParams, Controller, PlatformLimits};
use noctule::imaging::backend::{Backend, BackendError, BackendKind, BackendReport, Image, Stage, StageOutput};
use noctule::imaging::channels::{ChannelFinding, ChannelReport};
use noctule::imaging::cpu::CpuBackend;
use noctule::safety::{DaemonState, Reason};
use noctule::service::wiring;
use noctule::signal::{CoverageCue, Cues, PingSet, RowSums, SENSORS_MAX, Samples, Velocity};
use noctule::sim::SimParams;
use noctule::time::Stamp;
use perception_rig::{MS, Random, Rig, config, hall, recorded};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

/// What is no honest number, or only just one.
const VALUES: [f32; 10] =
    [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -1e38, 1e-40, -1e-40, -0.0, f32::MIN_POSITIVE];

fn value(random: &mut Random) -> f32 {
    // Any NaN is one.
    match random.below(12) {
        10 => f32::from_bits(0x7f80_0001 + random.next() as u32 % 0x007f_fffe),
        11 => f32::from_bits(0xff80_0001 + random.next() as u32 % 0x007f_fffe),
        index => VALUES[index],
    }
}

fn quick() -> Config {
    let mut config = config();
    config.recording.samples = Some(8192);
    config.imaging.range_max_m = 2.5;
    config
}

/// The CPU's backend, posing as a GPU whose results are spoilt on the way back.
struct Spoilt {
    inner: CpuBackend,
    report: BackendReport,
    spoil: Arc<Mutex<Option<(f32, usize)>>>,
}

impl Backend for Spoilt {
    fn image(&mut self, pings: &PingSet, image: &mut Image) -> Result<(), BackendError> {
        self.inner.image(pings, image)?;
        image.backend = BackendKind::Gpu;
        if let Some((value, place)) = self.spoil.lock().expect("lock").take() {
            let row = place / 4 % image.sums.len();
            let sums = &mut image.sums[row];
            *[&mut sums.energy, &mut sums.turn, &mut sums.flow, &mut sums.peak][place % 4] = value;
            let cells = &mut image.energyscapes[place % 3].values;
            let cell = place % cells.len();
            cells[cell] = value;
        }
        Ok(())
    }

    fn image_up_to(&mut self, _: Stage, _: &PingSet, _: usize, _: &mut Image) -> Result<StageOutput, BackendError> {
        Err(BackendError::Unavailable("not here".to_owned()))
    }

    fn stage_times_ns(&self) -> [u64; Stage::ALL.len()] {
        [0; Stage::ALL.len()]
    }

    fn report(&self) -> &BackendReport {
        &self.report
    }
}

fn spoilt_rig(config: &Config) -> (Rig, Arc<Mutex<Option<(f32, usize)>>>) {
    let spoil = Arc::new(Mutex::new(None));
    let handle = Arc::clone(&spoil);
    let rig = Rig::with_backend(config, move |setup, masks| {
        let inner = CpuBackend::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), Some(1)).expect("CPU");
        let report = BackendReport { kind: BackendKind::Gpu, ..inner.report().clone() };
        Some(Box::new(Spoilt { inner, report, spoil: handle }))
    });
    (rig, spoil)
}

#[test]
fn a_result_that_is_no_number_is_imaged_again_on_the_cpu_and_never_followed() {
    let config = quick();
    let good = recorded(&config, hall(), SimParams::default(), 6, &[]);
    let runs = trials(3_000, 40);
    let mut random = Random(2);
    let (mut followed, mut met, mut driving) = (0, 0, 0);
    let (mut rig, mut spoil) = spoilt_rig(&config);
    rig.drive(&good);
    for run in 0..runs {
        let value = value(&mut random);
        *spoil.lock().expect("lock") = Some((value, random.next() as usize));
        let moved = rig.told.last().is_none_or(|(_, velocity)| velocity.linear_m_s > 0.0);
        let outcome = rig.step(&good[run % 6], |_| {});
        // Taken by the backend, unless that rests after three failures.
        let reached = spoil.lock().expect("lock").take().is_none();
        let image = rig.pipeline.image();
        let finite = image.energyscapes.iter().flat_map(|scape| &scape.values).all(|cell| cell.is_finite());
        if !value.is_finite() && reached {
            met += 1;
            driving += usize::from(moved);
            followed += usize::from(!finite || image.backend != BackendKind::Cpu);
        }
        assert!(outcome.velocity.is_finite() && outcome.velocity.linear_m_s <= 0.3, "{value}: {:?}", outcome.output);
        rig.step(&good[(run + 1) % 6], |_| {});
        // A backend that failed three times rests: on with another.
        if run % 4 == 3 {
            (rig, spoil) = spoilt_rig(&config);
            rig.drive(&good);
        }
    }
    figure(2, "backend results that are no numbers and were followed", followed, "0", met);
    assert!(followed == 0 && met >= 3 && driving >= 3, "{followed} followed of {met}, {driving} while driving");
}

#[test]
fn samples_that_are_no_numbers_never_make_a_way_free() {
    let config = quick();
    let good = recorded(&config, hall(), SimParams::default(), 6, &[]);
    let runs = trials(3_000, 40);
    let mut random = Random(22);
    let mut rig = Rig::new(&config);
    rig.drive(&good);
    let (mut values, mut stopped) = (0, 0);
    for run in 0..runs {
        let (sensor, channels) = (random.below(3), 1 + random.below(32));
        let bad = value(&mut random);
        let outcome = rig.step(&good[run % 6], |set| {
            for channel in 0..channels {
                let place = random.below(8192);
                perception_rig::row(set, sensor, channel)[place] = bad;
            }
        });
        values += channels;
        let broken = !bad.is_finite() || bad.abs() > 1e4;
        assert!(outcome.velocity.is_finite());
        let image = rig.pipeline.image();
        let finite = image.energyscapes.iter().all(|scape| scape.values.iter().all(|value| value.is_finite()));
        assert!(finite, "{bad} on {channels} channels of {sensor}");
        if broken {
            assert_eq!(outcome.findings[sensor].bad_channels, channels, "{bad}");
            assert!(channels <= 8 || outcome.velocity == Velocity::ZERO, "{bad} on {channels} channels");
            assert!(channels <= 2 || outcome.velocity.linear_m_s <= 0.1, "{bad} on {channels} channels");
        }
        stopped += usize::from(outcome.velocity == Velocity::ZERO);
        if rig.pipeline.daemon().state() == DaemonState::Fault {
            rig.drive_again(&good);
        }
    }
    assert!(rig.told.iter().all(|(_, velocity)| velocity.is_finite()));
    figure(2, "samples that are no numbers: commands not finite or free", 0, "0", values);
    assert!(stopped > 3);
}

#[test]
fn sums_and_wanted_velocities_that_are_no_numbers_never_move_the_robot() {
    let config = Config::default();
    let setup = wiring::sensing(&config).expect("setup");
    let masks = wiring::masks(&config, &setup).expect("masks");
    let used = [true; SENSORS_MAX];
    let quiet = vec![RowSums::SILENT; masks.table().rows.len()];
    let count = trials(600_000, 2_000);
    let mut random = Random(222);
    let mut controller = Controller::new(&config.control, &config.platform);
    let (mut now_ns, mut mutants) = (1_000_000 * MS, 0);
    for _ in 0..count {
        now_ns += 100 * MS;
        let now = Stamp { boottime_ns: now_ns, wall_ns: 0 };
        let bad = value(&mut random);
        let spoils_sums = random.below(10) == 0;
        let mut wanted = Velocity::forward_m_s(0.3);
        let cues = if spoils_sums {
            let mut sums = quiet.clone();
            let place = random.below(sums.len());
            let row = &mut sums[place];
            *[&mut row.energy, &mut row.turn, &mut row.flow, &mut row.peak][random.below(4)] = bad;
            let sums_are_broken = !bad.is_finite();
            let cues = masks.fuse(&sums, used, now, 0);
            let broken = masks.broken_sensors(&sums);
            assert!(!sums_are_broken || broken.contains(&true), "{bad}");
            assert!(
                !sums_are_broken || (cues.coverage == CoverageCue::default() && cues.collision.energy == f32::INFINITY)
            );
            cues
        } else {
            let other = f64::from(value(&mut random));
            wanted = [
                Velocity { linear_m_s: f64::from(bad), angular_rad_s: 0.1 },
                Velocity { linear_m_s: 0.3, angular_rad_s: f64::from(bad) },
                Velocity { linear_m_s: f64::from(bad), angular_rad_s: other },
            ][random.below(3)];
            Cues {
                emitted_at: now,
                sensors_used: used,
                coverage: CoverageCue { ahead_m: 3.0, behind_m: 3.0 },
                ..Cues::default()
            }
        };
        let decided = controller.step(now, &cues, wanted).velocity;
        assert!(decided.is_finite() && decided.linear_m_s.abs() <= config.platform.max_linear_m_s, "{decided:?}");
        assert!(wanted.is_finite() || decided == Velocity::ZERO, "{wanted:?} gives {decided:?}");
        assert!(!spoils_sums || bad.is_finite() || decided.linear_m_s <= 0.0, "{bad} gives {decided:?}");
        // The negative control: a comparison that NaN slips through.
        let careless = |limit: f64| if f64::from(bad) > limit { 0.0 } else { 0.3 };
        mutants += usize::from(bad.is_nan() && careless(0.3) > 0.0);
    }
    figure(2, "sums and wanted velocities: commands not finite or forward", 0, "0", count);
    assert!(mutants > count / 20, "a careless comparison drives on NaN");
}

#[test]
fn raw_rows_that_are_no_numbers_are_found_by_their_bits() {
    let mut config = config();
    config.recording.samples = Some(1200);
    config.imaging.range_max_m = 0.4;
    let setup = wiring::sensing(&config).expect("setup");
    let channels = 32;
    let mut samples = vec![0.0_f32; channels * 1200];
    let mut random = Random(2_222);
    samples.iter_mut().for_each(|sample| *sample = 0.1 * random.uniform());
    let mut report = ChannelReport::new(channels);
    let count = trials(400_000, 13_000) / channels;
    let found = AtomicU32::new(0);
    for _ in 0..count {
        let mut spoilt = samples.clone();
        let bad: Vec<(usize, f32)> =
            (0..channels).map(|channel| (channel * 1200 + random.below(1200), value(&mut random))).collect();
        bad.iter().for_each(|(place, bad)| spoilt[*place] = *bad);
        report.judge(&setup.plan, 0, &Samples::PcmF32(spoilt));
        for (finding, (_, bad)) in report.findings.iter().zip(&bad) {
            let broken = !bad.is_finite() || bad.abs() > 1e4;
            assert_eq!(*finding == ChannelFinding::NotFinite, broken, "{bad}");
            found.fetch_add(1, Ordering::Relaxed);
        }
        assert!(report.gains.iter().all(|gain| gain.is_finite()));
    }
    figure(
        2,
        "channels with a value that is no number and not found, or found where none is",
        0,
        "0",
        found.into_inner() as usize,
    );
}

#[test]
fn gains_and_limits_that_are_no_numbers_are_refused() {
    let keys = [
        "obstacle_avoidance.lambda",
        "obstacle_avoidance.mu",
        "flow_following.lambda",
        "collision_avoidance.threshold",
    ];
    let mut refused = 0;
    for key in keys {
        for bad in ["nan", "-nan", "inf", "-inf", "-1e38"] {
            let text = format!("[control]\n{key} = {bad}\n");
            let params =
                toml::from_str::<toml::Table>(&text).expect("TOML")["control"].clone().try_into::<ControlParams>();
            let accepted = params.is_ok_and(|params| params.validate().is_ok());
            assert!(!accepted, "{key} = {bad}");
            refused += 1;
        }
    }
    assert!(ControlParams::for_platform(&PlatformLimits::default()).validate().is_ok(), "and the default is not");
    figure(2, "gains that are no numbers accepted", 0, "0", refused);
    assert_ne!(Reason::PingRejected, Reason::None);
}
