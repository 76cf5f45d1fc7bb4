//! One ping set through everything: plausibility, imaging, cues, decision, state. No threads and no I/O; "now" comes from
//! the caller, so the daemon, a replay and a test run the same code.

use super::scanning::estimator;
use super::wiring::SensingSetup;
use crate::calibration::{Drift, DriftMonitor};
use crate::config::Config;
use crate::control::Controller;
use crate::detect::EgoMotion;
use crate::flow::MaskSet;
use crate::geometry::Pose2;
use crate::imaging::backend::{BackendError, BackendKind, Image};
use crate::imaging::channels::ChannelReport;
use crate::imaging::direct_path::{Calibration, ChannelMap, DirectPath, HEARD_MIN};
use crate::imaging::{CrossCheck, Imager};
use crate::safety::daemon::CLIPPED_CHANNELS_MAX;
use crate::safety::{
    Daemon, DaemonEvent, DaemonOutput, DaemonState, GroupFindings, Plausibility, SensorFindings, plausibility,
};
use crate::signal::{Cues, Decision, PingSet, SENSORS_MAX, Velocity};
use crate::time::Stamp;
use std::time::Duration;

/// What a ping set led to. The image stays in the pipeline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// What the layers were given.
    pub cues: Cues,
    /// What they decided.
    pub decision: Decision,
    /// What may be published: the decision, or zero or less of it where the state says so.
    pub velocity: Velocity,
    /// The daemon's state after the ping set.
    pub output: DaemonOutput,
    /// What was found of each sensor.
    pub findings: [SensorFindings; SENSORS_MAX],
    /// Which sensors the cues rest on.
    pub used: [bool; SENSORS_MAX],
}

/// Everything between a ping set and a command.
pub struct Pipeline {
    setup: SensingSetup,
    masks: MaskSet,
    imager: Imager,
    controller: Controller,
    daemon: Daemon,
    plausibility: Plausibility,
    direct_path: DirectPath,
    drift: DriftMonitor,
    /// Way that the robot needs to see to be allowed the slowest forward motion.
    needed_ahead_m: f64,
    /// From one trigger of the sensors to the next.
    period_ns: u64,
    /// From one sensor's turn to the next one's; zero when all fire together.
    slot_ns: u64,
    fell_back: bool,
    /// Where the controller gives movers room: what finds them, and what it needs of the set processed last.
    ego_motion: Option<Box<EgoMotion>>,
    last_used: [bool; SENSORS_MAX],
    last_pose: Option<Pose2>,
}

impl Pipeline {
    /// Puts the parts together. `epoch` is random per start; the daemon is in BOOT until [`DaemonEvent::Started`].
    #[must_use]
    pub fn new(config: &Config, setup: SensingSetup, masks: MaskSet, imager: Imager, epoch: u64, now: Stamp) -> Self {
        let max_age_ns = config.safety.max_age_ns();
        let controller =
            Controller::new(&config.control, &config.platform).with_max_age(Duration::from_nanos(max_age_ns));
        let ego_motion = config.control.movers.enabled.then(|| Box::new(estimator(config, &setup)));
        Self {
            ego_motion,
            last_used: [false; SENSORS_MAX],
            last_pose: None,
            direct_path: DirectPath::new(&setup.plan, &setup.sensors, setup.speed_of_sound_m_s),
            drift: DriftMonitor::new(&setup.plan, &setup.uncalibrated, &config.calibration, setup.speed_of_sound_m_s),
            daemon: Daemon::new(setup.sensors.len(), max_age_ns, epoch, now),
            controller,
            plausibility: Plausibility::default(),
            needed_ahead_m: config.platform.radius_m,
            period_ns: (1e9 / config.control.rate_hz) as u64,
            slot_ns: config.slot_ns(),
            fell_back: false,
            setup,
            masks,
            imager,
        }
    }

    /// The sensors and their plan.
    #[must_use]
    pub fn setup(&self) -> &SensingSetup {
        &self.setup
    }

