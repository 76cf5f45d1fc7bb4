//! The soak: a simulated robot of the configured sensors drives round and round, something goes wrong every minute, and the scoreboard says
//! whether it stopped in time, stood as long as it had to, went on when it might, and never moved when it must not.
//!
//! Goes in: a robot, a world, [`SoakOptions`]. Comes out: a [`Summary`]. What decides is the daemon's pipeline and the controller's gate
//! ([`mod@super::drive`]); the GPU is a drill on the CPU, so that it can fail too. The simulated time is the only clock: equal options
//! give equal runs, bit by bit.

mod footprint;
mod score;
mod troubles;

pub use footprint::Footprint;
pub use score::{
    FALSE_STOP_MAX, GROWTH_MAX_KIB, HOLD_MIN, OfOne, RESUME_MAX_S, RETURN_MAX_S, STOP_MAX_S, Scorer, Summary, Tick,
};
pub use troubles::{Case, Demand, Trouble, catalogue};

use super::ServiceError;
use super::drive::{CLOCK_START_NS, Drive};
use super::trial::TrialRig;
use crate::imaging::backend::{Backend, BackendError, BackendReport, Image, Stage, StageOutput, StageTimes};
use crate::imaging::cpu::CpuBackend;
use crate::imaging::drill::{DeviceFault, Drill};
use crate::imaging::quarantine::Trust;
use crate::imaging::{Imager, Opener};
use crate::safety::OperatorEvent;
use crate::signal::{DaemonState, GateState, PingSet, SENSORS_MAX, Velocity};
use crate::sim::{Faults, SimParams, World};
use crate::time::{ManualClock, Stamp};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

const SECOND_NS: u64 = 1_000_000_000;
/// Ping sets that the self-test and arming may take.
const START_SETS_MAX: u32 = 100;
/// An operator needs this long to see that the trouble is over.
const OPERATOR_NS: u64 = SECOND_NS / 2;
/// Longest real time to open a device: it is a few buffers on the CPU.
const OPEN_LIMIT: Duration = Duration::from_secs(10);

const GPU_SOUND: u8 = 0;
const GPU_LOST: u8 = 1;
const GPU_WRONG: u8 = 2;

/// What a soak may be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoakOptions {
    /// Simulated time.
    pub minutes: f64,
    /// Seed of everything random.
    pub seed: u64,
    /// From one trouble to the next; none if infinite.
    pub fault_every_s: f64,
}

/// Soaks a robot.
///
/// # Errors
/// When the robot does not fit into the world or cannot be armed, or a ping set cannot be imaged: what the scoreboard finds is in
/// [`Summary::findings`]. `progress` is told the share that is done.
pub fn soak(
    rig: &TrialRig,
    world: &World,
    options: &SoakOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Summary, ServiceError> {
    let cases = catalogue(rig.setup().sensors.len());
    soak_with(rig, world, options, &cases, progress)
}

/// As [`soak`], with troubles of the caller's choice, drawn in an order that the seed decides.
///
/// # Errors
/// As [`soak`].
pub fn soak_with(
    rig: &TrialRig,
    world: &World,
    options: &SoakOptions,
    cases: &[Case],
    progress: &mut dyn FnMut(f64),
) -> Result<Summary, ServiceError> {
    let mut run = Run::new(rig, world.clone(), options, cases)?;
    run.arm()?;
    let sets = (options.minutes * 60.0 * 1e9 / run.drive.period_ns as f64).ceil() as u64;
    let early = sets / 10;
    let mut early_footprint = None;
    for number in 0..sets {
        run.period()?;
        // While something goes wrong a device may be open in two threads.
        if early_footprint.is_none() && number >= early && !run.scorer.is_busy() {
            early_footprint = Footprint::read();
        }
        progress((number + 1) as f64 / sets as f64);
    }
    // The last trouble is not to be missed for want of its end.
    for _ in 0..sets {
        if !run.scorer.is_busy() {
            break;
        }
        run.last = true;
        run.period()?;
    }
    Ok(run.finish(options, early_footprint))
}

/// What is to happen when.
struct Now {
    case: Case,
    until_ns: u64,
}

struct Run<'a> {
    drive: Drive,
    faults: Faults,
    gpu: Arc<AtomicU8>,
    clock: Arc<ManualClock>,
    scorer: Scorer,
    random: ChaCha8Rng,
    cases: &'a [Case],
    /// Order of the cases, and how far they are through.
    order: Vec<usize>,
    drawn: usize,
    every_ns: Option<u64>,
    next_ns: u64,
    now: Option<Now>,
    cleared_ns: u64,
    /// Nothing new goes wrong any more.
    last: bool,
    ping_sets: u64,
    distance_m: f64,
    digest: u64,
}

