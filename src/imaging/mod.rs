//! Raw pings to energyscapes and masked sums.
//!
//! In: a [`PingSet`]. Out: an [`Image`]. [`Imager::open`] chooses the backend and says why; [`Imager::image`] judges the
//! channels, lets the backend image, and does a ping again on the CPU when the GPU fails it; [`Imager::cross_check`] compares the
//! two now and then. When a GPU is trusted stands in [`quarantine`], what is computed in [`plan`], how in the twins [`cpu`]
//! and `gpu`.

pub mod backend;
pub mod channels;
pub mod cpu;
pub mod direct_path;
pub mod drill;
mod equal_area;
#[cfg(feature = "gpu")]
pub mod gpu;
mod guard;
pub mod params;
pub mod plan;
pub mod quarantine;
pub mod steering;
mod workshop;

use crate::signal::{MaskTable, PingSet};
use crate::time::SystemClock;
use backend::{Backend, BackendError, BackendKind, BackendReport, Image, StageTimes};
use channels::ChannelFinding;
use cpu::CpuBackend;
use guard::GpuGuard;
pub use guard::SharedClock;
use params::Prefer;
use plan::ImagingPlan;
use quarantine::Trust;
use std::sync::Arc;
use std::time::Duration;
pub use workshop::{Opener, driver_at_work};

/// Largest relative L2 distance between the energyscapes of the two backends: the accuracy that either owes to the
/// textbook (specification, section 3).
pub const AGREEMENT_MAX: f64 = 1e-4;

/// Pings in a row that the GPU may fail before it is let go of.
pub const GPU_FAILURES_MAX: u32 = quarantine::FAILURES_MAX;
/// Every so many ping sets an image of the GPU is compared with the CPU's: within 5 s at 10 ping sets a second.
pub const CHECK_EVERY: u32 = 50;
/// Time the GPU has for a ping set unless configured: `gpu_deadline_ms` of section 7 of the specification.
pub const GPU_DEADLINE_DEFAULT_MS: u64 = 60;

/// What [`Imager::open`] may be told beside the preference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImagerOptions {
    /// Threads of the CPU backend; as many as there are cores when absent.
    pub threads: Option<usize>,
    /// Time the GPU has for a ping set before it is done again on the CPU.
    pub gpu_deadline_ms: u64,
}

impl Default for ImagerOptions {
    fn default() -> Self {
        Self { threads: None, gpu_deadline_ms: GPU_DEADLINE_DEFAULT_MS }
    }
}

/// Images ping sets on the backend chosen at open.
pub struct Imager {
    plan: Arc<ImagingPlan>,
    cpu: CpuBackend,
    gpu: Option<GpuGuard>,
    image: Image,
    /// What an image is compared with.
    other: Image,
    report: BackendReport,
    /// Ping sets since an image of the GPU was last compared with the CPU's.
    unchecked: u32,
    stage_times_ns: StageTimes,
}

/// What [`Imager::cross_check`] found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CrossCheck {
    /// There was nothing to compare.
    NotDue,
    /// The image that was used equals the CPU's, or one that was not used could not be made or was compared.
    Passed,
    /// The image that was used is not the CPU's: what was decided from it, and from those before, may be wrong.
    Mismatch,
}

impl Imager {
    /// Makes all buffers. `Auto` takes a hardware GPU if there is one, else the CPU; `Gpu` takes any adapter; `Cpu` looks for
    /// none. [`Imager::report`] then says what was taken and why.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] when a GPU was asked for and there is none; [`BackendError::Cpu`] when the mask table
    /// does not fit the plan or no thread can be started.
    pub fn open(
        plan: Arc<ImagingPlan>,
        masks: Arc<MaskTable>,
        prefer: Prefer,
        options: ImagerOptions,
    ) -> Result<Imager, BackendError> {
        let opener = |allow_software: bool| -> Opener {
            let (plan, masks) = (Arc::clone(&plan), Arc::clone(&masks));
            Box::new(move || open_gpu(Arc::clone(&plan), Arc::clone(&masks), allow_software, options.gpu_deadline_ms))
        };
        let mut opener = match prefer {
            Prefer::Cpu => {
                return Self::with_backends(plan, masks, None, options.threads, "the configuration asks for the CPU");
            }
            Prefer::Gpu => opener(true),
            Prefer::Auto => opener(false),
        };
        match opener() {
            Ok(gpu) => Self::with_renewal(plan, masks, gpu, opener, Arc::new(SystemClock), options.threads),
            Err(error) if prefer == Prefer::Gpu => Err(error),
            Err(error) => {
                let reason = format!("the CPU stands in: {error}");
                Self::with_backends(plan, masks, None, options.threads, &reason)
            }
        }
    }

