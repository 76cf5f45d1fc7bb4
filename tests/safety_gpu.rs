//! Checks 13, 14 and 15 without a device: whatever a GPU does, its ping set is imaged, in time and rightly; it rests, is opened anew
//! and compared before it is trusted; values that are wrong are found within 5 s; nothing that hangs holds anything up.

mod checks;
mod common;

use checks::{figure, trials};
use common::Random;
use common::lap::Lap;
use common::scenes::{Case, random_masks};
use noctule::imaging::backend::{Backend, BackendError, BackendKind, Image};
use noctule::imaging::cpu::CpuBackend;
use noctule::imaging::drill::{DeviceFault, Drill, FaultPlan};
use noctule::imaging::plan::ImagingPlan;
use noctule::imaging::quarantine::Trust;
use noctule::imaging::{CHECK_EVERY, CrossCheck, Imager, Opener};
use noctule::signal::{MaskTable, PingSet, SampleFormat};
use noctule::time::{ManualClock, Stamp};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

const PERIOD_NS: u64 = 100_000_000;
const SECOND_NS: u64 = 1_000_000_000;
/// The GPU's deadline: how much later than otherwise a ping set may be that is done again.
const LATE_MAX: Duration = Duration::from_millis(60);
/// What a ping set may take besides: caches that other programs have emptied.
const NOISE: Duration = Duration::from_millis(20);

/// One sensor, nine directions, four ping sets and the CPU's images of them.
struct Scene {
    plan: Arc<ImagingPlan>,
    masks: Arc<MaskTable>,
    sets: Vec<PingSet>,
    truths: Vec<Image>,
    clock: Arc<ManualClock>,
    sequence: u64,
}

impl Scene {
    fn new() -> Self {
        let case = Case::standard("quarantine", SampleFormat::PcmF32, 1, 20);
        let plan = case.plan();
        let masks = random_masks(&plan, 7);
        let sets: Vec<PingSet> = (1..5).map(|seed| case.random_pings(seed)).collect();
        let mut cpu = Imager::with_backends(Arc::clone(&plan), Arc::clone(&masks), None, Some(1), "reference").unwrap();
        let truths = sets.iter().map(|set| cpu.image(set).unwrap().clone()).collect();
        let clock = Arc::new(ManualClock::new(Stamp { boottime_ns: 1000 * SECOND_NS, wall_ns: 0 }));
        Self { plan, masks, sets, truths, clock, sequence: 0 }
    }

    fn device(&self, plan: FaultPlan) -> Drill {
        drill(&self.plan, &self.masks, plan)
    }

    fn imager(&self, first: Drill, opener: Opener) -> Imager {
        let clock = Arc::clone(&self.clock) as Arc<_>;
        let (plan, masks) = (Arc::clone(&self.plan), Arc::clone(&self.masks));
        Imager::with_renewal(plan, masks, Box::new(first), opener, clock, Some(1)).unwrap()
    }

    /// An opener whose devices have the faults of `plan`, and the count of those opened.
    fn opener(&self, mut plan: impl FnMut(u32) -> FaultPlan + Send + 'static) -> (Opener, Arc<AtomicU32>) {
        let (sizes, masks) = (Arc::clone(&self.plan), Arc::clone(&self.masks));
        let count = Arc::new(AtomicU32::new(0));
        let counter = Arc::clone(&count);
        let open = move || -> Result<Box<dyn Backend>, BackendError> {
            let number = counter.fetch_add(1, Ordering::Relaxed);
            Ok(Box::new(drill(&sizes, &masks, plan(number))))
        };
        (Box::new(open), count)
    }

    /// Images the next ping set, its command goes out, the backends are compared, a tenth of a second passes. Whatever images,
    /// the image is right: this asserts it. Says which backend it was, how long the image took and what the comparison found.
    fn frame(&mut self, imager: &mut Imager) -> (BackendKind, Duration, CrossCheck) {
        let (kind, took, found, wrong) = self.frame_as_it_is(imager);
        assert!(!wrong, "ping set {}: {kind:?} gave a wrong image", self.sequence);
        (kind, took, found)
    }