impl<'a> Run<'a> {
    fn new(rig: &TrialRig, world: World, options: &SoakOptions, cases: &'a [Case]) -> Result<Self, ServiceError> {
        let gpu = Arc::new(AtomicU8::new(GPU_SOUND));
        let clock = Arc::new(ManualClock::new(Stamp { boottime_ns: CLOCK_START_NS, wall_ns: CLOCK_START_NS }));
        let imager = drilled(rig, &gpu, &clock)?;
        let acoustics = SimParams { repeat_waypoints: true, ..SimParams::default() };
        let channels: Vec<usize> = rig.setup().sensors.iter().map(|sensor| sensor.array.channel_count()).collect();
        let every_ns = options.fault_every_s.is_finite().then_some((options.fault_every_s * 1e9) as u64);
        Ok(Self {
            drive: Drive::new(rig, world, acoustics, options.seed, imager)?,
            faults: Faults::new(&channels, options.seed),
            gpu,
            clock,
            scorer: Scorer::default(),
            random: ChaCha8Rng::seed_from_u64(options.seed),
            cases,
            order: (0..cases.len()).collect(),
            drawn: cases.len(),
            every_ns,
            next_ns: 0,
            now: None,
            cleared_ns: 0,
            last: false,
            ping_sets: 0,
            distance_m: 0.0,
            digest: 0xcbf2_9ce4_8422_2325,
        })
    }

    /// Lets the daemon test itself and arms, before the world's time begins. The GPU is lost once before: from then on its buffers lie
    /// where those of every later device will, and memory shows only what is kept.
    fn arm(&mut self) -> Result<(), ServiceError> {
        for number in 0..START_SETS_MAX {
            let trusted = self.drive.pipeline.imager().trust() == Some(Trust::Trusted);
            if self.drive.gate.state() == GateState::Track && trusted && number > 0 {
                self.plan_next();
                return Ok(());
            }
            self.gpu.store(if number == 0 { GPU_LOST } else { GPU_SOUND }, Ordering::Relaxed);
            self.drive.pipeline.imager().wait_for_device(OPEN_LIMIT);
            self.operate();
            self.drive.hear();
            self.faults.apply(&mut self.drive.pings);
            self.drive.decide(Velocity::ZERO)?;
            for _ in 0..self.drive.ticks() {
                self.drive.tick(false);
            }
            self.clock.advance_ns(self.drive.period_ns);
        }
        let reason = self.drive.pipeline.daemon().reason();
        Err(ServiceError::Internal(format!("the simulated robot could not be armed: {reason}")))
    }