    /// As [`Imager::open`], with a GPU backend made elsewhere, or none; tests hand in one that fails. When it is lost it is not opened
    /// anew. `cpu_reason` says why there is none.
    ///
    /// # Errors
    /// As [`Imager::open`].
    pub fn with_backends(
        plan: Arc<ImagingPlan>,
        masks: Arc<MaskTable>,
        gpu: Option<Box<dyn Backend>>,
        threads: Option<usize>,
        cpu_reason: &str,
    ) -> Result<Imager, BackendError> {
        let guard = gpu.map(|gpu| guarded(gpu, None, Arc::new(SystemClock))).transpose()?;
        Self::assemble(plan, masks, guard, threads, cpu_reason)
    }

    /// As [`Imager::open`], with a GPU backend made elsewhere and what opens new ones when it is lost. `clock` says when.
    ///
    /// # Errors
    /// As [`Imager::open`].
    pub fn with_renewal(
        plan: Arc<ImagingPlan>,
        masks: Arc<MaskTable>,
        gpu: Box<dyn Backend>,
        opener: Opener,
        clock: SharedClock,
        threads: Option<usize>,
    ) -> Result<Imager, BackendError> {
        let guard = guarded(gpu, Some(opener), clock)?;
        Self::assemble(plan, masks, Some(guard), threads, "")
    }

