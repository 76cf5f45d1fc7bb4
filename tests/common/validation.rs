//! What the driver's validation layers report ends the test process.
//!
//! wgpu hands their messages to `log`. A message cannot be laid at the door of one of the tests that run side by side, and a panic
//! would be caught on its way through the driver, so that the first error is printed past the capture of output and the process
//! aborts. `WGPU_VALIDATION=1` switches the layers on, `WGPU_DEBUG=1` lets wgpu hear them; without both this hears nothing.

use log::{Level, LevelFilter, Log, Metadata, Record};
use std::io::Write;
use std::sync::Once;

/// Where wgpu logs what the layers say.
const LAYERS: &str = "wgpu_hal::vulkan::instance";

struct Watch;

impl Log for Watch {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.level() == Level::Error && metadata.target() == LAYERS
    }

    fn log(&self, record: &Record<'_>) {
        if self.enabled(record.metadata()) {
            let _ = writeln!(std::io::stderr(), "the validation layers found an error: {}", record.args());
            std::process::abort();
        }
    }

    fn flush(&self) {}
}

/// Listens from now on; to be called before the first look for adapters.
pub fn watch() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        log::set_logger(&Watch).expect("no other logger hides what the layers say");
        log::set_max_level(LevelFilter::Error);
    });
}