    /// One ping set, one period of ticks.
    fn period(&mut self) -> Result<(), ServiceError> {
        self.begin_or_end();
        let silent = match self.now.as_ref().map(|now| now.case.trouble) {
            Some(Trouble::DaemonSilent) => Some(false),
            Some(Trouble::SourceSilent) => Some(true),
            _ => None,
        };
        if silent.is_none() {
            self.drive.pipeline.imager().wait_for_device(OPEN_LIMIT);
            let wanted = self.drive.simulator.wanted_velocity();
            self.drive.hear();
            self.faults.apply(&mut self.drive.pings);
            self.drive.decide(wanted)?;
            self.ping_sets += 1;
        }
        for _ in 0..self.drive.ticks() {
            if silent == Some(true) {
                self.drive.wait();
            }
            let now_ns = self.drive.now_ns;
            let before_m = self.drive.simulator.pose().position_m();
            let output = self.drive.tick(true);
            self.distance_m += (self.drive.simulator.pose().position_m() - before_m).norm();
            let tick = Tick {
                now_ns,
                velocity: output.velocity,
                gate: output.state,
                daemon: self.drive.pipeline.daemon().state(),
                contact: self.drive.simulator.contact(),
            };
            self.note(&tick);
            self.scorer.tick(&tick);
        }
        self.clock.advance_ns(self.drive.period_ns);
        if self.now.is_none() {
            self.operate();
        }
        Ok(())
    }

    fn begin_or_end(&mut self) {
        let now_ns = self.drive.now_ns;
        match &self.now {
            Some(now) if now_ns >= now.until_ns => {
                self.now = None;
                self.faults.clear();
                self.gpu.store(GPU_SOUND, Ordering::Relaxed);
                self.cleared_ns = now_ns;
                self.scorer.clear(now_ns);
                self.plan_next();
            }
            None if now_ns >= self.next_ns && !self.last && !self.scorer.is_busy() && self.every_ns.is_some() => {
                self.begin();
            }
            _ => {}
        }
    }

    /// The next trouble comes somewhere in the first half of the next interval, counted from the last one's end.
    fn plan_next(&mut self) {
        let every_ns = self.every_ns.unwrap_or(u64::MAX / 4);
        let part = 0.5 + 0.5 * self.random.random::<f64>();
        self.next_ns = self.drive.now_ns + (every_ns as f64 * part) as u64;
    }

    fn begin(&mut self) {
        if self.drawn >= self.order.len() {
            for last in (1..self.order.len()).rev() {
                let other = self.random.random_range(0..=last);
                self.order.swap(last, other);
            }
            self.drawn = 0;
        }
        let Some(case) = self.order.get(self.drawn).map(|index| self.cases[*index].clone()) else { return };
        self.drawn += 1;
        // Long enough to be found, and for the standing robot to be seen standing; shorter than what latches the gate.
        let found_in_ns = match case.demand {
            Demand::Latch { found_in_ns } => found_in_ns,
            _ => 0,
        };
        let lasts_ns = found_in_ns + ((1.5 + 3.5 * self.random.random::<f64>()) * 1e9) as u64;
        match case.trouble {
            Trouble::Sensors { fault, whose } => {
                for index in (0..SENSORS_MAX).filter(|index| whose[*index]) {
                    self.faults.set(index, Some(fault));
                }
            }
            Trouble::GpuLost => self.gpu.store(GPU_LOST, Ordering::Relaxed),
            Trouble::GpuWrong => self.gpu.store(GPU_WRONG, Ordering::Relaxed),
            Trouble::OperatorStop => self.drive.ask(OperatorEvent::Stop),
            Trouble::DaemonSilent | Trouble::SourceSilent => {}
        }
        // The set before this one was the last good capture; the first copy of a frozen sensor is good itself.
        let frozen = matches!(case.trouble, Trouble::Sensors { fault: crate::sim::Fault::Frozen, .. });
        let last_good_ns = if frozen { self.drive.now_ns } else { self.drive.now_ns - self.drive.period_ns };
        log::debug!("{}: {:.1} s", case.name, lasts_ns as f64 * 1e-9);
        self.scorer.begin(&case, last_good_ns);
        self.now = Some(Now { case, until_ns: self.drive.now_ns + lasts_ns });
    }

