//! Raw pings to energyscapes and masked sums.
//!
//! In: a [`PingSet`]. Out: an [`Image`]. [`Imager::open`] chooses the backend and says why; [`Imager::image`] judges the
//! channels, lets the backend image, and does a ping again on the CPU when the GPU fails it. Nothing numeric is here: what
//! is computed stands in [`plan`], how in the twins [`cpu`] and `gpu`.

pub mod backend;
pub mod channels;
pub mod cpu;
pub mod direct_path;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod params;
pub mod plan;
pub mod steering;

use crate::signal::{MaskTable, PingSet};
use backend::{Backend, BackendError, BackendKind, BackendReport, Image};
use channels::ChannelFinding;
use cpu::CpuBackend;
use params::Prefer;
use plan::ImagingPlan;
use std::sync::Arc;

/// Largest relative L2 distance between the energyscapes of the two backends: the accuracy that either owes to the
/// textbook (specification, section 3).
pub const AGREEMENT_MAX: f64 = 1e-4;

/// Pings in a row that the GPU may fail before the CPU takes over for good.
pub const GPU_FAILURES_MAX: u32 = 3;
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
    gpu: Option<Box<dyn Backend>>,
    image: Image,
    report: BackendReport,
    failures_in_a_row: u32,
    redone_count: u64,
    last_failure: Option<BackendError>,
    stage_times_ns: [u64; 5],
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
        let open_gpu = |allow_software: bool| {
            open_gpu(Arc::clone(&plan), Arc::clone(&masks), allow_software, options.gpu_deadline_ms)
        };
        let (gpu, reason) = match prefer {
            Prefer::Cpu => (None, "the configuration asks for the CPU".to_owned()),
            Prefer::Gpu => (Some(open_gpu(true)?), String::new()),
            Prefer::Auto => match open_gpu(false) {
                Ok(gpu) => (Some(gpu), String::new()),
                Err(error) => (None, format!("the CPU stands in: {error}")),
            },
        };
        Self::with_backends(plan, masks, gpu, options.threads, &reason)
    }

    /// As [`Imager::open`], with a GPU backend made elsewhere, or none; tests hand in one that fails. `cpu_reason` says why there is
    /// none.
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
        let cpu = CpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), threads)?;
        let report = match &gpu {
            Some(gpu) => gpu.report().clone(),
            None => BackendReport { reason: cpu_reason.to_owned(), ..cpu.report().clone() },
        };
        let image = Image::empty(&plan, &masks);
        Ok(Self {
            plan,
            cpu,
            gpu,
            image,
            report,
            failures_in_a_row: 0,
            redone_count: 0,
            last_failure: None,
            stage_times_ns: [0; 5],
        })
    }

    /// Images a ping set: judges the channels of every ping present, then images on the GPU if there is one. A ping set that the GPU
    /// fails is done again on the CPU; `backend` of the result says which it was.
    ///
    /// # Errors
    /// [`BackendError::PingShape`] for pings that do not fit the plan; [`BackendError::Cpu`] when the CPU fails too.
    pub fn image(&mut self, pings: &PingSet) -> Result<&Image, BackendError> {
        cpu::check_pings(&self.plan, pings)?;
        self.cpu.judge(pings, &mut self.image.channels)?;
        if let Some(gpu) = &mut self.gpu {
            match gpu.image(pings, &mut self.image) {
                Ok(()) => {
                    self.failures_in_a_row = 0;
                    self.stage_times_ns = gpu.stage_times_ns();
                    return Ok(&self.image);
                }
                Err(error) => self.gpu_failed(error),
            }
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

    /// Images `pings` on the chosen backend and on the CPU, and says whether the energyscapes agree within
    /// [`AGREEMENT_MAX`]; `None` when the GPU failed this set, so that there is nothing to compare yet. True without a
    /// GPU. Allocates: for the self-test, not for every ping.
    ///
    /// # Errors
    /// As [`Imager::image`].
    pub fn verify(&mut self, pings: &PingSet) -> Result<Option<bool>, BackendError> {
        self.image(pings)?;
        if self.image.backend == BackendKind::Cpu {
            return Ok(self.gpu.is_none().then_some(true));
        }
        let mut reference = self.image.clone();
        self.cpu.image(pings, &mut reference)?;
        let pairs = self.image.energyscapes.iter().zip(&reference.energyscapes);
        Ok(Some(pairs.zip(self.image.imaged).filter(|(_, imaged)| *imaged).all(|((image, reference), _)| {
            // Written so that a NaN difference is a disagreement.
            relative_l2(&image.values, &reference.values) <= AGREEMENT_MAX
        })))
    }

    /// Notes a failure of the GPU; gives it up when it is lost or has failed too often.
    fn gpu_failed(&mut self, error: BackendError) {
        self.redone_count += 1;
        self.failures_in_a_row += 1;
        log::warn!("ping set done again on the CPU: {error}");
        if matches!(error, BackendError::Lost(_)) || self.failures_in_a_row >= GPU_FAILURES_MAX {
            let reason =
                format!("the CPU took over for good after {} failed ping sets: {error}", self.failures_in_a_row);
            log::warn!("{reason}");
            self.gpu = None;
            self.report = BackendReport { reason, ..self.cpu.report().clone() };
        }
        self.last_failure = Some(error);
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

    /// Ping sets that the GPU failed and the CPU did again, since open.
    #[must_use]
    pub fn redone_count(&self) -> u64 {
        self.redone_count
    }

    /// The last failure of the GPU, if there was one.
    #[must_use]
    pub fn last_failure(&self) -> Option<&BackendError> {
        self.last_failure.as_ref()
    }

    /// Time of each stage of the last ping set, as [`Backend::stage_times_ns`].
    #[must_use]
    pub fn stage_times_ns(&self) -> [u64; 5] {
        self.stage_times_ns
    }

    /// Whether a ping set goes to the GPU first.
    #[must_use]
    pub fn kind(&self) -> BackendKind {
        self.report.kind
    }
}

/// |a - b| / |b|, zero when both are silent.
fn relative_l2(a: &[f32], b: &[f32]) -> f64 {
    let (mut distance, mut norm) = (0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        distance += (f64::from(*a) - f64::from(*b)).powi(2);
        norm += f64::from(*b).powi(2);
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
    let mut gpu = gpu::GpuBackend::open(plan, masks, allow_software, deadline_ms)?;
    gpu.set_reason(if allow_software { "a GPU was asked for" } else { "it is the best hardware GPU here" }.to_owned());
    Ok(Box::new(gpu))
}
