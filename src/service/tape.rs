//! What the deciding thread tells the recorder, if there is one: every call of the pipeline, and after the command is out what was
//! heard and seen.
//!
//! In: calls, ping sets, notes. Out: what [`crate::io::record`] writes. Never waits, never allocates, changes nothing.

use super::regions;
use super::wiring::SensingSetup;
use crate::config::Config;
use crate::detect::RangeScanner;
use crate::geometry::Pose2;
use crate::io::record::{Note, RecordState, RecordSubject, ScanMaker, Tap};
use crate::io::ros::{PipelineStep, StepKind};
use crate::io::wire::message::{EnergyscapeHeader, VelocityCommand};
use crate::safety::{DaemonEvent, OperatorEvent};
use crate::signal::{Energyscape, PingSet, SENSORS_MAX, Velocity};
use crate::time::Stamp;

/// Commands that may leave between a ping set's decision and its copy.
const WAITING_MAX: usize = 8;

/// The recorder's ear in the deciding thread; deaf without a recorder.
#[derive(Default)]
pub struct Tape {
    tap: Option<Tap>,
    /// The set under way: as it was before the pipeline saw it.
    under_way: Option<PipelineStep>,
    present: [bool; SENSORS_MAX],
    /// Commands of the set under way: they are written after it, so that every command follows the step that led to it.
    waiting: [Option<(Stamp, VelocityCommand)>; WAITING_MAX],
    waiting_count: usize,
    dropped_told: u64,
    state_told: Option<RecordState>,
}

impl Tape {
    /// A tape for a pipeline that was made with `epoch` at `begun`.
    #[must_use]
    pub fn new(tap: Tap, epoch: u64, begun: Stamp) -> Self {
        let mut tape = Self { tap: Some(tap), ..Self::default() };
        tape.step(PipelineStep { epoch, ..step(StepKind::Begin, begun) });
        tape
    }

    /// The tape of a recording that could not begin: deaf, but known in health.
    #[must_use]
    pub fn broken(state: RecordState) -> Self {
        Self { state_told: Some(state), ..Self::default() }
    }