    /// The images of the last ping set.
    #[must_use]
    pub fn image(&self) -> &Image {
        self.imager.last_image()
    }

    /// Name of each sensor whose direct path was judged, and what fits it best.
    pub fn calibrations(&self) -> impl Iterator<Item = (&str, Calibration)> {
        let sensors = self.setup.sensors.iter().enumerate();
        sensors.filter_map(|(index, sensor)| Some((sensor.name.as_str(), self.direct_path.calibration(index)?)))
    }

    /// What is known of a sensor's air and geometry now.
    #[must_use]
    pub fn drift(&self, sensor_index: usize) -> Drift {
        self.drift.drift(sensor_index)
    }

    /// The backend chooser.
    #[must_use]
    pub fn imager(&self) -> &Imager {
        &self.imager
    }

    /// The daemon's state machine.
    #[must_use]
    pub fn daemon(&self) -> &Daemon {
        &self.daemon
    }

    /// Tells the state machine of something that is no ping set.
    pub fn tell(&mut self, event: DaemonEvent, now: Stamp) -> DaemonOutput {
        let (daemon, output) = self.daemon.step(event, now);
        self.daemon = daemon;
        if matches!(output.state, DaemonState::Fault | DaemonState::SelfTest) && output.transition.is_some() {
            self.controller.reset();
        }
        output
    }

    /// Images a ping set, decides, and updates the state. Pings that must not be used twice, or
    /// belong to another trigger, are marked absent in `pings`.
    ///
    /// # Errors
    /// When no backend can image the set; the state machine has been told, and a zero velocity is to be published.
    pub fn process(
        &mut self,
        now: Stamp,
        pings: &mut PingSet,
        wanted: Velocity,
        pose: Option<Pose2>,
    ) -> Result<Outcome, BackendError> {
        let mut findings = [SensorFindings::ABSENT; SENSORS_MAX];
        plausibility::drop_other_triggers(pings, self.period_ns, self.slot_ns);
        let desync_ns = plausibility::desync_ns(pings, self.slot_ns);
        self.judge_deliveries(pings, &mut findings);
        let captured_at_ns = pings.emitted_at.boottime_ns;
        if self.daemon.wants_backend_check() {
            self.check_backend(pings, now);
        }
        if let Err(error) = self.imager.image(pings) {
            self.tell(DaemonEvent::InternalError, now);
            return Err(error);
        }
        let image = self.imager.last_image();
        let broken = self.masks.broken_sensors(&image.sums);
        let mut used = [false; SENSORS_MAX];
        for (index, report) in image.channels.iter().enumerate().filter(|(index, _)| pings.present[*index]) {
            judge_channels(&mut findings[index], report, image.imaged[index] && !broken[index]);
            if findings[index].clipped_channels > CLIPPED_CHANNELS_MAX {
                self.direct_path.disregard(index);
            }
            // A sensor that does not hear its own emission is no witness of free space.
            used[index] = findings[index].is_usable() && findings[index].direct_path;
        }
        let cues = self.masks.fuse(&image.sums, used, pings.emitted_at, pings.sequence);
        let decision = self.controller.step_with_odometry(now, &cues, wanted, pose);
        (self.last_used, self.last_pose) = (used, pose);
        let group = GroupFindings {
            captured_at_ns,
            sensors: findings,
            desync_ns,
            backend_fallback: self.fell_back_now(),
            view_missing: self.view_missing(used, cues.coverage.ahead_m),
        };
        let output = self.tell(DaemonEvent::Group(group), now);
        Ok(Outcome { cues, decision, velocity: output.limit(decision.velocity), output, findings, used })
    }

