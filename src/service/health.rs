//! What the daemon says of itself: counters, latencies, states; on `noctule/health` after every ping set, once a second
//! without one and at every change of state, and in the log once for every change.

use super::latency::Latencies;
use super::pipeline::{Outcome, Pipeline};
use crate::calibration::{Alarms, Drift};
use crate::imaging::backend::{Stage, StageTimes};
use crate::io::record::RecordState;
use crate::io::wire::telemetry::{Health, recording_number};
use crate::io::{DaemonTopics, IpcError};
use crate::safety::DaemonOutput;
use crate::signal::{DaemonState, Reason, SENSORS_MAX};
use crate::time::Stamp;

/// Time between two reports without news.
const PERIOD_NS: i64 = 1_000_000_000;

/// Counts, remembers, reports.
#[derive(Debug, Default)]
pub struct Reporter {
    /// Commands published so far.
    pub command_count: u64,
    /// The state machine wants the process to end with this code.
    pub exit_code: Option<u8>,
    /// How the recording is, where there is one.
    pub recording: Option<RecordState>,
    ping_set_count: u64,
    dropped_count: u64,
    late_count: u64,
    stop_count: u64,
    rejected_count: [u64; SENSORS_MAX],
    gap_count: [u64; SENSORS_MAX],
    bad_channel_count: [u32; SENSORS_MAX],
    sensors_present: u32,
    latencies: Latencies,
    news: bool,
    passed_self_test: bool,
    reported_at: Option<Stamp>,
    drifted: [Alarms; SENSORS_MAX],
    complaints: u64,
    deadline_ms: f64,
}

impl Reporter {
    /// Starts counting; a command later than `deadline_ms` after the recording's end counts as late.
    #[must_use]
    pub fn new(deadline_ms: f64) -> Self {
        Self { deadline_ms, ..Self::default() }
    }

    /// Logs a change of state, and what an operator was refused.
    pub fn note(&mut self, output: &DaemonOutput) {
        if let Some(transition) = output.transition {
            self.news = true;
            self.passed_self_test |= transition.from == DaemonState::SelfTest && transition.to == DaemonState::Ready;
            self.stop_count += u64::from(transition.to == DaemonState::Stopped);
            let text = format!("{} -> {} ({})", transition.from, transition.to, transition.reason);
            match transition.to {
                DaemonState::Fault => log::error!("{text}"),
                DaemonState::Stopped | DaemonState::Degraded => log::warn!("{text}"),
                _ => log::info!("{text}"),
            }
        }
        if let Some(refusal) = output.refusal.filter(|refusal| *refusal != Reason::ArmOutdated) {
            log::info!("operator's request refused in {}: {refusal}", output.state);
        }
        if output.exit_code.is_some() {
            log::error!("{}: {}", output.state, output.reason);
            self.exit_code = output.exit_code;
        }
    }

    /// Counts a ping set and its latency, end of recording to command.
    pub fn ping_set(&mut self, outcome: &Outcome, latency_ms: f64, dropped_count: u64) {
        self.news = true;
        self.ping_set_count += 1;
        self.dropped_count = dropped_count;
        self.latencies.add(latency_ms);
        self.late_count += u64::from(!(latency_ms <= self.deadline_ms));
        self.sensors_present = 0;
        for (index, findings) in outcome.findings.iter().enumerate() {
            self.sensors_present |= u32::from(findings.present) << index;
            self.rejected_count[index] += u64::from(findings.present && !findings.is_usable());
            self.gap_count[index] += u64::from(findings.gaps_in_a_row > 0);
            self.bad_channel_count[index] = findings.bad_channels as u32;
        }
    }

    /// Logs a failing publisher: the first time and then ever more rarely.
    pub fn complain(&mut self, error: &IpcError) {
        self.complaints += 1;
        if self.complaints.is_power_of_two() {
            log::error!("{error} ({} times)", self.complaints);
        }
    }