    fn assemble(
        plan: Arc<ImagingPlan>,
        masks: Arc<MaskTable>,
        gpu: Option<(GpuGuard, BackendReport)>,
        threads: Option<usize>,
        cpu_reason: &str,
    ) -> Result<Imager, BackendError> {
        let cpu = CpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), threads)?;
        let (gpu, report) = match gpu {
            Some((guard, report)) => (Some(guard), report),
            None => (None, BackendReport { reason: cpu_reason.to_owned(), ..cpu.report().clone() }),
        };
        let image = Image::empty(&plan, &masks);
        Ok(Self {
            plan,
            cpu,
            gpu,
            other: image.clone(),
            image,
            report,
            unchecked: 0,
            stage_times_ns: StageTimes::default(),
        })
    }

    /// Images a ping set: judges the channels of every ping present, then images on the GPU if there is one that is trusted. A ping
    /// set that the GPU fails is done again on the CPU; `backend` of the result says which it was. Waits for no device but within
    /// the GPU's deadline: what is lost is opened anew elsewhere.
    ///
    /// # Errors
    /// [`BackendError::PingShape`] for pings that do not fit the plan; [`BackendError::Cpu`] when the CPU fails too.
    pub fn image(&mut self, pings: &PingSet) -> Result<&Image, BackendError> {
        cpu::check_pings(&self.plan, pings)?;
        self.cpu.judge(pings, &mut self.image.channels)?;
        if let Some(gpu) = &mut self.gpu {
            gpu.look_after();
            let imaged = gpu.image(pings, &mut self.image);
            self.unchecked = self.unchecked.saturating_add(1);
            if imaged {
                self.stage_times_ns = gpu.stage_times_ns();
                return Ok(&self.image);
            }
            self.pass_news_on();
        }
        self.cpu.image(pings, &mut self.image)?;
        self.stage_times_ns = self.cpu.stage_times_ns();
        Ok(&self.image)
    }

    /// Says what is known of a sensor's channels beside their samples; they are left out of its images from now on.
    pub fn set_known_channels(&mut self, sensor_index: usize, known: &[ChannelFinding]) {
        if let Some(report) = self.image.channels.get_mut(sensor_index) {
            report.set_known(known);
        }
    }

    /// To be called with the pings of the last image when its command is out: every [`CHECK_EVERY`] sets the CPU images too what
    /// the GPU imaged, and a GPU that was opened anew images what the CPU did; the images are compared. What is found wrong is
    /// not used again. Takes as long as the other backend takes, allocates nothing, does nothing without a GPU.
    pub fn cross_check(&mut self, pings: &PingSet) -> CrossCheck {
        let Some(gpu) = &mut self.gpu else { return CrossCheck::NotDue };
        if pings.sequence != self.image.sequence || pings.present != self.image.imaged {
            return CrossCheck::NotDue;
        }
        let found = match (gpu.trust(), self.image.backend) {
            (Trust::Trusted, BackendKind::Gpu) if self.unchecked >= CHECK_EVERY => match self.distance_on_cpu(pings) {
                Ok(distance) => self.compared(distance),
                // The next set will do.
                Err(_) => CrossCheck::NotDue,
            },
            (Trust::OnProbation, BackendKind::Cpu) => {
                std::mem::swap(&mut self.image.channels, &mut self.other.channels);
                let imaged = gpu.attempt(pings, &mut self.other);
                std::mem::swap(&mut self.image.channels, &mut self.other.channels);
                if imaged {
                    self.compared(distance(&self.other, &self.image));
                }
                // Nothing was decided from it.
                CrossCheck::Passed
            }
            _ => CrossCheck::NotDue,
        };
        self.pass_news_on();
        found
    }

    /// Images `pings` on the chosen backend and on the CPU, and says whether the images agree within [`AGREEMENT_MAX`]; `None`
    /// when the GPU failed this set, so that there is nothing to compare yet. True when the CPU is all there is.
    ///
    /// # Errors
    /// As [`Imager::image`].
    pub fn verify(&mut self, pings: &PingSet) -> Result<Option<bool>, BackendError> {
        self.image(pings)?;
        let Some(gpu) = &self.gpu else { return Ok(Some(true)) };
        if self.image.backend == BackendKind::Cpu {
            // While the GPU rests there is only the CPU to trust.
            return Ok((gpu.trust() != Trust::Trusted).then_some(true));
        }
        let distance = self.distance_on_cpu(pings)?;
        let found = self.compared(distance);
        self.pass_news_on();
        Ok(Some(found == CrossCheck::Passed))
    }

    /// Images `pings` on the CPU beside the last image and says how far that is from it.
    fn distance_on_cpu(&mut self, pings: &PingSet) -> Result<f64, BackendError> {
        std::mem::swap(&mut self.image.channels, &mut self.other.channels);
        let imaged = self.cpu.image(pings, &mut self.other);
        std::mem::swap(&mut self.image.channels, &mut self.other.channels);
        imaged.map(|()| distance(&self.image, &self.other))
    }

    fn compared(&mut self, distance: f64) -> CrossCheck {
        self.unchecked = 0;
        // Written so that a NaN distance is a disagreement.
        let agrees = distance <= AGREEMENT_MAX;
        if let Some(gpu) = &mut self.gpu {
            gpu.compared(distance, agrees);
        }
        if agrees { CrossCheck::Passed } else { CrossCheck::Mismatch }
    }

    /// Tells, once, who images from now on.
    fn pass_news_on(&mut self) {
        let Some(news) = self.gpu.as_mut().and_then(|gpu| gpu.news.take()) else { return };
        self.report = match news.kind {
            BackendKind::Gpu => news,
            BackendKind::Cpu => BackendReport { reason: news.reason, ..self.cpu.report().clone() },
        };
        let BackendReport { kind, adapter, reason, .. } = &self.report;
        log::warn!("imaging on {} ({adapter}): {reason}", kind.as_str());
    }

    /// Waits until a device that is being opened anew is open, or could not be. For simulations, whose time does not pass meanwhile; a
    /// robot's path of pings never waits for a device.
    pub fn wait_for_device(&self, limit: Duration) {
        if let Some(gpu) = &self.gpu {
            gpu.wait_for_device(limit);
        }
    }

    /// The last image made, as [`Imager::image`] returned it.
    #[must_use]
    pub fn last_image(&self) -> &Image {
        &self.image
    }

    /// The plan that is worked to.
    #[must_use]
    pub fn plan(&self) -> &Arc<ImagingPlan> {
        &self.plan
    }

    /// Logs which backend was taken, on what, and why: once a program, by whoever opens the first imager.
    pub fn announce(&self) {
        let BackendReport { kind, adapter, reason, .. } = &self.report;
        log::info!("imaging on {} ({adapter}): {reason}", kind.as_str());
    }

    /// Which backend is in use, on what, and why.
    #[must_use]
    pub fn report(&self) -> &BackendReport {
        &self.report
    }

    /// Ping sets that the GPU failed, since open. The CPU did again those of them that were used.
    #[must_use]
    pub fn redone_count(&self) -> u64 {
        self.gpu.as_ref().map_or(0, |gpu| gpu.failed_count)
    }

    /// GPU devices that were let go of, since open: lost, failed too often, or wrong.
    #[must_use]
    pub fn loss_count(&self) -> u64 {
        self.gpu.as_ref().map_or(0, |gpu| gpu.lost_count)
    }

    /// How far the GPU is trusted that was chosen at open; `None` when none was.
    #[must_use]
    pub fn trust(&self) -> Option<Trust> {
        self.gpu.as_ref().map(GpuGuard::trust)
    }

    /// The last failure of the GPU, if there was one.
    #[must_use]
    pub fn last_failure(&self) -> Option<&BackendError> {
        self.gpu.as_ref().and_then(|gpu| gpu.last_failure.as_ref())
    }

    /// Time of each stage of the last ping set, as [`Backend::stage_times_ns`].
    #[must_use]
    pub fn stage_times_ns(&self) -> StageTimes {
        self.stage_times_ns
    }

    /// Which backend images now.
    #[must_use]
    pub fn kind(&self) -> BackendKind {
        self.report.kind
    }
}

