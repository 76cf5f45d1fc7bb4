//! The way back: one staging buffer, waits that end, and the checks that a result is the one asked for.
//!
//! In: a submission that ends with a copy into the staging buffer. Out: its bytes, or an error within the limit. The staging buffer
//! is filled by copies of a result that was poisoned before, so whatever did not run shows as poison or as an old nonce.
//!
//! Callbacks only run inside `Device::poll`, and there wgpu 30 panics when the driver loses the device. The panic is caught and
//! becomes [`BackendError::Lost`]; [`panic_is_a_lost_device`] tells it from others.

use super::device::Gpu;
use super::params::NONCE_WORDS;
use crate::imaging::backend::BackendError;
use crate::signal::RowSums;
use std::cell::Cell;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

/// A NaN that no computation makes: stands in every word of the result before a submission.
pub(super) const POISON: u32 = 0x7fc0_dead;

/// Most bytes of the buffer that the result is poisoned from, piece by piece.
const POISON_BYTES_MAX: u64 = 1 << 20;

/// Longest wait without a look at faults and limit.
const SLICE: Duration = Duration::from_millis(10);

thread_local! {
    static POLLING: Cell<bool> = const { Cell::new(false) };
}

/// Whether a panic on this thread, now, is wgpu's way to say that the driver lost the device. It is caught and becomes an error:
/// a panic hook that ends the process asks this first.
#[must_use]
pub fn panic_is_a_lost_device() -> bool {
    POLLING.get()
}

const IDLE: u8 = 0;
const MAPPING: u8 = 1;
const MAPPED: u8 = 2;
const FAILED: u8 = 3;

/// A buffer that the processor can read.
#[derive(Debug)]
pub(super) struct Staging {
    pub buffer: wgpu::Buffer,
    state: Arc<AtomicU8>,
}

impl Staging {
    pub(super) fn new(gpu: &Gpu, bytes: u64) -> Self {
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("staging"),
            size: bytes,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self { buffer, state: Arc::new(AtomicU8::new(IDLE)) }
    }

    /// Whether an earlier wait was given up and the device may still write.
    pub(super) fn is_pending(&self) -> bool {
        self.state.load(Ordering::Acquire) == MAPPING
    }

    /// Asks for the buffer; to be called right after the submission that fills it.
    pub(super) fn request(&self) {
        self.state.store(MAPPING, Ordering::Release);
        let state = Arc::clone(&self.state);
        self.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            state.store(if result.is_ok() { MAPPED } else { FAILED }, Ordering::Release);
        });
    }

    /// Waits until the buffer can be read.
    ///
    /// # Errors
    /// [`BackendError::Timeout`] at `deadline`; the request stays, see [`Staging::is_pending`]. Otherwise what the device recorded.
    pub(super) fn wait(&mut self, gpu: &Gpu, start: Instant, limit: Duration) -> Result<(), BackendError> {
        loop {
            match self.state.load(Ordering::Acquire) {
                MAPPED => return Ok(()),
                IDLE | FAILED => {
                    self.state.store(IDLE, Ordering::Release);
                    gpu.faults.check()?;
                    // A refused map is recorded as an error; one that fails in silence is what a lost device leaves behind.
                    gpu.faults.lose("the result cannot be read back");
                    return gpu.faults.check();
                }
                _ => {}
            }
            gpu.faults.check()?;
            let left = limit
                .checked_sub(start.elapsed())
                .ok_or(BackendError::Timeout { limit_ms: limit.as_millis() as u64 })?;
            let wait = wgpu::PollType::Wait { submission_index: None, timeout: Some(left.min(SLICE)) };
            match catching(|| gpu.device.poll(wait)) {
                Ok(Ok(_) | Err(wgpu::PollError::Timeout)) => {}
                Ok(Err(error)) => return Err(BackendError::Invalid(error.to_string())),
                Err(message) => gpu.faults.lose(&message),
            }
        }
    }

    /// Lends the bytes to `read`, then gives the buffer back to the device.
    ///
    /// # Errors
    /// If it is not mapped, or what `read` says.
    pub(super) fn read<T>(&mut self, read: impl FnOnce(&[u8]) -> Result<T, BackendError>) -> Result<T, BackendError> {
        let result = match self.buffer.get_mapped_range(..) {
            Ok(view) => read(&view),
            Err(error) => Err(BackendError::Invalid(error.to_string())),
        };
        self.release();
        result
    }

    /// Gives the buffer back to the device.
    pub(super) fn release(&mut self) {
        self.buffer.unmap();
        self.state.store(IDLE, Ordering::Release);
    }
}