    /// Publishes when a second has passed or the state has changed.
    pub fn report(&mut self, now: Stamp, pipeline: &Pipeline, topics: &DaemonTopics) -> Option<Health> {
        if std::mem::take(&mut self.passed_self_test) {
            pipeline.calibrations().for_each(|(name, found)| log::info!("{name}: {found}"));
        }
        self.tell_drift(pipeline);
        let due = self.reported_at.is_none_or(|at| now.since_ns(at) >= PERIOD_NS);
        (due || self.news).then(|| self.report_now(now, pipeline, topics))
    }

    /// Logs an alarm when it begins and when it ends.
    fn tell_drift(&mut self, pipeline: &Pipeline) {
        for (index, sensor) in pipeline.setup().sensors.iter().enumerate() {
            let now = pipeline.drift(index);
            if now.alarms == self.drifted[index] {
                continue;
            }
            self.drifted[index] = now.alarms;
            self.news = true;
            match now.alarms.is_empty() {
                true => log::info!("{}: nothing has drifted any more", sensor.name),
                false => log::warn!("{}: drifted: {}: {now}", sensor.name, now.alarms),
            }
        }
    }

    /// Publishes; gives what was published.
    pub fn report_now(&mut self, now: Stamp, pipeline: &Pipeline, topics: &DaemonTopics) -> Health {
        self.news = false;
        self.reported_at = Some(now);
        let latency = self.latencies.summary();
        let imager = pipeline.imager();
        let drifts: [Drift; SENSORS_MAX] = std::array::from_fn(|index| pipeline.drift(index));
        let watched = &drifts[..pipeline.setup().sensors.len().min(SENSORS_MAX)];
        let health = Health {
            t_monotonic_ns: now.boottime_ns,
            t_wall_ns: now.wall_ns,
            ping_set_count: self.ping_set_count,
            command_count: self.command_count,
            dropped_count: self.dropped_count,
            late_count: self.late_count,
            gpu_loss_count: imager.loss_count(),
            stop_count: self.stop_count,
            rejected_count: self.rejected_count,
            gap_count: self.gap_count,
            latency_ms: latency.newest_ms,
            latency_p50_ms: latency.p50_ms,
            latency_p99_ms: latency.p99_ms,
            latency_max_ms: latency.max_ms,
            stage_ms: stage_ms(imager.stage_times_ns()),
            bad_channel_count: self.bad_channel_count,
            sensors_present: self.sensors_present,
            state: pipeline.daemon().state().number(),
            reason: pipeline.daemon().reason().number(),
            backend: imager.kind() as u32,
            recording: recording_number(self.recording),
            heard_speed_m_s: drifts.map(|drift| drift.speed_of_sound_m_s),
            heard_speed_sd_m_s: drifts.map(|drift| drift.speed_sd_m_s),
            drift: drifts.map(|drift| drift.alarms.bits()),
            drift_looks: watched.iter().map(|drift| drift.looks).min().unwrap_or(0) as u32,
            ..Health::blank()
        }
        .with_adapter(&imager.report().adapter);
        if let Err(error) = topics.publish_health(health) {
            self.complain(&error);
        }
        Health { epoch: topics.epoch(), ..health }
    }
}

/// The topic's five stages: focusing counts as a part of the envelope, whose near ranges it makes.
fn stage_ms(times_ns: StageTimes) -> [f64; 5] {
    let time_ms = |stage: Stage| times_ns[stage as usize] as f64 * 1e-6;
    let envelope_ms = time_ms(Stage::Envelope) + time_ms(Stage::Focus);
    let [demodulate, matched_filter, delay_and_sum] =
        [Stage::Demodulate, Stage::MatchedFilter, Stage::DelayAndSum].map(time_ms);
    [demodulate, matched_filter, delay_and_sum, envelope_ms, time_ms(Stage::MaskedEnergy)]
}
