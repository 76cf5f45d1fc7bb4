//! CPU twin: the stages in order, on a few threads, with the widest vector instructions the processor has.
//!
//! In: raw pings and the channels' gains. Out: energyscapes and masked sums, bit-identical for any number of threads, and findings on
//! channels. Every stage computes one vector of channels or of directions at a time, so that no value changes lanes but where samples
//! come in and images go out. Buffers are owned by [`work`], the order of the stages is here; nothing is allocated after
//! [`CpuBackend::open`]. Never says what a finding means and never chooses between backends.

mod aligned;
mod channel_signal;
mod clean;
mod cleaning;
mod combine;
mod delay_and_sum;
mod demodulate;
mod envelope;
mod focus;
mod inspect;
mod judge;
mod masked_energy;
mod matched_filter;
mod minimum_variance;
mod pool;
mod shared_image;
mod shares;
mod simd;
mod tile;
mod transform;
mod work;

pub use simd::InstructionSet;

use super::backend::{Backend, BackendError, BackendKind, BackendReport, Image, Stage, StageOutput, StageTimes};
use super::channels::{ChannelReport, WordFindings};
use super::plan::ImagingPlan;
use crate::signal::{MaskTable, PingSet, SENSORS_MAX, SampleFormat};
use pool::Pool;
use shares::Phase;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;
use work::Work;

/// Most threads that a ping is cut into; more would wait for each other.
const THREADS_MAX: usize = 64;

/// The CPU backend.
pub struct CpuBackend {
    work: Arc<Work>,
    pool: Pool,
    report: BackendReport,
    stage_times_ns: StageTimes,
}

impl CpuBackend {
    /// Makes all buffers and starts the threads: as many as the processor has cores unless told otherwise.
    ///
    /// # Errors
    /// If the mask table does not fit the plan, or the system refuses a thread.
    pub fn open(
        plan: Arc<ImagingPlan>,
        masks: Arc<MaskTable>,
        threads: Option<usize>,
    ) -> Result<CpuBackend, BackendError> {
        Self::open_with(plan, masks, threads, InstructionSet::best())
    }

    /// As [`CpuBackend::open`], with chosen vector instructions.
    ///
    /// # Errors
    /// As [`CpuBackend::open`], and if the processor lacks the instructions.
    pub fn open_with(
        plan: Arc<ImagingPlan>,
        masks: Arc<MaskTable>,
        threads: Option<usize>,
        set: InstructionSet,
    ) -> Result<CpuBackend, BackendError> {
        if !set.is_available() {
            return Err(BackendError::Cpu(format!("this processor has no {}", set.as_str())));
        }
        check_masks(&plan, &masks)?;
        let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let threads = threads.unwrap_or_else(cores).clamp(1, THREADS_MAX);
        let work = Arc::new(Work::new(plan, masks, set, threads));
        let pool = Pool::start(&work, threads)
            .map_err(|error| BackendError::Cpu(format!("no thread to compute on: {error}")))?;
        let report = BackendReport {
            kind: BackendKind::Cpu,
            adapter: set.as_str().to_owned(),
            reason: "the CPU backend was asked for".to_owned(),
            threads,
        };
        Ok(Self { work, pool, report, stage_times_ns: StageTimes::default() })
    }

    /// Judges the channels of every ping present, as [`ChannelReport::judge`] does, on all threads.
    ///
    /// # Errors
    /// If the pings do not fit the plan, or a thread failed.
    pub(super) fn judge(&mut self, pings: &PingSet, reports: &mut [ChannelReport]) -> Result<(), BackendError> {
        check_pings(&self.work.plan, pings)?;
        if !self.work.lend(pings.present, pings.pings.iter().map(|ping| &ping.samples)) {
            return Err(hung());
        }
        let judged = self.phase(Phase::Judge);
        self.work.give_back();
        judged?;
        for (sensor, report) in reports.iter_mut().enumerate().filter(|(sensor, _)| pings.present[*sensor]) {
            let pieces = || self.work.judged.iter().enumerate().filter(move |(_, piece)| piece.sensor == sensor);
            if self.work.plan.format == SampleFormat::Pdm {
                let all = pieces().map(|(index, _)| *work::locked(&self.work.word_findings[index]));
                all.fold(WordFindings::NONE, WordFindings::and).tell(&mut report.findings);
            } else {
                for (finding, (index, _)) in report.findings.iter_mut().zip(pieces()) {
                    *finding = *work::locked(&self.work.findings[index]);
                }
            }
            report.set_gains(&self.work.plan.sensors[sensor]);
        }
        Ok(())
    }

