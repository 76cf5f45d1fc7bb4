//! The imaging and deciding thread: ping set in, command out; then everything that may come later.
//!
//! A command is published after every ping set, in every state, and otherwise only to say stop: no timer ever repeats an
//! old command. The order within a ping set is command, energyscapes, cues, so that nobody's reading delays the robot.

use super::acquisition::Delivered;
use super::handoff::{Taken, Taker};
use super::health::Reporter;
use super::pipeline::{Outcome, Pipeline};
use super::replay::event_of;
use super::tape::Tape;
use super::watching::Progress;
use crate::geometry::Pose2;
use crate::io::DaemonTopics;
use crate::io::record::Note;
use crate::io::source::Moment;
use crate::io::wire::message::{
    EnergyscapeHeader, FLAG_BACKEND_FALLBACK, FLAG_CHANNELS_LEFT_OUT, FLAG_NO_WITNESS, Request, VelocityCommand,
    VelocityInput,
};
use crate::io::wire::telemetry::{CueThresholds, Cues};
use crate::safety::{DaemonEvent, DaemonOutput, OperatorEvent};
use crate::signal::{DaemonState, SENSORS_MAX, Velocity};
use crate::time::{Clock, Stamp, SystemClock};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Longest wait for a ping set before operators and ages are looked at again.
const WAIT: Duration = Duration::from_millis(10);
/// Zero is published this often at the end, so that one lost sample does not matter.
pub(super) const ZEROS_AT_END: usize = 3;

/// How the loop ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// It was asked to stop, the time was over, or the source ended.
    Asked,
    /// The daemon's own state machine ends the process with this code.
    Code(u8),
    /// The IPC root was taken away under the daemon.
    RootLost,
}

/// Everything of the thread.
pub struct DecisionLoop {
    pub(super) root: String,
    pub(super) pipeline: Pipeline,
    pub(super) topics: DaemonTopics,
    pub(super) headers: Vec<EnergyscapeHeader>,
    pub(super) thresholds: CueThresholds,
    pub(super) input_max_age_ns: u64,
    pub(super) recording_ns: u64,
    pub(super) period_ns: u64,
    pub(super) reporter: Reporter,
    pub(super) input: Option<VelocityInput>,
    pub(super) pose: Option<(Pose2, Stamp)>,
    pub(super) dropped_count: u64,
    pub(super) last_set_at: Option<Stamp>,
    pub(super) last_emitted_at: Stamp,
    pub(super) tape: Tape,
}

impl DecisionLoop {
    /// Runs until `stop` is set, the source ends, or the state machine ends the process. `limit` counts from the first ping
    /// set. Publishes zero before it returns.
    pub fn run(
        &mut self,
        taker: &Taker<Delivered>,
        mut buffer: Delivered,
        stop: &AtomicBool,
        limit: Option<Duration>,
        progress: &Arc<Progress>,
    ) -> Ended {
        let mut first_set_at = None;
        let mut probed_at = SystemClock.now();
        self.tell(DaemonEvent::Started);
        let ended = loop {
            if stop.load(Ordering::Relaxed) {
                break Ended::Asked;
            }
            self.listen();
            match taker.take(&mut buffer, WAIT) {
                Taken::Fresh => {
                    self.ping_set(&mut buffer, taker.dropped());
                    progress.processed(self.last_emitted_at);
                    first_set_at.get_or_insert(self.last_emitted_at);
                }
                Taken::Nothing => self.watch_ages(),
                Taken::Closed => break Ended::Asked,
            }
            progress.beat(self.pipeline.daemon().state(), self.pipeline.daemon().reason());
            let now = SystemClock.now();
            self.report(now);
            if let Some(code) = self.reporter.exit_code {
                break Ended::Code(code);
            }
            if now.since_ns(probed_at) >= 1_000_000_000 {
                probed_at = now;
                if !self.topics.is_intact() {
                    break Ended::RootLost;
                }
                if let Err(error) = self.topics.connect_latecomers() {
                    self.reporter.complain(&error);
                }
            }
            let elapsed = first_set_at.map(|first| now.since_ns(first).max(0).cast_unsigned());
            if elapsed.zip(limit).is_some_and(|(elapsed_ns, limit)| u128::from(elapsed_ns) >= limit.as_nanos()) {
                break Ended::Asked;
            }
        };
        let output =
            self.tell(if ended == Ended::RootLost { DaemonEvent::InternalError } else { DaemonEvent::Terminate });
        for _ in 0..ZEROS_AT_END {
            self.stand_still(&output);
        }
        let now = SystemClock.now();
        self.reporter.recording = self.tape.state();
        let health = self.reporter.report_now(now, &self.pipeline, &self.topics);
        self.tape.note(now, Note::Health(health));
        ended
    }