/// A buffer of nothing but poison, for a result of so many bytes.
pub(super) fn poison_buffer(gpu: &Gpu, bytes: u64) -> wgpu::Buffer {
    let bytes = bytes.min(POISON_BYTES_MAX);
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("poison"),
        size: bytes,
        usage: wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    gpu.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(&vec![POISON; bytes as usize / 4]));
    buffer
}

/// Runs a call into wgpu that may panic; the panic's message is the error.
pub(super) fn catching<T>(call: impl FnOnce() -> T) -> Result<T, String> {
    POLLING.set(true);
    let result = std::panic::catch_unwind(AssertUnwindSafe(|| crate::life::panic::contained(call)));
    POLLING.set(false);
    result.map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
        text.unwrap_or("the driver lost the device").to_owned()
    })
}

/// Bits of the exponent, all set in infinities and NaN. Judged by bits: a comparison may be compiled as if there were neither.
const EXPONENT: u32 = 0x7f80_0000;

/// Refuses a result of another submission.
pub(super) fn check_nonce(found: &[u32], wanted: [u32; NONCE_WORDS]) -> Result<(), BackendError> {
    if found == wanted {
        return Ok(());
    }
    Err(BackendError::Invalid(format!("it bears the mark {found:x?} instead of {wanted:x?}")))
}

/// Refuses an image with a value that is not finite; poison is none.
pub(super) fn check_cells(sensor: usize, cells: &[u32]) -> Result<(), BackendError> {
    if cells.iter().all(|word| word & EXPONENT != EXPONENT) {
        return Ok(());
    }
    let left = cells.iter().filter(|word| **word == POISON).count();
    Err(BackendError::Invalid(format!("the image of sensor {sensor} is not finite, {left} cells were never written")))
}

/// One row's sums from the result. Energy, peak and distance may be infinite, but no word may be poison or NaN.
pub(super) fn checked_sums(words: &[u32]) -> Result<RowSums, BackendError> {
    let sums: RowSums = bytemuck::pod_read_unaligned(bytemuck::cast_slice(words));
    let floats = [sums.energy, sums.turn, sums.flow, sums.peak, sums.nearest_distance_m];
    let is_nan = |value: f32| value.to_bits() & !(1 << 31) > EXPONENT;
    if words.contains(&POISON) || floats.into_iter().any(is_nan) {
        return Err(BackendError::Invalid("a row of masked sums was never written or is not a number".to_owned()));
    }
    Ok(sums)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poison_infinity_and_nan_are_no_cells_and_the_largest_float_is_one() {
        let fine = [0.0_f32, 1e-40, f32::MAX].map(f32::to_bits);
        assert!(check_cells(0, &fine).is_ok());
        for bad in [POISON, f32::INFINITY.to_bits(), f32::NAN.to_bits(), f32::NEG_INFINITY.to_bits()] {
            assert!(matches!(check_cells(0, &[fine[0], bad]), Err(BackendError::Invalid(_))), "{bad:x}");
        }
    }

    #[test]
    fn infinite_energy_is_a_sum_and_poison_or_nan_is_none() {
        let silent: &[u32] = &bytemuck::cast::<RowSums, [u32; 8]>(RowSums::SILENT);
        assert_eq!(checked_sums(silent).unwrap(), RowSums::SILENT);
        let infinite = RowSums { energy: f32::INFINITY, peak: f32::INFINITY, ..RowSums::SILENT };
        assert!(checked_sums(&bytemuck::cast::<RowSums, [u32; 8]>(infinite)).is_ok());
        for word in 0..8 {
            let mut sums: [u32; 8] = bytemuck::cast(RowSums::SILENT);
            sums[word] = POISON;
            assert!(checked_sums(&sums).is_err(), "poison in word {word}");
        }
        let nan = RowSums { turn: f32::NAN, ..RowSums::SILENT };
        assert!(checked_sums(&bytemuck::cast::<RowSums, [u32; 8]>(nan)).is_err());
    }

    #[test]
    fn a_panic_in_poll_is_a_message_and_only_there_a_lost_device() {
        let seen = Arc::new(AtomicU8::new(0));
        let error = catching(|| {
            seen.store(u8::from(panic_is_a_lost_device()), Ordering::Relaxed);
            panic!("Error in Device::poll: {}", "gone");
        });
        assert_eq!(error, Err::<(), _>("Error in Device::poll: gone".to_owned()));
        assert_eq!(seen.load(Ordering::Relaxed), 1);
        assert!(!panic_is_a_lost_device());
    }

    #[test]
    fn every_word_of_the_nonce_counts() {
        let wanted = [1, 2, 3, 4];
        assert!(check_nonce(&wanted, wanted).is_ok());
        for word in 0..NONCE_WORDS {
            let mut found = wanted;
            found[word] = 9;
            assert!(check_nonce(&found, wanted).is_err(), "word {word}");
        }
    }
}