    /// Whether anything is recorded.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.tap.is_some()
    }

    /// The pipeline was told of `event`.
    pub fn told(&mut self, event: &DaemonEvent, now: Stamp) {
        let told = match event {
            DaemonEvent::Started => step(StepKind::Started, now),
            DaemonEvent::Tick => step(StepKind::Tick, now),
            DaemonEvent::DeadlineMissed => step(StepKind::DeadlineMissed, now),
            DaemonEvent::Operator(OperatorEvent::Arm { epoch, requested_at_ns }) => {
                PipelineStep { epoch: *epoch, requested_at_ns: *requested_at_ns, ..step(StepKind::Arm, now) }
            }
            DaemonEvent::Operator(OperatorEvent::Stop) => step(StepKind::Stop, now),
            DaemonEvent::Operator(OperatorEvent::Reset) => step(StepKind::Reset, now),
            DaemonEvent::InternalError => step(StepKind::InternalError, now),
            DaemonEvent::Terminate => step(StepKind::Terminate, now),
            // These the pipeline tells itself.
            DaemonEvent::BackendVerified | DaemonEvent::BackendMismatch | DaemonEvent::Group(_) => return,
        };
        self.step(told);
    }

    /// The pipeline is about to process `pings`.
    pub fn before(&mut self, now: Stamp, pings: &PingSet, wanted: Velocity, pose: Option<Pose2>) {
        if self.tap.is_none() {
            return;
        }
        let mut begun = PipelineStep {
            set_sequence: pings.sequence,
            set_t_monotonic_ns: pings.emitted_at.boottime_ns,
            set_t_wall_ns: pings.emitted_at.wall_ns,
            wanted_linear_m_s: wanted.linear_m_s,
            wanted_angular_rad_s: wanted.angular_rad_s,
            ..step(StepKind::PingSet, now)
        };
        for (index, ping) in pings.pings.iter().enumerate().filter(|(index, _)| pings.present[*index]) {
            begun.ping_sequence[index] = ping.sequence;
            begun.sensors_present |= 1 << index;
        }
        if let Some(pose) = pose {
            (begun.x_m, begun.y_m, begun.heading_rad, begun.has_pose) = (pose.x_m, pose.y_m, pose.heading_rad, 1);
        }
        self.present = pings.present;
        self.under_way = Some(begun);
    }

    /// The command is out: copies what was heard, and the images with their headers.
    pub fn after(
        &mut self,
        now: Stamp,
        pings: &PingSet,
        images: &[Energyscape],
        headers: &[Option<EnergyscapeHeader>; SENSORS_MAX],
    ) {
        let (Some(tap), Some(begun)) = (&mut self.tap, self.under_way.take()) else { return };
        let present = self.present;
        tap.ping_set(now, Some(begun), |slot, raw| {
            if raw {
                slot.copy_pings(pings, present);
            }
            for (image, header) in images.iter().zip(headers) {
                if let Some(header) = header {
                    slot.copy_image(header, &image.values);
                }
            }
        });
        for place in &mut self.waiting[..self.waiting_count] {
            if let Some((at, command)) = place.take() {
                tap.note(at, Note::Command(command));
            }
        }
        self.waiting_count = 0;
        self.tell();
    }

    /// A command left.
    pub fn command(&mut self, now: Stamp, command: VelocityCommand) {
        if self.under_way.is_some() && self.waiting_count < WAITING_MAX {
            self.waiting[self.waiting_count] = Some((now, command));
            self.waiting_count += 1;
        } else {
            self.note(now, Note::Command(command));
        }
    }

    /// Anything else that is small.
    pub fn note(&mut self, now: Stamp, note: Note) {
        if let Some(tap) = &mut self.tap {
            tap.note(now, note);
        }
    }

    /// How the recording is; none without one.
    #[must_use]
    pub fn state(&self) -> Option<RecordState> {
        self.tap.as_ref().map(|tap| tap.tally().state).or(self.state_told)
    }

    fn step(&mut self, step: PipelineStep) {
        self.note(step.now(), Note::Step(step));
    }

    /// Logs what was lost: the first time and then ever more rarely.
    fn tell(&mut self) {
        let Some(tally) = self.tap.as_ref().map(Tap::tally) else { return };
        let over = tally.state != RecordState::Recording && self.state_told != Some(tally.state);
        if over {
            self.state_told = Some(tally.state);
            log::error!("nothing is recorded any more; the robot goes on");
        }
        let dropped = tally.dropped_sets;
        if self.state_told.is_none() && dropped > self.dropped_told && dropped >= 2 * self.dropped_told {
            self.dropped_told = dropped;
            log::warn!("the disk is slow: {dropped} ping sets are not recorded");
        }
    }
}

fn step(kind: StepKind, now: Stamp) -> PipelineStep {
    PipelineStep { kind: kind as u32, t_monotonic_ns: now.boottime_ns, t_wall_ns: now.wall_ns, ..PipelineStep::blank() }
}

/// What a recording of the robot of `config` holds.
#[must_use]
pub fn subject(config: &Config, setup: &SensingSetup) -> RecordSubject {
    let params = regions::mask_params(&config.control, &config.platform, &config.imaging.directions);
    let scanner = |index: usize| -> ScanMaker {
        let floor = params.noise_floor.clone();
        let hidden = &setup.plan.sensors[index].hidden;
        let mut scanner =
            RangeScanner::new(&setup.plan.grid, hidden, |range_m| floor.at(range_m), params.side_lobe_share);
        Box::new(move |image, scan| scanner.scan(image, scan))
    };
    RecordSubject {
        sensors: setup.sensors.clone(),
        grid: setup.plan.grid.clone(),
        format: setup.recording,
        pings: super::empty_ping_set(setup),
        period_s: 1.0 / config.control.rate_hz,
        config_toml: found_from_anywhere(config).to_toml(),
        scanners: (0..setup.sensors.len()).map(scanner).collect(),
    }
}

/// The configuration with its calibration named so that a replay finds it from wherever the recording lies.
fn found_from_anywhere(config: &Config) -> Config {
    let mut config = config.clone();
    if let Some(file) = &mut config.calibration.file {
        let joined = config.base_dir.join(&*file);
        *file = std::path::absolute(&joined).unwrap_or(joined);
    }
    config
}