    fn phase(&self, phase: Phase) -> Result<(), BackendError> {
        self.work.rewind();
        if self.pool.run(phase as usize, || self.work.share(phase, 0)) {
            Ok(())
        } else {
            Err(BackendError::Cpu("a thread of the CPU backend failed".to_owned()))
        }
    }

    /// Runs the stages up to `last` for the `active` sensors; the results stay in the buffers of [`Work`].
    fn run(
        &mut self,
        pings: &PingSet,
        image: &Image,
        active: [bool; SENSORS_MAX],
        last: Stage,
    ) -> Result<(), BackendError> {
        let lent = self.work.lend(active, pings.pings.iter().map(|ping| &ping.samples));
        if !(lent && self.work.set_gains(image.channels.iter().map(|report| &report.gains[..]))) {
            return Err(hung());
        }
        let done = self.stages(last);
        self.work.give_back();
        done
    }

    /// Takes the strongest echoes out, images what is left, and puts them back without their side lobes.
    fn clean(&self) -> Result<(), BackendError> {
        let Some(clean) = self.work.plan.focus.as_ref().and_then(|focus| focus.clean.as_ref()) else { return Ok(()) };
        for round in 0..clean.rounds {
            self.work.cleaning.begin(round);
            for phase in [Phase::Pick, Phase::Fit, Phase::TakeOut, Phase::Focus] {
                self.phase(phase)?;
            }
        }
        self.phase(Phase::PutBack)
    }

    fn stages(&mut self, last: Stage) -> Result<(), BackendError> {
        self.stage_times_ns = StageTimes::default();
        let mut start = Instant::now();
        let mut lap_ns = || {
            let now = Instant::now();
            (now - std::mem::replace(&mut start, now)).as_nanos() as u64
        };
        if self.work.plan.format == SampleFormat::Pdm {
            self.phase(Phase::Demodulate)?;
            self.stage_times_ns[Stage::Demodulate as usize] = lap_ns();
        }
        if last >= Stage::MatchedFilter {
            self.phase(Phase::BandPass)?;
            self.phase(Phase::Spectrum)?;
            self.stage_times_ns[Stage::MatchedFilter as usize] = lap_ns();
        }
        if last >= Stage::Envelope {
            self.work.beam_times_ns.iter().for_each(|time| time.store(0, Ordering::Relaxed));
            if self.work.plan.has_plane_waves() {
                self.phase(Phase::Beams)?;
            }
            // Two stages in one phase: its time in the proportion of their shares.
            let [beams, envelopes] = [0, 1].map(|stage| self.work.beam_times_ns[stage].load(Ordering::Relaxed));
            let phase_ns = lap_ns();
            let beams_ns = (phase_ns as f64 * beams as f64 / (beams + envelopes).max(1) as f64) as u64;
            self.stage_times_ns[Stage::DelayAndSum as usize] = beams_ns;
            self.stage_times_ns[Stage::Envelope as usize] = phase_ns - beams_ns;
            if last >= Stage::Focus && self.work.plan.focus.is_some() {
                self.phase(Phase::Signals)?;
                self.phase(Phase::Focus)?;
                self.clean()?;
                self.stage_times_ns[Stage::Focus as usize] = lap_ns();
            }
            if !self.work.finish_images() {
                return Err(BackendError::Cpu("two threads wrote the same row of an image".to_owned()));
            }
        }
        if last >= Stage::MaskedEnergy {
            self.phase(Phase::Rows)?;
            self.stage_times_ns[Stage::MaskedEnergy as usize] = lap_ns();
        }
        Ok(())
    }
}

fn hung() -> BackendError {
    BackendError::Cpu("a thread of the CPU backend hangs".to_owned())
}

/// Refuses a table whose cells or sensors lie outside the plan's images.
fn check_masks(plan: &ImagingPlan, masks: &MaskTable) -> Result<(), BackendError> {
    let entries = masks.cells.len();
    let fits = masks.sides.len() == entries
        && masks.distances_m.len() == entries
        && masks.cells.iter().all(|cell| (*cell as usize) < plan.grid.cell_count())
        && masks.rows.iter().all(|row| {
            row.sensor_index < plan.sensors.len() && row.first.checked_add(row.count).is_some_and(|end| end <= entries)
        });
    if fits { Ok(()) } else { Err(BackendError::Cpu("the mask table does not fit the imaging plan".to_owned())) }
}