    /// Why the state is what it is, in words.
    #[must_use]
    pub fn reason_text(&self) -> String {
        self.pipeline.daemon().reason().to_string()
    }

    /// The IPC root, in words.
    #[must_use]
    pub fn root_text(&self) -> String {
        self.root.clone()
    }

    /// Operators first: a stop must not wait for a ping set.
    fn listen(&mut self) {
        while let Some(request) = self.topics.poll_operator() {
            if self.tape.is_on() {
                self.tape.note(SystemClock.now(), Note::Operator(request));
            }
            let event = match request.request() {
                Some(Request::Arm) => {
                    OperatorEvent::Arm { epoch: request.epoch, requested_at_ns: request.t_monotonic_ns }
                }
                Some(Request::Stop) => OperatorEvent::Stop,
                Some(Request::Reset) => OperatorEvent::Reset,
                None => continue,
            };
            self.tell(DaemonEvent::Operator(event));
        }
        if let Some(input) = self.topics.poll_input() {
            self.input = Some(input);
            self.tape.note(SystemClock.now(), Note::Input(input));
        }
        if let Some(odometry) = self.topics.poll_odometry() {
            self.pose = odometry.dated_pose();
            self.tape.note(SystemClock.now(), Note::Odometry(odometry));
        }
        if self.tape.is_on() {
            while let Some(platform) = self.topics.next_platform() {
                self.tape.note(SystemClock.now(), Note::Platform(platform));
            }
        }
    }

    fn report(&mut self, now: Stamp) {
        self.reporter.recording = self.tape.state();
        if let Some(health) = self.reporter.report(now, &self.pipeline, &self.topics) {
            self.tape.note(now, Note::Health(health));
        }
    }

    fn wanted(&self, guidance: Option<Velocity>, now: Stamp) -> Velocity {
        let fresh = self.input.filter(|input| {
            let age_ns = now.since_ns(Stamp { boottime_ns: input.t_monotonic_ns, wall_ns: 0 });
            age_ns <= self.input_max_age_ns.cast_signed()
        });
        match (fresh, guidance) {
            (Some(input), _) => input.wanted(now, self.input_max_age_ns),
            (None, Some(guidance)) => guidance,
            (None, None) => Velocity::ZERO,
        }
    }

    fn ping_set(&mut self, delivered: &mut Delivered, dropped_count: u64) {
        let begin = SystemClock.now();
        let emitted_at = delivered.pings.emitted_at;
        if dropped_count > self.dropped_count {
            // A set that was overtaken was not ready in time.
            self.dropped_count = dropped_count;
            self.tell(DaemonEvent::DeadlineMissed);
        }
        self.last_set_at = Some(begin);
        let moment = delivered.moment.take();
        if let Some(moment) = &moment {
            self.tell_again(moment);
        }
        self.last_emitted_at = emitted_at;
        let begin = moment.as_ref().map_or(begin, |moment| moment.now);
        let wanted = self.wanted(delivered.wanted, begin);
        let pose = self.pose.filter(|(_, at)| begin.since_ns(*at) <= self.input_max_age_ns.cast_signed());
        let pose = pose.map(|(pose, _)| pose);
        let (wanted, pose) = moment.map_or((wanted, pose), |moment| (moment.wanted, moment.pose));
        self.tape.before(begin, &delivered.pings, wanted, pose);
        let outcome = self.pipeline.process(begin, &mut delivered.pings, wanted, pose);
        match outcome {
            Ok(outcome) => {
                self.reporter.note(&outcome.output);
                let headers = self.publish(&outcome, emitted_at);
                self.tape.after(SystemClock.now(), &delivered.pings, &self.pipeline.image().energyscapes, &headers);
                if let Some(output) = self.pipeline.after_command(&delivered.pings, SystemClock.now()) {
                    self.reporter.note(&output);
                    self.stand_still(&output);
                }
            }
            Err(error) => {
                log::error!("ping set {} cannot be imaged: {error}", delivered.pings.sequence);
                let daemon = self.pipeline.daemon();
                let command = VelocityCommand::standstill(emitted_at, daemon.state(), daemon.reason());
                self.send(command);
                self.tape.after(SystemClock.now(), &delivered.pings, &[], &[None; SENSORS_MAX]);
            }
        }
    }

