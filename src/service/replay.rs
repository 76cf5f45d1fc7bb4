//! A recorded run again, as fast as the machine can: the pipeline is told what it was told then, with the same times, and hears the
//! same pings.
//!
//! In: a recording and a configuration, its own or another. Out: what was commanded now beside what was commanded then. On the
//! CPU and with the same settings every bit is the same. Reads no clock and publishes nothing.

use super::decision::ZEROS_AT_END;
use super::pipeline::Pipeline;
use super::{ServiceError, empty_ping_set, wiring};
use crate::config::Config;
use crate::imaging::params::Prefer;
use crate::imaging::{Imager, ImagerOptions};
use crate::io::record::reader::take_ping;
use crate::io::record::{Cut, Entry, RecordError, RunReader};
use crate::io::ros::{PipelineStep, StepKind};
use crate::io::wire::message::VelocityCommand;
use crate::safety::{DaemonEvent, OperatorEvent};
use crate::signal::PingSet;
use crate::time::Stamp;
use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

/// A GPU that takes longer than this for a ping set hangs.
const GPU_PATIENCE_MS: u64 = 10_000;

/// How the run then and the run now compare.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ReplayReport {
    /// Ping sets processed.
    pub ping_sets: u64,
    /// Ping sets that are not in the recording.
    pub missing_sets: u64,
    /// Calls of the pipeline that are not in the recording.
    pub missing_steps: u64,
    /// Commands recorded.
    pub commands: u64,
    /// Commands that differ in any bit that was decided, or that one of the two runs does not have.
    pub differing: u64,
    /// Largest difference of V.
    pub largest_linear_m_s: f64,
    /// Largest difference of omega.
    pub largest_angular_rad_s: f64,
    /// Images compared.
    pub images: u64,
    /// Largest relative L2 difference of an image; infinite for one of another size.
    pub largest_image_l2: f64,
    /// What was lost of a recording that was cut off.
    pub cut: Option<Cut>,
}

impl ReplayReport {
    /// Whether both runs are the same: every command, every image.
    #[must_use]
    pub fn is_equal(&self) -> bool {
        self.differing == 0 && self.largest_image_l2 == 0.0 && self.missing_sets == 0 && self.missing_steps == 0
    }
}

/// The configuration that a recording carries.
///
/// # Errors
/// A recording that cannot be read, and one without a configuration or with one that is not valid.
pub fn recorded_config(path: &Path) -> Result<Config, ServiceError> {
    let reader = RunReader::open(path)?;
    let Some(text) = reader.config_toml() else {
        return Err(content(path, "no configuration attached", "a recording by noctule, or --config").into());
    };
    Config::parse(text, path).map_err(|error| content(path, &error.to_string(), "a valid configuration").into())
}

fn content(path: &Path, found: &str, allowed: &str) -> RecordError {
    RecordError::Content { path: path.to_owned(), found: found.to_owned(), allowed: allowed.to_owned() }
}

/// Runs the recording at `path` with `config`; `each` is shown every command now made.
///
/// # Errors
/// A recording that cannot be read, holds no run, or was made with other raw data than `config` says.
pub fn replay(
    path: &Path,
    config: &Config,
    prefer: Prefer,
    mut each: impl FnMut(&VelocityCommand),
) -> Result<ReplayReport, ServiceError> {
    let mut reader = RunReader::open(path)?;
    let mut run: Option<Run> = None;
    let mut heard = empty_ping_set(&wiring::sensing(config)?);
    loop {
        match reader.next_entry()? {
            None => break,
            Some(Entry::Step(step)) if StepKind::from_number(step.kind) == Some(StepKind::Begin) => {
                run = Some(Run::begin(config, prefer, &step)?);
            }
            Some(Entry::Step(step)) => run_of(path, &mut run)?.step(&step, &mut heard, &mut each)?,
            Some(Entry::Raw(_, ping)) => take_ping(path, &ping, &mut heard)?,
            Some(Entry::Command(command)) => run_of(path, &mut run)?.compare_command(&command),
            Some(Entry::Image(sensor, image)) => run_of(path, &mut run)?.compare_image(sensor, image.data.0),
            Some(Entry::Info(_) | Entry::Input(_) | Entry::Operator(_) | Entry::Odometry(_)) => {}
        }
    }
    let cut = reader.cut();
    let run = run_of(path, &mut run)?;
    run.report.cut = cut;
    // Of a run that was cut off the last commands may be lost.
    run.settle(cut.is_some());
    Ok(run.report)
}

