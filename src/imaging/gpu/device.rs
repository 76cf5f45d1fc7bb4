//! Adapters and devices: which there are, which is taken, what it must be able to do, and how its loss shows.
//!
//! In: whether a software adapter will do, and the sizes of the buffers. Out: an open device or a sentence why there is none.
//! Only Vulkan, Metal and Direct3D 12 are looked at: OpenGL would be taken silently where a driver is missing. Nothing here
//! panics or waits: errors are recorded in [`Faults`], waits are in `readback.rs`.

use crate::imaging::backend::BackendError;
use std::sync::{Arc, Mutex, PoisonError};

/// Everything else is refused, even where wgpu supports it.
const BACKENDS: wgpu::Backends = wgpu::Backends::VULKAN.union(wgpu::Backends::METAL).union(wgpu::Backends::DX12);

/// What the kernels need of a device; all within WebGPU's defaults.
const STORAGE_BUFFERS: u32 = 5;
const INVOCATIONS: u32 = 128;
const WORKGROUP_BYTES: u32 = 4096;

/// What kind of processor an adapter is, best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    /// A GPU with memory of its own.
    Discrete,
    /// A GPU that shares the processor's memory.
    Integrated,
    /// A GPU of the host, seen from a virtual machine.
    Virtual,
    /// Not told by the driver.
    Other,
    /// A program on the processor: not a GPU.
    Software,
}

impl AdapterKind {
    fn of(device_type: wgpu::DeviceType) -> Self {
        match device_type {
            wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
            wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
            wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
            wgpu::DeviceType::Other => AdapterKind::Other,
            wgpu::DeviceType::Cpu => AdapterKind::Software,
        }
    }

    /// `discrete`, `integrated`, `virtual`, `other` or `software`.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            AdapterKind::Discrete => "discrete",
            AdapterKind::Integrated => "integrated",
            AdapterKind::Virtual => "virtual",
            AdapterKind::Other => "other",
            AdapterKind::Software => "software",
        }
    }
}

/// One adapter of this machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterDescription {
    /// Name of the device.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// `vulkan`, `metal` or `dx12`.
    pub backend: String,
    /// What it is.
    pub kind: AdapterKind,
    /// Why it is not taken for a GPU, or `None`.
    pub refused: Option<String>,
}

impl std::fmt::Display for AdapterDescription {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}, {}, {})", self.name, self.kind.as_str(), self.backend, self.driver)
    }
}

/// The adapters of this machine, best first, each with the reason why it would not be taken by itself.
#[must_use]
pub fn adapters() -> Vec<AdapterDescription> {
    candidates(false).into_iter().map(|(_, description)| description).collect()
}

/// The interfaces that are looked at and that this build was compiled with.
#[must_use]
pub fn compiled_backends() -> Vec<&'static str> {
    let compiled = BACKENDS & wgpu::Instance::enabled_backend_features();
    let names =
        [(wgpu::Backends::VULKAN, "Vulkan"), (wgpu::Backends::METAL, "Metal"), (wgpu::Backends::DX12, "Direct3D 12")];
    names.into_iter().filter(|(backend, _)| compiled.contains(*backend)).map(|(_, name)| name).collect()
}

fn candidates(allow_software: bool) -> Vec<(wgpu::Adapter, AdapterDescription)> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = BACKENDS;
    // Lets WGPU_VALIDATION=1 switch the driver's validation on.
    descriptor.flags = descriptor.flags.with_env();
    let instance = wgpu::Instance::new(descriptor);
    let adapters = pollster::block_on(instance.enumerate_adapters(BACKENDS));
    let mut found: Vec<_> = adapters.into_iter().map(|adapter| describe(adapter, allow_software)).collect();
    found.sort_by_key(|(_, description)| description.kind);
    found
}

fn describe(adapter: wgpu::Adapter, allow_software: bool) -> (wgpu::Adapter, AdapterDescription) {
    let info = adapter.get_info();
    let kind = AdapterKind::of(info.device_type);
    let driver = [info.driver.as_str(), info.driver_info.as_str()].map(str::trim).join(" ");
    let description = AdapterDescription {
        name: info.name,
        driver: driver.trim().to_owned(),
        backend: info.backend.to_str().to_owned(),
        kind,
        refused: if kind == AdapterKind::Software && !allow_software {
            Some(
                "a software adapter is not a GPU; it is taken only when the GPU backend is asked for by name"
                    .to_owned(),
            )
        } else {
            missing(&adapter.limits())
        },
    };
    (adapter, description)
}