    fn frame_as_it_is(&mut self, imager: &mut Imager) -> (BackendKind, Duration, CrossCheck, bool) {
        self.sequence += 1;
        let index = self.sequence as usize % self.sets.len();
        self.sets[index].sequence = self.sequence;
        let lap = Lap::start();
        let image = imager.image(&self.sets[index]).expect("no ping set is lost");
        let took = lap.took();
        assert_eq!(image.sequence, self.sequence);
        let truth = &self.truths[index];
        let wrong = image.energyscapes[0].values != truth.energyscapes[0].values || image.sums != truth.sums;
        let kind = image.backend;
        let found = imager.cross_check(&self.sets[index]);
        self.clock.advance_ns(PERIOD_NS);
        (kind, took, found, wrong)
    }

    /// Goes on until the GPU is trusted so; a device is opened in another thread, in real time.
    fn frames_until(&mut self, imager: &mut Imager, wanted: impl Fn(Trust) -> bool) -> u32 {
        let limit = Instant::now() + Duration::from_secs(20);
        let mut count = 0;
        while !imager.trust().is_some_and(&wanted) {
            assert!(Instant::now() < limit, "{:?} for 20 s", imager.trust());
            self.frame(imager);
            count += 1;
            if imager.trust() == Some(Trust::Opening) {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        count
    }
}

fn drill(plan: &Arc<ImagingPlan>, masks: &Arc<MaskTable>, faults: FaultPlan) -> Drill {
    let cpu = CpuBackend::open(Arc::clone(plan), Arc::clone(masks), Some(1)).unwrap();
    Drill::new(Box::new(cpu), faults)
}

fn sound() -> FaultPlan {
    Box::new(|_| None)
}

/// A fault at one ping set of the device.
fn at(number: u64, fault: DeviceFault) -> FaultPlan {
    Box::new(move |count| (count == number).then_some(fault))
}

/// A fault from one ping set of the device on.
fn from(number: u64, fault: DeviceFault) -> FaultPlan {
    Box::new(move |count| (count >= number).then_some(fault))
}

#[test]
fn a_hundred_losses_lose_no_ping_set_and_make_at_most_one_each_late() {
    let mut scene = Scene::new();
    let losses = trials(100, 10) as u32;
    let mut random = Random(13);
    // Every device lives for 35 to 54 ping sets, then is lost, at once or at its deadline.
    let mut fate = move |_| {
        let number = 35 + random.index(20) as u64;
        let late = random.index(2) == 1;
        let fault: FaultPlan = Box::new(move |count| match (count.checked_sub(number), late) {
            (Some(0), true) => Some(DeviceFault::Late(LATE_MAX)),
            (Some(0), false) | (Some(1), true) => Some(DeviceFault::Lost),
            _ => None,
        });
        fault
    };
    let first = scene.device(fate(0));
    let (opener, opened) = scene.opener(fate);
    let mut imager = scene.imager(first, opener);
    let ordinary = (0..20).map(|_| scene.frame(&mut imager).1).max().unwrap();
    let (mut frames, mut late, mut most) = (0, 0_u32, Duration::ZERO);
    while imager.loss_count() < u64::from(losses) {
        let (_, took, _) = scene.frame(&mut imager);
        frames += 1;
        late += u32::from(took > ordinary + NOISE);
        most = most.max(took);
        if imager.trust() == Some(Trust::Opening) {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    figure(13, "ping sets lost", 0, "0", losses as usize);
    figure(13, "ping sets late", late, "at most one a loss", losses as usize);
    let by_ms = most.saturating_sub(ordinary).as_millis();
    figure(13, "lateness of the latest, ms", by_ms, "<= 60 and the machine's noise", losses as usize);
    assert!(frames > 35 * losses && opened.load(Ordering::Relaxed) >= losses - 1);
    assert!(late <= losses, "{late} late ping sets in {losses} losses");
    assert!(most <= ordinary + LATE_MAX + 2 * NOISE, "{most:?} after {ordinary:?}");
}

#[test]
fn a_device_that_is_lost_again_and_again_is_opened_after_1_2_4_and_8_s_and_then_no_more() {
    let mut scene = Scene::new();
    let (opener, opened) = scene.opener(|_| from(0, DeviceFault::Lost));
    let mut imager = scene.imager(scene.device(from(3, DeviceFault::Lost)), opener);
    let mut rests_s = Vec::new();
    while let Some(trust) = imager.trust().filter(|trust| *trust != Trust::GivenUp) {
        if trust == Trust::Trusted {
            scene.frame(&mut imager);
        } else {
            let frames = scene.frames_until(&mut imager, |trust| !matches!(trust, Trust::Resting { .. }));
            rests_s.push(frames / 10);
            scene.frames_until(&mut imager, |trust| matches!(trust, Trust::Resting { .. } | Trust::GivenUp));
        }
    }
    assert_eq!(rests_s, [1, 2, 4, 8]);
    figure(13, "losses without a good image until the CPU images for good", imager.loss_count(), "5", 1);
    assert_eq!(imager.loss_count(), 5);
    let report = imager.report().clone();
    assert!(report.kind == BackendKind::Cpu && report.reason.contains("for good after 5 losses"), "{report:?}");
    for _ in 0..60 {
        scene.clock.advance_ns(60 * SECOND_NS);
        scene.frame(&mut imager);
    }
    assert_eq!(opened.load(Ordering::Relaxed), 4, "an hour later nothing was opened again");
}

#[test]
fn three_late_ping_sets_in_a_row_rest_the_gpu_and_nobody_waits_longer_than_80_ms() {
    let count = trials(100, 6);
    let mut worst = Duration::ZERO;
    let mut scene = Scene::new();
    for _ in 0..count {
        let (opener, _) = scene.opener(|_| sound());
        let mut imager = scene.imager(scene.device(from(2, DeviceFault::Late(LATE_MAX))), opener);
        for number in 0..5 {
            assert_eq!(imager.trust(), Some(Trust::Trusted), "ping set {number}");
            let (kind, took, _) = scene.frame(&mut imager);
            assert_eq!(kind == BackendKind::Gpu, number < 2);
            worst = worst.max(took);
        }
        assert!(matches!(imager.trust(), Some(Trust::Resting { .. })));
        let (_, took, _) = scene.frame(&mut imager);
        assert!(took < LATE_MAX, "{took:?}: a GPU that rests is not asked");
        assert!(imager.report().reason.contains("a new device is tried in 1 s"), "{}", imager.report().reason);
        scene.frames_until(&mut imager, |trust| trust == Trust::Trusted);
        assert_eq!(scene.frame(&mut imager).0, BackendKind::Gpu);
        assert!(imager.report().reason.contains("opened anew"), "{}", imager.report().reason);
    }
    figure(14, "longest wait for a ping set, ms", worst.as_millis(), "<= 80", count);
    assert!(worst <= Duration::from_millis(80), "{worst:?}");
}

/// Negative control: a device that is waited for longer than it may take is seen to.
#[test]
fn a_longer_wait_would_be_noticed() {
    let mut scene = Scene::new();
    let (opener, _) = scene.opener(|_| sound());
    let mut imager = scene.imager(scene.device(at(1, DeviceFault::Late(3 * LATE_MAX))), opener);
    let worst = (0..3).map(|_| scene.frame(&mut imager).1).max().unwrap();
    assert!(worst > Duration::from_millis(80), "{worst:?}");
}

/// What never comes back must hold up neither ping sets nor the end: closing, or opening, takes a minute here.
#[test]
fn a_device_that_hangs_while_it_is_closed_or_opened_holds_up_neither_ping_sets_nor_the_end() {
    const HANG: Duration = Duration::from_secs(60);
    let mut scene = Scene::new();
    let (closing, _) = scene.opener(|_| sound());
    let hanging: Opener = Box::new(|| {
        std::thread::sleep(HANG);
        Err(BackendError::Unavailable("too late".to_owned()))
    });
    for (what, opener) in [("closing", closing), ("opening", hanging)] {
        let first = scene.device(at(1, DeviceFault::Lost)).closing_in(HANG);
        let mut imager = scene.imager(first, opener);
        let worst = (0..40).map(|_| scene.frame(&mut imager).1).max().unwrap();
        assert!(worst < LATE_MAX, "{what}: {worst:?} for a ping set");
        let begin = Instant::now();
        drop(imager);
        let end = begin.elapsed();
        figure(14, &format!("end of the imager while {what} hangs, ms"), end.as_millis(), "<= 1000", 1);
        assert!(end <= Duration::from_secs(1), "{what}: {end:?}");
    }
    // One that hangs at the very end, in use until then.
    let (opener, _) = scene.opener(|_| sound());
    let imager = scene.imager(scene.device(sound()).closing_in(HANG), opener);
    let begin = Instant::now();
    drop(imager);
    assert!(begin.elapsed() <= Duration::from_secs(1));
}

#[test]
fn what_shows_by_itself_is_imaged_again_in_the_same_ping_set() {
    let faults = [
        DeviceFault::Lost,
        DeviceFault::OutOfMemory,
        DeviceFault::Refused,
        DeviceFault::Skipped,
        DeviceFault::Zeros,
        DeviceFault::NotANumber,
    ];
    let count = trials(600, 60);
    let mut random = Random(15);
    let mut scene = Scene::new();
    for trial in 0..count {
        let fault = faults[trial % faults.len()];
        let number = random.index(8) as u64;
        let (opener, _) = scene.opener(|_| sound());
        let mut imager = scene.imager(scene.device(at(number, fault)), opener);
        for frame in 0..=number {
            // `frame` asserts that the image is right.
            let (kind, ..) = scene.frame(&mut imager);
            assert_eq!(kind == BackendKind::Cpu, frame == number, "{fault:?} at {number}: {frame}");
        }
        assert_eq!(imager.redone_count(), 1);
    }
    figure(15, "faults that show by themselves, imaged again in the same ping set", count, "all", count);
}

/// Ping sets from the first wrong image that was used to the one at which `compare` says so, if it does so in 20 s.
fn found_after(scene: &mut Scene, imager: &mut Imager, compare: bool) -> Option<u32> {
    let mut wrong_since = None;
    for number in 0..200 {
        let (wrong, found) = if compare {
            let (_, _, found, wrong) = scene.frame_as_it_is(imager);
            (wrong, found)
        } else {
            scene.sequence += 1;
            let index = scene.sequence as usize % scene.sets.len();
            scene.sets[index].sequence = scene.sequence;
            let wrong = imager.image(&scene.sets[index]).unwrap().sums != scene.truths[index].sums;
            scene.clock.advance_ns(PERIOD_NS);
            (wrong, CrossCheck::NotDue)
        };
        if wrong {
            wrong_since.get_or_insert(number);
        }
        if found == CrossCheck::Mismatch {
            return Some(number + 1 - wrong_since.expect("a right image was called wrong"));
        }
    }
    None
}

#[test]
fn wrong_values_that_look_right_are_found_within_5_s_and_only_by_the_comparison() {
    let count = trials(300, 12);
    let mut random = Random(50);
    let mut scene = Scene::new();
    let mut most = 0;
    for trial in 0..count {
        let fault = [DeviceFault::Stale, DeviceFault::TooLarge(0.01), DeviceFault::TooLarge(-0.01)][trial % 3];
        let (opener, _) = scene.opener(|_| sound());
        let first = 1 + random.index(70) as u64;
        let mut imager = scene.imager(scene.device(from(first, fault)), opener);
        let found = found_after(&mut scene, &mut imager, true);
        most = most.max(found.unwrap_or(u32::MAX));
        assert!(!matches!(imager.trust(), Some(Trust::Trusted)), "{fault:?} is still trusted");
        assert!(imager.report().reason.contains("away from the CPU's"), "{}", imager.report().reason);
    }
    let seconds = f64::from(most) * PERIOD_NS as f64 * 1e-9;
    figure(15, "wrong values found after, s", seconds, "<= 5", count);
    assert!(most <= CHECK_EVERY, "{most} ping sets");
    // Negative control: without the comparison they are used for ever.
    let (opener, _) = scene.opener(|_| sound());
    let mut imager = scene.imager(scene.device(from(1, DeviceFault::TooLarge(0.01))), opener);
    assert_eq!(found_after(&mut scene, &mut imager, false), None);
}

#[test]
fn a_sound_gpu_is_never_called_wrong() {
    let mut scene = Scene::new();
    let (opener, _) = scene.opener(|_| sound());
    let mut imager = scene.imager(scene.device(sound()), opener);
    let count = trials(100_000, 3000);
    let mut compared = 0;
    for _ in 0..count {
        let (kind, _, found) = scene.frame(&mut imager);
        assert_eq!(kind, BackendKind::Gpu);
        assert_ne!(found, CrossCheck::Mismatch);
        compared += usize::from(found == CrossCheck::Passed);
    }
    assert_eq!(compared, count / CHECK_EVERY as usize);
}

#[test]
fn a_new_device_that_images_wrongly_is_never_used() {
    let mut scene = Scene::new();
    let (opener, opened) =
        scene.opener(|number| if number < 2 { from(0, DeviceFault::TooLarge(0.01)) } else { sound() });
    let mut imager = scene.imager(scene.device(from(2, DeviceFault::Lost)), opener);
    scene.frame(&mut imager);
    scene.frame(&mut imager);
    scene.frame(&mut imager);
    // `frame` asserts that no image used is wrong, all the way to the third new device.
    scene.frames_until(&mut imager, |trust| trust == Trust::Trusted);
    assert_eq!((opened.load(Ordering::Relaxed), imager.loss_count()), (3, 3));
    assert_eq!(scene.frame(&mut imager).0, BackendKind::Gpu);
    // Negative control: the same device as the first one, where nothing stands before its use, gives wrong images.
    let (opener, _) = scene.opener(|_| sound());
    let mut imager = scene.imager(scene.device(from(0, DeviceFault::TooLarge(0.01))), opener);
    assert!(scene.frame_as_it_is(&mut imager).3);
}

#[test]
fn a_driver_that_shows_no_adapter_for_a_while_is_waited_for() {
    let mut scene = Scene::new();
    let (plan, masks) = (Arc::clone(&scene.plan), Arc::clone(&scene.masks));
    let tries = Arc::new(AtomicU64::new(0));
    let counter = Arc::clone(&tries);
    let opener: Opener = Box::new(move || {
        if counter.fetch_add(1, Ordering::Relaxed) < 7 {
            return Err(BackendError::Unavailable("there is no adapter".to_owned()));
        }
        Ok(Box::new(drill(&plan, &masks, sound())))
    });
    let mut imager = scene.imager(scene.device(from(1, DeviceFault::Lost)), opener);
    scene.frame(&mut imager);
    scene.frame(&mut imager);
    let begin_ns = noctule::time::Clock::now(&*scene.clock).boottime_ns;
    scene.frames_until(&mut imager, |trust| trust == Trust::Trusted);
    let waited_s = (noctule::time::Clock::now(&*scene.clock).boottime_ns - begin_ns) / SECOND_NS;
    assert_eq!(tries.load(Ordering::Relaxed), 8);
    // 1 + 2 + 4 + 8 + 16 + 32 + 60 + 60 s, and a few ping sets while each is opened.
    assert!((183..260).contains(&waited_s), "{waited_s} s");
}
