//! Time of each stage on the device, by timestamp queries, where the adapter has them.
//!
//! In: the stages as compute passes. Out: nanoseconds a stage, read back behind the result. Never decides anything.

use super::device::Gpu;
use crate::imaging::backend::Stage;

/// Two timestamps a stage.
const QUERIES: u32 = 2 * Stage::ALL.len() as u32;

/// Bytes of all timestamps.
pub(super) const TIMESTAMP_BYTES: u64 = 8 * QUERIES as u64;

/// The queries of one device.
#[derive(Debug)]
pub(super) struct Timing {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    tick_ns: f32,
}

impl Timing {
    /// `None` where the device has no timestamps.
    pub(super) fn new(gpu: &Gpu) -> Option<Self> {
        let tick_ns = gpu.tick_ns?;
        let queries = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("stage times"),
            ty: wgpu::QueryType::Timestamp,
            count: QUERIES,
        });
        let resolved = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("stage times"),
            size: TIMESTAMP_BYTES,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Some(Self { queries, resolved, tick_ns })
    }

    /// What the compute pass of a stage writes.
    pub(super) fn writes(&self, stage: Stage) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * stage as u32),
            end_of_pass_write_index: Some(2 * stage as u32 + 1),
        }
    }

    /// Copies the timestamps into `target` at `offset`.
    pub(super) fn resolve(&self, encoder: &mut wgpu::CommandEncoder, target: &wgpu::Buffer, offset: u64) {
        encoder.resolve_query_set(&self.queries, 0..QUERIES, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, target, offset, TIMESTAMP_BYTES);
    }

    /// Nanoseconds of each stage from the bytes of [`Timing::resolve`]; a time that runs backwards counts as not known.
    pub(super) fn stage_times_ns(&self, bytes: &[u8]) -> [u64; 5] {
        let tick = |index: usize| {
            let bytes = bytes.get(8 * index..8 * index + 8).and_then(|bytes| bytes.try_into().ok());
            bytes.map_or(0, u64::from_ne_bytes)
        };
        std::array::from_fn(|stage| {
            let ticks = tick(2 * stage + 1).saturating_sub(tick(2 * stage));
            (ticks as f64 * f64::from(self.tick_ns)) as u64
        })
    }
}
