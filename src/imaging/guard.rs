//! The GPU behind its quarantine: what it images is believed only after checks, what it fails is somebody else's to redo.
//!
//! In: ping sets, and an [`Opener`] for new devices. Out: images with a stamp, or the reason why the CPU has to image. The decisions are
//! [`Quarantine`]'s, the waiting is the [`Workshop`]'s: nothing here waits but the backend's own call, which has a deadline.

use super::backend::{Backend, BackendError, BackendKind, BackendReport, Image, StageTimes};
use super::quarantine::{GpuEvent, Quarantine, Step, Trust};
use super::workshop::{self, Opener, Workshop};
use crate::signal::PingSet;
use crate::time::{Clock, Stamp};
use std::sync::Arc;
use std::time::Duration;

/// Least time between two lines of the log about ping sets done again.
const TELL_PAUSE_NS: i64 = 1_000_000_000;

/// A clock that an imager may keep.
pub type SharedClock = Arc<dyn Clock + Send + Sync>;

/// A GPU backend, how far it is trusted, and where new ones come from.
pub(super) struct GpuGuard {
    backend: Option<Box<dyn Backend>>,
    /// Makes backends after the first; without it the first loss is for good.
    workshop: Option<Workshop>,
    quarantine: Quarantine,
    clock: SharedClock,
    told_at: Option<Stamp>,
    untold: u64,
    /// Ping sets that the GPU failed.
    pub failed_count: u64,
    /// Devices let go of.
    pub lost_count: u64,
    /// The last failure.
    pub last_failure: Option<BackendError>,
    /// Set when the standing of the GPU has changed: who works now, and why.
    pub news: Option<BackendReport>,
}

impl GpuGuard {
    /// Guards a backend that was just opened.
    ///
    /// # Errors
    /// [`BackendError::Cpu`] when the system refuses a thread.
    pub(super) fn new(
        backend: Box<dyn Backend>,
        opener: Option<Opener>,
        clock: SharedClock,
    ) -> Result<Self, BackendError> {
        let started = opener.map(Workshop::start).transpose();
        let workshop =
            started.map_err(|error| BackendError::Cpu(format!("no thread to open GPU devices in: {error}")))?;
        Ok(Self {
            quarantine: Quarantine::new(workshop.is_some(), clock.now().boottime_ns),
            backend: Some(backend),
            workshop,
            clock,
            told_at: None,
            untold: 0,
            failed_count: 0,
            lost_count: 0,
            last_failure: None,
            news: None,
        })
    }

    pub(super) fn trust(&self) -> Trust {
        self.quarantine.trust()
    }

    /// Time of each stage of the last image.
    pub(super) fn stage_times_ns(&self) -> StageTimes {
        self.backend.as_ref().map_or(StageTimes::default(), |backend| backend.stage_times_ns())
    }

    /// Lets rests end and takes over what the workshop has opened. Waits for nothing.
    pub(super) fn look_after(&mut self) {
        match self.trust() {
            Trust::Resting { .. } => self.tell(GpuEvent::Tick),
            Trust::Opening => match self.workshop.as_ref().and_then(Workshop::take) {
                Some(Ok(backend)) => {
                    self.backend = Some(backend);
                    self.tell(GpuEvent::Opened);
                }
                Some(Err(error)) => {
                    let event = match &error {
                        BackendError::Unavailable(_) => GpuEvent::Absent,
                        _ => GpuEvent::Lost,
                    };
                    self.last_failure = Some(error);
                    self.tell(event);
                }
                None => {}
            },
            Trust::Trusted | Trust::OnProbation | Trust::GivenUp => {}
        }
    }

    /// Waits until a device that is being opened is there.
    pub(super) fn wait_for_device(&self, limit: Duration) {
        if let (Trust::Opening, Some(workshop)) = (self.trust(), &self.workshop) {
            workshop.wait(limit);
        }
    }

    /// Has a trusted GPU image a ping set; false when the CPU has to.
    pub(super) fn image(&mut self, pings: &PingSet, image: &mut Image) -> bool {
        let imaged = self.trust() == Trust::Trusted && self.attempt(pings, image);
        if imaged {
            self.tell(GpuEvent::Good);
        }
        imaged
    }

    /// Has the GPU image a ping set, whatever its standing: what a GPU on probation images is to be compared, not used.
    pub(super) fn attempt(&mut self, pings: &PingSet, image: &mut Image) -> bool {
        self.try_image(pings, image).map_err(|error| self.failed(error)).is_ok()
    }

    /// Says whether an image equalled the CPU's.
    pub(super) fn compared(&mut self, distance: f64, agrees: bool) {
        match (agrees, self.trust()) {
            (true, Trust::OnProbation) => self.tell(GpuEvent::Good),
            (true, _) => {}
            (false, _) => {
                let text = format!("its image is {distance:.1e} away from the CPU's");
                self.last_failure = Some(BackendError::Invalid(text));
                self.tell(GpuEvent::Wrong);
            }
        }
    }