/// What the adapter lacks whatever the plan is.
fn missing(limits: &wgpu::Limits) -> Option<String> {
    let needs = [
        ("storage buffers a stage", limits.max_storage_buffers_per_shader_stage, STORAGE_BUFFERS),
        ("threads a workgroup", limits.max_compute_invocations_per_workgroup, INVOCATIONS),
        ("bytes of workgroup memory", limits.max_compute_workgroup_storage_size, WORKGROUP_BYTES),
    ];
    let lack = needs.iter().find(|(_, found, needed)| found < needed);
    lack.map(|(what, found, needed)| format!("it has {found} {what}, {needed} are needed"))
}

/// The largest of what a plan needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Needs {
    /// Bytes of the largest buffer, and of the largest binding.
    pub buffer_bytes: u64,
    pub binding_bytes: u64,
    /// Most workgroups in one dimension of a dispatch.
    pub workgroups: u32,
}

/// What went wrong on a device, recorded by its callbacks; the first of each kind is kept.
#[derive(Debug, Default)]
pub(super) struct Faults {
    lost: Mutex<Option<String>>,
    error: Mutex<Option<String>>,
}

impl Faults {
    fn record(slot: &Mutex<Option<String>>, message: String) {
        slot.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(message);
    }

    fn read(slot: &Mutex<Option<String>>) -> Option<String> {
        slot.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The loss of the device if it is lost, else the first error since the last call.
    pub(super) fn check(&self) -> Result<(), BackendError> {
        if let Some(message) = Self::read(&self.lost) {
            return Err(BackendError::Lost(message));
        }
        match self.error.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(message) => Err(BackendError::Invalid(message)),
            None => Ok(()),
        }
    }

    /// Notes a loss that no callback told of.
    pub(super) fn lose(&self, message: &str) {
        Self::record(&self.lost, message.to_owned());
    }

    pub(super) fn is_lost(&self) -> bool {
        Self::read(&self.lost).is_some()
    }
}

/// An open device.
#[derive(Debug)]
pub(super) struct Gpu {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub faults: Arc<Faults>,
    pub description: AdapterDescription,
    /// Nanoseconds of a timestamp tick, where the device has timestamps.
    pub tick_ns: Option<f32>,
}

/// Opens the best adapter that fits.
///
/// # Errors
/// [`BackendError::Unavailable`] with the reason of every adapter.
pub(super) fn open(allow_software: bool, needs: Needs) -> Result<Gpu, BackendError> {
    let mut reasons = Vec::new();
    for (adapter, description) in candidates(allow_software) {
        let opened = match description.refused.clone() {
            Some(reason) => Err(reason),
            None => open_adapter(&adapter, description.clone(), needs),
        };
        match opened {
            Ok(gpu) => return Ok(gpu),
            Err(reason) => reasons.push(format!("{description}: {reason}")),
        }
    }
    Err(BackendError::Unavailable(if reasons.is_empty() {
        "there is no Vulkan, Metal or Direct3D 12 adapter".to_owned()
    } else {
        reasons.join("; ")
    }))
}

fn open_adapter(adapter: &wgpu::Adapter, description: AdapterDescription, needs: Needs) -> Result<Gpu, String> {
    let has = adapter.limits();
    let mut limits = wgpu::Limits::defaults().or_worse_values_from(&has);
    limits.max_buffer_size = limits.max_buffer_size.max(needs.buffer_bytes);
    for (what, needed, allowed) in [
        ("buffer", needs.buffer_bytes, has.max_buffer_size),
        ("binding", needs.binding_bytes, limits.max_storage_buffer_binding_size),
    ] {
        if needed > allowed {
            return Err(format!(
                "a {what} of {needed} bytes is needed, it allows {allowed}; fewer directions or ranges would do"
            ));
        }
    }
    if needs.workgroups > limits.max_compute_workgroups_per_dimension {
        return Err(format!(
            "{} workgroups in one dimension are needed, it allows {}",
            needs.workgroups, limits.max_compute_workgroups_per_dimension
        ));
    }
    let timestamps = adapter.features() & wgpu::Features::TIMESTAMP_QUERY;
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("noctule"),
        required_features: timestamps,
        required_limits: limits,
        ..Default::default()
    };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| error.to_string())?;
    let faults = Arc::new(Faults::default());
    let recorder = Arc::clone(&faults);
    // Without a handler of ours an error panics.
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| Faults::record(&recorder.error, error.to_string())));
    let recorder = Arc::clone(&faults);
    device.set_device_lost_callback(move |reason, message| {
        Faults::record(&recorder.lost, format!("{reason:?}: {message}"));
    });
    let tick_ns = (!timestamps.is_empty()).then(|| queue.get_timestamp_period());
    Ok(Gpu { device, queue, faults, description, tick_ns })
}