/// Refuses pings that do not fit the plan.
///
/// # Errors
/// [`BackendError::PingShape`], naming the sensor, what was found and what is allowed.
pub(crate) fn check_pings(plan: &ImagingPlan, pings: &PingSet) -> Result<(), BackendError> {
    if pings.pings.len() != plan.sensors.len() {
        return Err(BackendError::PingShape {
            sensor_index: pings.pings.len(),
            found: format!("{} sensors", pings.pings.len()),
            allowed: format!("{} sensors", plan.sensors.len()),
        });
    }
    for (sensor_index, ping) in pings.pings.iter().enumerate().filter(|(index, _)| pings.present[*index]) {
        let (format, len) = (ping.samples.format(), ping.samples.len());
        if format != plan.format || len != plan.raw_len(sensor_index) {
            return Err(BackendError::PingShape {
                sensor_index,
                found: format!("{len} values of {format:?}"),
                allowed: format!("{} values of {:?}", plan.raw_len(sensor_index), plan.format),
            });
        }
    }
    Ok(())
}

/// Refuses an image that was made for another plan or table.
fn check_image(work: &Work, image: &Image) -> Result<(), BackendError> {
    let sensors = &work.plan.sensors;
    let fits = image.energyscapes.len() == sensors.len()
        && image.energyscapes.iter().all(|energyscape| energyscape.values.len() == work.plan.grid.cell_count())
        && image.channels.len() == sensors.len()
        && image.channels.iter().zip(sensors).all(|(report, sensor)| report.gains.len() == sensor.channel_count)
        && image.sums.len() == work.masks.rows.len();
    if fits { Ok(()) } else { Err(BackendError::Cpu("the image was made for another plan".to_owned())) }
}

impl Backend for CpuBackend {
    fn image(&mut self, pings: &PingSet, image: &mut Image) -> Result<(), BackendError> {
        check_pings(&self.work.plan, pings)?;
        check_image(&self.work, image)?;
        self.run(pings, image, pings.present, Stage::MaskedEnergy)?;
        for (sensor, (energyscape, ping)) in image.energyscapes.iter_mut().zip(&pings.pings).enumerate() {
            if pings.present[sensor] {
                // The image takes the filled buffer and leaves its own for the next ping.
                std::mem::swap(&mut energyscape.values, &mut *work::writing(&self.work.images[sensor]));
                energyscape.sequence = ping.sequence;
                energyscape.emitted_at = ping.emitted_at;
            } else {
                energyscape.values.fill(0.0);
            }
        }
        self.work.copy_sums(&mut image.sums);
        image.stamp(pings, BackendKind::Cpu);
        Ok(())
    }

    fn image_up_to(
        &mut self,
        stage: Stage,
        pings: &PingSet,
        sensor_index: usize,
        image: &mut Image,
    ) -> Result<StageOutput, BackendError> {
        check_pings(&self.work.plan, pings)?;
        check_image(&self.work, image)?;
        let mut active = [false; SENSORS_MAX];
        active[sensor_index] = pings.present[sensor_index];
        self.run(pings, image, active, stage)?;
        Ok(match stage {
            Stage::Demodulate => {
                let gains = &image.channels[sensor_index].gains;
                StageOutput::Real(self.work.demodulated_of(sensor_index, gains, &pings.pings[sensor_index].samples))
            }
            Stage::MatchedFilter => StageOutput::Complex(self.work.spectra_of(sensor_index)),
            Stage::DelayAndSum => StageOutput::Complex(self.work.beams_of(sensor_index)),
            Stage::Envelope | Stage::Focus => StageOutput::Real(work::reading(&self.work.images[sensor_index]).clone()),
            Stage::MaskedEnergy => {
                self.work.copy_sums(&mut image.sums);
                StageOutput::Sums(image.sums.clone())
            }
        })
    }

    fn stage_times_ns(&self) -> StageTimes {
        self.stage_times_ns
    }

    fn report(&self) -> &BackendReport {
        &self.report
    }
}