fn run_of<'a>(path: &Path, run: &'a mut Option<Run>) -> Result<&'a mut Run, ServiceError> {
    let allowed = "a recording from its first part on, made by noctule run --record";
    run.as_mut().ok_or_else(|| content(path, "no beginning of a run", allowed).into())
}

/// The run now.
struct Run {
    pipeline: Pipeline,
    sensors: Vec<String>,
    last_emitted_at: Stamp,
    next_step: u64,
    /// Commands now made that were not compared yet.
    made: VecDeque<VelocityCommand>,
    /// Whether the last set was processed: its images can be compared.
    imaged: bool,
    /// Whether a difference is one of the runs, and not of what is missing in the recording.
    report: ReplayReport,
}

impl Run {
    fn begin(config: &Config, prefer: Prefer, step: &PipelineStep) -> Result<Self, ServiceError> {
        let setup = wiring::sensing(config)?;
        let masks = wiring::masks(config, &setup)?;
        let options = ImagerOptions { threads: None, gpu_deadline_ms: GPU_PATIENCE_MS };
        let imager = Imager::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), prefer, options)?;
        imager.announce();
        let sensors = setup.sensors.iter().map(|sensor| sensor.name.clone()).collect();
        Ok(Self {
            pipeline: Pipeline::new(config, setup, masks, imager, step.epoch, step.now()),
            sensors,
            last_emitted_at: Stamp::default(),
            next_step: step.sequence + 1,
            made: VecDeque::new(),
            imaged: false,
            report: ReplayReport::default(),
        })
    }

    fn step(
        &mut self,
        step: &PipelineStep,
        heard: &mut PingSet,
        each: &mut impl FnMut(&VelocityCommand),
    ) -> Result<(), ServiceError> {
        self.settle(false);
        self.report.missing_steps += step.sequence.saturating_sub(self.next_step);
        self.next_step = step.sequence + 1;
        self.imaged = false;
        match StepKind::from_number(step.kind) {
            Some(StepKind::PingSet) if step.has_pings == 0 => self.report.missing_sets += 1,
            Some(StepKind::PingSet) => self.ping_set(step, heard),
            Some(kind) => self.tell(kind, step),
            None => log::warn!("step {} is of a kind that this build does not know: {}", step.sequence, step.kind),
        }
        heard.present = Default::default();
        self.made.iter().for_each(each);
        Ok(())
    }

    fn ping_set(&mut self, step: &PipelineStep, heard: &mut PingSet) {
        heard.sequence = step.set_sequence;
        heard.emitted_at = step.set_emitted_at();
        let (emitted_at, now) = (heard.emitted_at, step.now());
        self.last_emitted_at = emitted_at;
        self.report.ping_sets += 1;
        match self.pipeline.process(now, heard, step.wanted(), step.pose()) {
            Ok(outcome) => {
                let (decision, output) = (&outcome.decision, &outcome.output);
                let made = VelocityCommand::from_decision(decision, outcome.velocity, output.state, output.reason);
                self.made.push_back(made);
                self.imaged = true;
                if let Some(output) = self.pipeline.after_command(heard, now) {
                    self.made.push_back(VelocityCommand::standstill(emitted_at, output.state, output.reason));
                }
            }
            Err(error) => {
                log::error!("ping set {} cannot be imaged: {error}", step.set_sequence);
                let daemon = self.pipeline.daemon();
                self.made.push_back(VelocityCommand::standstill(emitted_at, daemon.state(), daemon.reason()));
            }
        }
    }

    fn tell(&mut self, kind: StepKind, step: &PipelineStep) {
        let Some(event) = event_of(step) else { return };
        let output = self.pipeline.tell(event, step.now());
        let stops = output.transition.is_some_and(|transition| !transition.to.allows_motion());
        let at_end = if kind == StepKind::Terminate { ZEROS_AT_END } else { 0 };
        for _ in 0..usize::from(stops) + at_end {
            self.made.push_back(VelocityCommand::standstill(self.last_emitted_at, output.state, output.reason));
        }
    }

    fn compare_command(&mut self, recorded: &VelocityCommand) {
        self.report.commands += 1;
        let Some(made) = self.made.pop_front() else {
            self.report.differing += 1;
            return;
        };
        if bytemuck::bytes_of(&decided(recorded)) != bytemuck::bytes_of(&decided(&made)) {
            self.report.differing += 1;
        }
        let larger = |so_far: f64, a: f64, b: f64| if (a - b).abs() <= so_far { so_far } else { (a - b).abs() };
        let report = &mut self.report;
        report.largest_linear_m_s = larger(report.largest_linear_m_s, recorded.linear_m_s, made.linear_m_s);
        report.largest_angular_rad_s = larger(report.largest_angular_rad_s, recorded.angular_rad_s, made.angular_rad_s);
    }

    fn compare_image(&mut self, sensor: &str, recorded: &[u8]) {
        let index = self.sensors.iter().position(|name| name == sensor);
        let image = index.and_then(|index| self.pipeline.image().energyscapes.get(index));
        let Some(image) = image.filter(|_| self.imaged) else { return };
        self.report.images += 1;
        let same_size = image.values.len() * 4 == recorded.len();
        let difference = if same_size { relative_l2(recorded, &image.values) } else { f64::INFINITY };
        if !(difference <= self.report.largest_image_l2) {
            self.report.largest_image_l2 = difference;
        }
    }

    /// Commands that only the run now made are differences, unless the recording was cut off before them.
    fn settle(&mut self, cut: bool) {
        if !cut && self.report.missing_sets == 0 {
            self.report.differing += self.made.len() as u64;
        }
        self.made.clear();
    }
}