    /// Judges what needs no image: numbers, repeated samples, the direct path on every channel. A ping that was used before or is older than
    /// one used before is taken out of the set.
    fn judge_deliveries(&mut self, pings: &mut PingSet, findings: &mut [SensorFindings; SENSORS_MAX]) {
        let slots = pings.pings.iter().zip(&mut pings.present).zip(findings);
        for ((ping, present), findings) in slots.filter(|((_, present), _)| **present) {
            let observed = self.plausibility.observe(ping);
            if !observed.step.usable() {
                *present = false;
                continue;
            }
            let heard = self.direct_path.listen(&self.setup.plan, ping);
            self.imager.set_known_channels(ping.sensor_index, self.direct_path.unfit(ping.sensor_index));
            *findings = SensorFindings {
                frozen: observed.frozen,
                gaps_in_a_row: observed.gaps_in_a_row,
                // NaN is not heard.
                direct_path: heard.correlation >= HEARD_MIN,
                channel_map_fits: heard.map != ChannelMap::Wrong,
                channel_map_doubted: heard.map != ChannelMap::Fits,
                ..SensorFindings::GOOD
            };
        }
    }

    /// Compares the chosen backend with the CPU reference on this very set, once per self-test.
    fn check_backend(&mut self, pings: &PingSet, now: Stamp) {
        let event = match self.imager.verify(pings) {
            Ok(Some(true)) => DaemonEvent::BackendVerified,
            Ok(Some(false)) => DaemonEvent::BackendMismatch,
            // The set could not be imaged, or not by the GPU; the next one is tried.
            Ok(None) | Err(_) => return,
        };
        self.tell(event, now);
    }

    /// What may wait until the command of `pings`, the set processed last, is out: the backends are compared now and then. An image
    /// that was used and is wrong is a fault. And some channels of the direct path are listened to for drift, which decides nothing.
    pub fn after_command(&mut self, pings: &PingSet, now: Stamp) -> Option<DaemonOutput> {
        self.drift.listen(&self.setup.plan, pings);
        self.find_movers(pings);
        let found = self.imager.cross_check(pings);
        (found == CrossCheck::Mismatch).then(|| self.tell(DaemonEvent::BackendMismatch, now))
    }

    /// Looks for movers in the images of the set processed last, for the next decision.
    fn find_movers(&mut self, pings: &PingSet) {
        let Some(ego_motion) = &mut self.ego_motion else { return };
        let image = self.imager.last_image();
        for (index, energyscape) in image.energyscapes.iter().enumerate() {
            if self.last_used[index] && pings.present[index] {
                ego_motion.hear(index, &energyscape.values);
            }
        }
        let report = ego_motion.update(pings.sequence, pings.emitted_at, self.last_pose);
        self.controller.give_room(&report.movers, pings.emitted_at);
    }

    /// Whether a GPU was chosen and the CPU imaged this set. So a GPU that rests keeps the state DEGRADED, and so does one that
    /// was given up: a device that failed five times for no known reason has no reserve behind it any more and wants a look.
    /// Whoever has looked starts the daemon again, on the CPU if need be; that robot is as fast as any.
    fn fell_back_now(&mut self) -> bool {
        self.fell_back = self.imager.trust().is_some() && self.imager.last_image().backend == BackendKind::Cpu;
        self.fell_back
    }

    /// Whether the CPU did the last set although a GPU was chosen.
    #[must_use]
    pub fn fell_back(&self) -> bool {
        self.fell_back
    }

    /// Whether lost sensors leave unseen what all sensors together would see: the way ahead, or a place of the CA region on it.
    fn view_missing(&self, used: [bool; SENSORS_MAX], ahead_m: f64) -> bool {
        let count = self.setup.sensors.len();
        let all: [bool; SENSORS_MAX] = std::array::from_fn(|index| index < count);
        if used == all {
            return false;
        }
        let seen = ahead_m >= self.needed_ahead_m || !(self.masks.coverage(all).ahead_m >= self.needed_ahead_m);
        !seen || self.masks.lacks_cover_ahead(used)
    }
}

fn judge_channels(findings: &mut SensorFindings, report: &ChannelReport, imaged: bool) {
    findings.rejected = !imaged;
    findings.bad_channels = report.bad_count();
    findings.clipped_channels = report.clipped_count();
}