fn guarded(
    gpu: Box<dyn Backend>,
    opener: Option<Opener>,
    clock: SharedClock,
) -> Result<(GpuGuard, BackendReport), BackendError> {
    let report = gpu.report().clone();
    Ok((GpuGuard::new(gpu, opener, clock)?, report))
}

/// How far an image is from the reference: the largest relative L2 distance of any sensor's energyscape and of the rows' sums. NaN
/// when either holds one.
fn distance(image: &Image, reference: &Image) -> f64 {
    let scapes = image.energyscapes.iter().zip(&reference.energyscapes).zip(reference.imaged);
    let of_scapes = scapes
        .filter(|(_, imaged)| *imaged)
        .map(|((image, reference), _)| relative_l2(image.values.iter().copied().zip(reference.values.iter().copied())));
    let rows = || image.sums.iter().zip(&reference.sums);
    let sums = [
        relative_l2(rows().map(|(a, b)| (a.energy, b.energy))),
        relative_l2(rows().map(|(a, b)| (a.flow, b.flow))),
        relative_l2(rows().map(|(a, b)| (a.peak, b.peak))),
    ];
    largest(of_scapes.chain(sums))
}

/// The largest of some distances; NaN when one of them is, which `f64::max` would ignore.
fn largest(distances: impl Iterator<Item = f64>) -> f64 {
    distances.fold(0.0, |worst, next| if worst.is_nan() || next <= worst { worst } else { next })
}

/// |a - b| / |b|, zero when all are equal.
fn relative_l2(pairs: impl Iterator<Item = (f32, f32)>) -> f64 {
    let (mut distance, mut norm) = (0.0, 0.0);
    for (a, b) in pairs {
        // Equal infinities are equal.
        if a.to_bits() != b.to_bits() {
            distance += (f64::from(a) - f64::from(b)).powi(2);
        }
        norm += f64::from(b).powi(2);
    }
    if distance == 0.0 { 0.0 } else { (distance / norm).sqrt() }
}

#[cfg(not(feature = "gpu"))]
fn open_gpu(
    _: Arc<ImagingPlan>,
    _: Arc<MaskTable>,
    _allow_software: bool,
    _deadline_ms: u64,
) -> Result<Box<dyn Backend>, BackendError> {
    Err(BackendError::Unavailable("this program was built without the feature \"gpu\"".to_owned()))
}

#[cfg(feature = "gpu")]
fn open_gpu(
    plan: Arc<ImagingPlan>,
    masks: Arc<MaskTable>,
    allow_software: bool,
    deadline_ms: u64,
) -> Result<Box<dyn Backend>, BackendError> {
    let mut gpu = gpu::GpuBackend::open_caught(plan, masks, allow_software, deadline_ms)?;
    gpu.set_reason(if allow_software { "a GPU was asked for" } else { "it is the best hardware GPU here" }.to_owned());
    Ok(Box::new(gpu))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distance_that_is_no_number_is_never_forgotten_for_one_that_is() {
        for distances in [[f64::NAN, 0.0, 1.0], [0.0, f64::NAN, 1.0], [1.0, 0.0, f64::NAN]] {
            assert!(!(largest(distances.into_iter()) <= AGREEMENT_MAX), "{distances:?}");
        }
        assert_eq!(largest([0.5, 2.0, 1.0].into_iter()), 2.0);
        assert_eq!(largest(std::iter::empty()), 0.0);
    }
}