    /// What an operator does who sees that the trouble is over: resets a fault, and arms what is not armed.
    fn operate(&mut self) {
        if self.drive.now_ns < self.cleared_ns + OPERATOR_NS {
            return;
        }
        let state = self.drive.pipeline.daemon().state();
        if state == DaemonState::Fault {
            self.drive.ask(OperatorEvent::Reset);
        } else if state == DaemonState::Ready || (self.drive.gate.armed_epoch().is_none() && state.allows_motion()) {
            self.drive.arm();
            self.scorer.armed(self.drive.now_ns);
        }
    }

    /// Takes a tick into the digest (FNV-1a).
    fn note(&mut self, tick: &Tick) {
        let pose = self.drive.simulator.pose();
        let values = [tick.velocity.linear_m_s, tick.velocity.angular_rad_s, pose.x_m, pose.y_m, pose.heading_rad]
            .map(f64::to_bits);
        let states = u64::from(tick.daemon.number()) << 32 | tick.gate as u64;
        for byte in values.into_iter().chain([states]).flat_map(u64::to_le_bytes) {
            self.digest = (self.digest ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
        }
    }

    fn finish(self, options: &SoakOptions, early: Option<Footprint>) -> Summary {
        let Self { drive, scorer, ping_sets, digest, distance_m, .. } = self;
        let mut summary = scorer.summary();
        summary.minutes = (drive.now_ns - CLOCK_START_NS) as f64 / (60.0 * 1e9);
        summary.seed = options.seed;
        summary.ping_sets = ping_sets;
        summary.distance_m = distance_m;
        summary.digest = format!("{digest:016x}");
        summary.judge_footprint(early, Footprint::read());
        summary
    }
}

/// The one CPU behind every device that is opened in the course of a soak: buffers made anew by other threads again and again would
/// show as growing memory, and it is not the allocator that is to be judged.
struct Lent {
    cpu: Arc<Mutex<CpuBackend>>,
    report: BackendReport,
}

impl Lent {
    fn cpu(&self) -> MutexGuard<'_, CpuBackend> {
        self.cpu.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Backend for Lent {
    fn image(&mut self, pings: &PingSet, image: &mut Image) -> Result<(), BackendError> {
        self.cpu().image(pings, image)
    }

    fn image_up_to(
        &mut self,
        stage: Stage,
        pings: &PingSet,
        sensor_index: usize,
        image: &mut Image,
    ) -> Result<StageOutput, BackendError> {
        self.cpu().image_up_to(stage, pings, sensor_index, image)
    }

    fn stage_times_ns(&self) -> StageTimes {
        self.cpu().stage_times_ns()
    }

    fn report(&self) -> &BackendReport {
        &self.report
    }
}

/// An imager whose GPU is a drill on the CPU and does what `switch` says.
fn drilled(rig: &TrialRig, switch: &Arc<AtomicU8>, clock: &Arc<ManualClock>) -> Result<Imager, BackendError> {
    let (plan, masks) = (Arc::clone(&rig.setup().plan), Arc::clone(rig.masks().table()));
    let cpu = CpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), Some(1))?;
    let (report, cpu, switch) = (cpu.report().clone(), Arc::new(Mutex::new(cpu)), Arc::clone(switch));
    let mut opener: Opener = Box::new(move || -> Result<Box<dyn Backend>, BackendError> {
        let cpu = Lent { cpu: Arc::clone(&cpu), report: report.clone() };
        let switch = Arc::clone(&switch);
        let fault = move |_| match switch.load(Ordering::Relaxed) {
            GPU_LOST => Some(DeviceFault::Lost),
            GPU_WRONG => Some(DeviceFault::TooLarge(0.01)),
            _ => None,
        };
        Ok(Box::new(Drill::new(Box::new(cpu), Box::new(fault))))
    });
    let gpu = opener()?;
    Imager::with_renewal(plan, masks, gpu, opener, Arc::clone(clock) as Arc<_>, Some(1))
}