    /// Publishes command, images and cues; gives the headers of the images.
    fn publish(&mut self, outcome: &Outcome, emitted_at: Stamp) -> [Option<EnergyscapeHeader>; SENSORS_MAX] {
        let mut headers = [None; SENSORS_MAX];
        let output = &outcome.output;
        let command = VelocityCommand::from_decision(&outcome.decision, outcome.velocity, output.state, output.reason);
        let now = self.send(command);
        let end_of_recording = emitted_at.plus_ns(self.recording_ns);
        self.reporter.ping_set(outcome, now.since_ns(end_of_recording) as f64 * 1e-6, self.dropped_count);
        let image = self.pipeline.image();
        for (index, energyscape) in image.energyscapes.iter().enumerate().filter(|(index, _)| image.imaged[*index]) {
            let mut header = self.headers[index];
            header.sequence = energyscape.sequence;
            header.t_monotonic_ns = energyscape.emitted_at.boottime_ns;
            header.t_wall_ns = energyscape.emitted_at.wall_ns;
            header.t_completed_ns = now.boottime_ns;
            header.backend = image.backend as u32;
            if outcome.findings[index].bad_channels > 0 {
                header.flags |= FLAG_CHANNELS_LEFT_OUT;
            }
            if self.pipeline.fell_back() {
                header.flags |= FLAG_BACKEND_FALLBACK;
            }
            if !outcome.used[index] {
                header.flags |= FLAG_NO_WITNESS;
            }
            headers[index] = Some(header);
            if let Err(error) = self.topics.publish_energyscape(index, &header, &energyscape.values) {
                self.reporter.complain(&error);
            }
        }
        let cues = Cues::new(&outcome.cues, &self.thresholds);
        if let Err(error) = self.topics.publish_cues(cues) {
            self.reporter.complain(&error);
        }
        self.tape.note(now, Note::Cues(cues));
        headers
    }

    /// Tells the state machine that time passes; when it therefore stops the robot, says so.
    fn watch_ages(&mut self) {
        let now = SystemClock.now();
        let silent_ns = self.last_set_at.map_or(0, |at| now.since_ns(at));
        let starting = matches!(self.pipeline.daemon().state(), DaemonState::Boot | DaemonState::SelfTest);
        if starting || silent_ns > self.period_ns.cast_signed() {
            self.tell(DaemonEvent::Tick);
        }
    }

    /// Tells the state machine what it was told in a recorded run. Its start and its end are this daemon's own.
    fn tell_again(&mut self, moment: &Moment) {
        for step in &moment.steps {
            let event = match event_of(step) {
                None | Some(DaemonEvent::Started | DaemonEvent::Terminate | DaemonEvent::InternalError) => continue,
                Some(DaemonEvent::Operator(OperatorEvent::Arm { epoch, requested_at_ns })) => {
                    let epoch = if epoch == moment.epoch { self.topics.epoch() } else { epoch };
                    DaemonEvent::Operator(OperatorEvent::Arm { epoch, requested_at_ns })
                }
                Some(event) => event,
            };
            self.tell_at(event, step.now());
        }
    }

    fn tell(&mut self, event: DaemonEvent) -> DaemonOutput {
        self.tell_at(event, SystemClock.now())
    }

    fn tell_at(&mut self, event: DaemonEvent, now: Stamp) -> DaemonOutput {
        self.tape.told(&event, now);
        let output = self.pipeline.tell(event, now);
        self.reporter.note(&output);
        let stops = output.transition.is_some_and(|transition| !transition.to.allows_motion());
        if stops {
            self.stand_still(&output);
        }
        output
    }

    fn stand_still(&mut self, output: &DaemonOutput) {
        self.send(VelocityCommand::standstill(self.last_emitted_at, output.state, output.reason));
    }

    fn send(&mut self, command: VelocityCommand) -> Stamp {
        let now = SystemClock.now();
        match self.topics.publish_command(command, now) {
            Ok(sequence) => {
                self.reporter.command_count = sequence;
                let epoch = self.topics.epoch();
                self.tape.command(now, VelocityCommand { epoch, sequence, t_published_ns: now.boottime_ns, ..command });
            }
            Err(error) => self.reporter.complain(&error),
        }
        now
    }
}
