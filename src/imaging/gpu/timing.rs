//! Time of each stage on the device, by timestamp queries, where the adapter has them.
//!
//! In: the compute passes, one or more a stage. Out: nanoseconds a stage, read back behind the result. Never decides anything.

use super::device::Gpu;
use crate::imaging::backend::{Stage, StageTimes};

/// Most timestamps of a query set.
const QUERIES_MAX: usize = wgpu::QUERY_SET_MAX_QUERIES as usize;

/// The queries of one device.
#[derive(Debug)]
pub(super) struct Timing {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    tick_ns: f32,
    /// Stage of every compute pass, in order; each has two timestamps.
    passes: Vec<Stage>,
}

impl Timing {
    /// `None` where the device has no timestamps, or too few for so many passes.
    pub(super) fn new(gpu: &Gpu, passes: Vec<Stage>) -> Option<Self> {
        let tick_ns = gpu.tick_ns.filter(|_| 2 * passes.len() <= QUERIES_MAX)?;
        let queries = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("stage times"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * passes.len() as u32,
        });
        let resolved = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("stage times"),
            size: 16 * passes.len() as u64,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Some(Self { queries, resolved, tick_ns, passes })
    }

    /// Bytes of all timestamps.
    pub(super) fn bytes(&self) -> u64 {
        self.resolved.size()
    }

    /// What a compute pass writes.
    pub(super) fn writes(&self, pass: usize) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass as u32),
            end_of_pass_write_index: Some(2 * pass as u32 + 1),
        }
    }

    /// Copies the timestamps into `target` at `offset`.
    pub(super) fn resolve(&self, encoder: &mut wgpu::CommandEncoder, target: &wgpu::Buffer, offset: u64) {
        encoder.resolve_query_set(&self.queries, 0..2 * self.passes.len() as u32, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, target, offset, self.bytes());
    }

    /// Nanoseconds of each stage from the bytes of [`Timing::resolve`]; a time that runs backwards counts as not known.
    pub(super) fn stage_times_ns(&self, bytes: &[u8]) -> StageTimes {
        let tick = |index: usize| {
            let bytes = bytes.get(8 * index..8 * index + 8).and_then(|bytes| bytes.try_into().ok());
            bytes.map_or(0, u64::from_ne_bytes)
        };
        let mut ticks = StageTimes::default();
        for (pass, stage) in self.passes.iter().enumerate() {
            ticks[*stage as usize] += tick(2 * pass + 1).saturating_sub(tick(2 * pass));
        }
        ticks.map(|ticks| (ticks as f64 * f64::from(self.tick_ns)) as u64)
    }
}