/// The L2 norm of the difference, over that of what was recorded.
fn relative_l2(recorded: &[u8], now: &[f32]) -> f64 {
    let (mut difference, mut norm) = (0.0, 0.0);
    for (bytes, now) in recorded.chunks_exact(4).zip(now) {
        let then = f64::from(f32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
        difference += (then - f64::from(*now)).powi(2);
        norm += then * then;
    }
    if difference == 0.0 { 0.0 } else { (difference / norm).sqrt() }
}

/// What the pipeline was told in a step that is no ping set.
pub(super) fn event_of(step: &PipelineStep) -> Option<DaemonEvent> {
    Some(match StepKind::from_number(step.kind)? {
        StepKind::Begin | StepKind::PingSet => return None,
        StepKind::Started => DaemonEvent::Started,
        StepKind::Tick => DaemonEvent::Tick,
        StepKind::DeadlineMissed => DaemonEvent::DeadlineMissed,
        StepKind::Arm => {
            DaemonEvent::Operator(OperatorEvent::Arm { epoch: step.epoch, requested_at_ns: step.requested_at_ns })
        }
        StepKind::Stop => DaemonEvent::Operator(OperatorEvent::Stop),
        StepKind::Reset => DaemonEvent::Operator(OperatorEvent::Reset),
        StepKind::InternalError => DaemonEvent::InternalError,
        StepKind::Terminate => DaemonEvent::Terminate,
    })
}

/// What was decided, without what the publisher adds.
fn decided(command: &VelocityCommand) -> VelocityCommand {
    VelocityCommand { epoch: 0, publisher_id: 0, sequence: 0, t_published_ns: 0, checksum: 0, ..*command }
}
