//! A reader of one sensor's energyscapes, for programs in Rust and for the library that C programs link.
//!
//! In: `noctule/sonar/<name>/energyscape`. Out: header and cells, shown where they lie in shared memory. Passes over what does not
//! fit its header and what is older than the last one shown; never publishes, never waits.

use super::error::IpcError;
use super::node::{Ipc, Needs, Registration};
use super::ports::SliceSubscriber;
use super::topics::Topic;
use super::wire::message::EnergyscapeHeader;
use std::cell::Cell;

/// Listens to the energyscapes of one sensor. The daemon may start, end and start again meanwhile.
#[derive(Debug)]
pub struct EnergyscapeReader {
    images: SliceSubscriber<f32, EnergyscapeHeader>,
    newest_ns: Cell<u64>,
    _registration: Registration,
}

impl EnergyscapeReader {
    /// Opens the topic of the sensor that the configuration calls `sensor`.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc, sensor: &str) -> Result<Self, IpcError> {
        let topic = Topic::energyscape(sensor);
        let needs = Needs::new().subscriber(&topic);
        let (registration, images) =
            ipc.set_up("noctule-reader", needs, move |session| session.slice_subscriber(&topic))?;
        Ok(Self { images, newest_ns: Cell::new(0), _registration: registration })
    }

    /// Shows what came since the last call to `read`, oldest first, and returns what it made of the last; `None` when nothing came.
    /// Cells are row-major `[direction][range]`, linear amplitude, 1 is full scale; they may be read in place, and belong to the
    /// transport again when `read` returns.
    pub fn newest<R>(&self, mut read: impl FnMut(&EnergyscapeHeader, &[f32]) -> R) -> Option<R> {
        let mut result = None;
        loop {
            let shown = self.images.next(|header, cells| {
                // What a dead publisher left can come after its successor's.
                let newer = header.t_monotonic_ns > self.newest_ns.get();
                (newer && header.describes(cells.len())).then(|| {
                    self.newest_ns.set(header.t_monotonic_ns);
                    read(header, cells)
                })
            });
            match shown {
                None => return result,
                Some(read) => result = read.or(result),
            }
        }
    }
}
