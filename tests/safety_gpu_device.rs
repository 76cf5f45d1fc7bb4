//! Checks 13 and 14 on a real driver: devices that are destroyed at any moment lose no ping set, a device that never finishes is given up
//! in time, and neither holds up the end. Each test runs itself in a child process, so that a driver that aborts fails one test.
//! Skipped without any adapter, unless `NOCTULE_REQUIRE_GPU=1`.
#![cfg(feature = "gpu")]

mod checks;
mod common;

use checks::{figure, trials};
use common::Random;
use common::gpu::gpu;
use common::lap::Lap;
use common::scenes::{Case, heavy, random_masks};
use noctule::imaging::backend::{Backend, BackendError, BackendKind, Image};
use noctule::imaging::gpu::{AdapterKind, GpuBackend};
use noctule::imaging::plan::ImagingPlan;
use noctule::imaging::quarantine::Trust;
use noctule::imaging::{AGREEMENT_MAX, Imager, Opener, driver_at_work};
use noctule::signal::{MaskTable, PingSet, SampleFormat};
use noctule::time::{ManualClock, Stamp};
use std::collections::BTreeMap;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Names the test that a child process is to run.
const CHILD: &str = "NOCTULE_TEST_IN_CHILD";
const DEADLINE_MS: u64 = 60;
/// What a ping set may take besides: the software adapter computes on the very cores that are measured.
const NOISE: Duration = Duration::from_millis(20);

/// True in the child process that is to run the test `name`; otherwise starts it and demands that it ends well, in time.
fn is_child(name: &str, limit: Duration) -> bool {
    if std::env::var_os(CHILD).is_some() {
        return true;
    }
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", name, "--nocapture"])
        .env(CHILD, "1")
        .spawn()
        .unwrap();
    let deadline = Instant::now() + limit;
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if Instant::now() > deadline => {
                child.kill().unwrap();
                panic!("{name} hangs");
            }
            None => std::thread::sleep(Duration::from_millis(20)),
        }
    };
    assert!(status.success(), "{name}: {status}");
    false
}

type Destroyer = Arc<Mutex<Option<Box<dyn Fn() + Send>>>>;

struct Rig {
    plan: Arc<ImagingPlan>,
    masks: Arc<MaskTable>,
    sets: Vec<PingSet>,
    truths: Vec<Image>,
    destroyer: Destroyer,
    /// The next device is lost as soon as it is open.
    stillborn: Arc<AtomicBool>,
    clock: Arc<ManualClock>,
    sequence: u64,
    slowest: Duration,
}

impl Rig {
    fn new() -> Self {
        let case = Case::standard("losses", SampleFormat::PcmF32, 1, 30);
        let plan = case.plan();
        let masks = random_masks(&plan, 7);
        let sets: Vec<PingSet> = (1..4).map(|seed| case.random_pings(seed)).collect();
        let mut cpu = Imager::with_backends(Arc::clone(&plan), Arc::clone(&masks), None, Some(1), "").unwrap();
        let truths = sets.iter().map(|set| cpu.image(set).unwrap().clone()).collect();
        let clock = Arc::new(ManualClock::new(Stamp { boottime_ns: 1_000_000_000_000, wall_ns: 0 }));
        let (destroyer, stillborn) = (Arc::new(Mutex::new(None)), Arc::new(AtomicBool::new(false)));
        Self { plan, masks, sets, truths, destroyer, stillborn, clock, sequence: 0, slowest: Duration::ZERO }
    }

    fn imager(&self) -> Imager {
        let (plan, masks) = (Arc::clone(&self.plan), Arc::clone(&self.masks));
        let (destroyer, stillborn) = (Arc::clone(&self.destroyer), Arc::clone(&self.stillborn));
        let mut opener: Opener = Box::new(move || -> Result<Box<dyn Backend>, BackendError> {
            let gpu = GpuBackend::open_caught(Arc::clone(&plan), Arc::clone(&masks), true, DEADLINE_MS)?;
            if stillborn.swap(false, Ordering::Relaxed) {
                gpu.destroy_device();
            }
            *destroyer.lock().unwrap() = Some(gpu.destroyer());
            Ok(Box::new(gpu))
        });
        let gpu = opener().unwrap();
        let clock = Arc::clone(&self.clock) as Arc<_>;
        Imager::with_renewal(Arc::clone(&self.plan), Arc::clone(&self.masks), gpu, opener, clock, Some(1)).unwrap()
    }

    /// Images the next ping set and demands that it is right, whoever images it.
    fn frame(&mut self, imager: &mut Imager) -> (BackendKind, Duration) {
        self.sequence += 1;
        let index = self.sequence as usize % self.sets.len();
        self.sets[index].sequence = self.sequence;
        let lap = Lap::start();
        let image = imager.image(&self.sets[index]).expect("no ping set is lost");
        let took = lap.took();
        self.slowest = self.slowest.max(took);
        assert_eq!(image.sequence, self.sequence);
        let truth: Vec<f64> = self.truths[index].energyscapes[0].values.iter().map(|value| f64::from(*value)).collect();
        let distance = common::relative_l2(&image.energyscapes[0].values, &truth);
        assert!(distance <= AGREEMENT_MAX, "ping set {}: {distance:.1e} from the CPU's", self.sequence);
        let kind = image.backend;
        imager.cross_check(&self.sets[index]);
        self.clock.advance_ns(100_000_000);
        (kind, took)
    }