    fn try_image(&mut self, pings: &PingSet, image: &mut Image) -> Result<(), BackendError> {
        let Some(backend) = &mut self.backend else {
            return Err(BackendError::Lost("there is no device".to_owned()));
        };
        // Whoever leaves the image as it was leaves this mark too.
        image.sequence = !pings.sequence;
        image.backend = BackendKind::Cpu;
        backend.image(pings, image)?;
        check(pings, image)
    }

    fn failed(&mut self, error: BackendError) {
        self.failed_count += 1;
        self.untold += 1;
        let now = self.clock.now();
        if self.told_at.is_none_or(|at| now.since_ns(at) >= TELL_PAUSE_NS) {
            log::warn!("the GPU failed {} ping sets, the CPU images them: {error}", self.untold);
            self.told_at = Some(now);
            self.untold = 0;
        }
        let event = if matches!(error, BackendError::Lost(_)) { GpuEvent::Lost } else { GpuEvent::Failed };
        self.last_failure = Some(error);
        self.tell(event);
    }

    fn tell(&mut self, event: GpuEvent) {
        let now = self.clock.now();
        let (quarantine, step) = self.quarantine.step(event, now.boottime_ns);
        self.quarantine = quarantine;
        match step {
            Step::Stay => {}
            Step::Open => {
                if let Some(workshop) = &self.workshop {
                    workshop.open();
                }
            }
            Step::Trust => {
                let report = self.backend.as_ref().map(|backend| backend.report().clone());
                let reason = "it was opened anew and images as the CPU does".to_owned();
                self.news = report.map(|report| BackendReport { reason, ..report });
            }
            Step::Rest | Step::GiveUp => self.let_go(step, now),
        }
    }

    fn let_go(&mut self, step: Step, now: Stamp) {
        self.lost_count += 1;
        if let Some(backend) = self.backend.take() {
            match &self.workshop {
                Some(workshop) => workshop.close(backend),
                None => workshop::close(backend),
            }
        }
        let why = self.last_failure.as_ref().map_or_else(String::new, ToString::to_string);
        let losses = self.quarantine.losses_in_a_row();
        let reason = match (step, self.trust()) {
            (Step::Rest, Trust::Resting { until_ns }) => {
                let rest_s = until_ns.saturating_sub(now.boottime_ns) as f64 * 1e-9;
                format!("the CPU stands in, a new device is tried in {rest_s:.0} s: {why}")
            }
            _ => format!("the CPU took over for good after {losses} losses of the GPU without a good image: {why}"),
        };
        // The imager puts its CPU's name in.
        self.news = Some(BackendReport { kind: BackendKind::Cpu, adapter: String::new(), reason, threads: 0 });
    }
}

impl Drop for GpuGuard {
    fn drop(&mut self) {
        if let Some(backend) = self.backend.take() {
            workshop::close_and_wait(backend);
        }
    }
}

/// Bits of the exponent, all set in infinities and NaN.
const EXPONENT: u32 = 0x7f80_0000;

/// Refuses an image that is of another ping set, not finite, or silent although there was something to hear.
pub(super) fn check(pings: &PingSet, image: &Image) -> Result<(), BackendError> {
    let invalid = |what: String| Err(BackendError::Invalid(what));
    if (image.sequence, image.imaged, image.backend) != (pings.sequence, pings.present, BackendKind::Gpu) {
        return invalid(format!("it is of ping set {}, not {}", image.sequence, pings.sequence));
    }
    let reports = image.channels.iter().zip(image.imaged);
    for (energyscape, (report, _)) in image.energyscapes.iter().zip(reports).filter(|(_, (_, imaged))| *imaged) {
        let bits = || energyscape.values.iter().map(|value| value.to_bits());
        // No branch in the loop, so that it is made of vector instructions.
        if bits().fold(false, |bad, word| bad | (word & EXPONENT == EXPONENT)) {
            return invalid(format!("the image of sensor {} is not finite", energyscape.sensor_index));
        }
        if report.used_count() > 0 && bits().all(|word| word & !(1 << 31) == 0) {
            return invalid(format!("the image of sensor {} is all zeros", energyscape.sensor_index));
        }
    }
    let is_nan = |value: f32| value.to_bits() & !(1 << 31) > EXPONENT;
    let floats =
        |sums: &crate::signal::RowSums| [sums.energy, sums.turn, sums.flow, sums.peak].map(is_nan).contains(&true);
    if image.sums.iter().any(floats) {
        return invalid("a row of masked sums is not a number".to_owned());
    }
    Ok(())
}