    fn until(&mut self, imager: &mut Imager, wanted: impl Fn(&Imager) -> bool) {
        let limit = Instant::now() + Duration::from_secs(60);
        while !wanted(imager) {
            assert!(Instant::now() < limit, "{:?}: {:?}", imager.trust(), imager.last_failure());
            self.frame(imager);
            if imager.trust() == Some(Trust::Opening) {
                std::thread::sleep(Duration::from_millis(2));
            }
        }
    }
}

#[test]
fn a_hundred_real_losses_lose_no_ping_set() {
    if !gpu() || !is_child("a_hundred_real_losses_lose_no_ping_set", Duration::from_secs(900)) {
        return;
    }
    let losses = trials(100, 5);
    let mut rig = Rig::new();
    let mut imager = rig.imager();
    rig.until(&mut imager, |imager| imager.last_image().backend == BackendKind::Gpu);
    let ordinary = (0..20).map(|_| rig.frame(&mut imager).1).max().unwrap();
    let mut random = Random(1313);
    let mut told: BTreeMap<String, usize> = BTreeMap::new();
    let (mut late, mut most) = (0, Duration::ZERO);
    for loss in 0..losses {
        rig.until(&mut imager, |imager| imager.trust() == Some(Trust::Trusted));
        // A GPU that has imaged well for a while; what was lost before counts no longer. Counted from here: a long rest takes as many.
        let good = rig.sequence + 25;
        while rig.sequence < good {
            rig.frame(&mut imager);
        }
        let lost_before = imager.loss_count();
        rig.stillborn.store(loss % 5 == 4, Ordering::Relaxed);
        let destroy = rig.destroyer.lock().unwrap().take().expect("an open device");
        // At rest, or somewhere in the next ping sets: at upload, submission, map or poll.
        let wait = Duration::from_micros(random.index(2 * ordinary.as_micros() as usize) as u64);
        let killer = if loss % 4 == 0 {
            destroy();
            None
        } else {
            Some(std::thread::spawn(move || {
                std::thread::sleep(wait);
                destroy();
            }))
        };
        let limit = Instant::now() + Duration::from_secs(60);
        let mut late_here = 0;
        while imager.loss_count() == lost_before {
            assert!(Instant::now() < limit, "loss {loss} was never seen");
            let (_, took) = rig.frame(&mut imager);
            late_here += usize::from(took > ordinary + NOISE);
            most = most.max(took);
        }
        if let Some(killer) = killer {
            killer.join().unwrap();
        }
        let why = imager.last_failure().map_or_else(String::new, ToString::to_string);
        *told.entry(why).or_default() += 1;
        late += usize::from(late_here > 1);
    }
    // The test runner takes the driver's libraries apart at its end, as the program does not: nobody may be at work in them.
    drop(imager);
    let limit = Instant::now() + Duration::from_secs(60);
    while driver_at_work() && Instant::now() < limit {
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(!driver_at_work(), "the driver neither opens nor closes in a minute");
    println!("told: {told:#?}");
    figure(13, "ping sets lost in real losses of a device", 0, "0", losses);
    figure(13, "losses with more than one late ping set", late, "0", losses);
    figure(13, "longest ping set while a device is lost, ms", most.as_millis(), "ordinary + 60", losses);
    assert_eq!(late, 0);
    assert!(most <= ordinary + Duration::from_millis(DEADLINE_MS) + 2 * NOISE, "{most:?}, ordinary {ordinary:?}");
}

#[test]
fn a_shader_that_does_not_end_in_time_is_given_up_within_80_ms_and_at_the_end_not_waited_for() {
    let name = "a_shader_that_does_not_end_in_time_is_given_up_within_80_ms_and_at_the_end_not_waited_for";
    if !gpu() || !is_child(name, Duration::from_secs(300)) {
        return;
    }
    let (plan, masks, mut pings) = heavy();
    let mut backend = GpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), true, DEADLINE_MS).unwrap();
    if backend.adapter().kind != AdapterKind::Software {
        println!("skipped: {} may be fast enough", backend.adapter());
        return;
    }
    let mut image = Image::empty(&plan, &masks);
    let count = trials(100, 5);
    let mut worst = Duration::ZERO;
    for trial in 0..count {
        pings.sequence += 1;
        let lap = Lap::start();
        let error = backend.image(&pings, &mut image).expect_err("a software adapter is never so fast");
        worst = worst.max(lap.took());
        assert!(matches!(error, BackendError::Timeout { limit_ms: DEADLINE_MS }), "{trial}: {error}");
    }
    figure(14, "longest wait for a device that is late, ms", worst.as_millis(), "<= 80", count);
    // The device computes on the very cores that this thread waits on.
    assert!(worst <= Duration::from_millis(80) + NOISE, "{worst:?}");
    let mut imager = Imager::with_backends(plan, masks, Some(Box::new(backend)), Some(1), "").unwrap();
    for _ in 0..4 {
        pings.sequence += 1;
        imager.image(&pings).unwrap();
    }
    assert_eq!(imager.trust(), Some(Trust::GivenUp), "three in a row");
    let begin = Instant::now();
    drop(imager);
    figure(14, "end of the imager with work under way, ms", begin.elapsed().as_millis(), "<= 1000", 1);
    assert!(begin.elapsed() <= Duration::from_secs(1));
}
