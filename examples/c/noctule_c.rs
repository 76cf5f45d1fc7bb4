//! A library for C and C++: opens a sensor's energyscapes and the robot's commands, waits for the next ones, copies them out.
//! `noctule_reader.h` says what each function does; `cargo build --release --example noctule_c` makes `libnoctule_c.so`.
//!
//! Every function contains panics: none unwinds into C. Never publishes.

use noctule::config::Config;
use noctule::io::wire::message::{EnergyscapeHeader, VelocityCommand};
use noctule::io::{EnergyscapeReader, Ipc, StatusTopics};
use noctule::time::{Clock, SystemClock};
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char, c_int};
use std::path::Path;
use std::time::{Duration, Instant};

const PAUSE: Duration = Duration::from_millis(1);
const NOTHING: c_int = 0;
const SOMETHING: c_int = 1;
const FAILED: c_int = -1;

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// What a C program holds.
pub struct Reader {
    images: EnergyscapeReader,
    status: StatusTopics,
    header: EnergyscapeHeader,
    cells: Vec<f32>,
}

impl Reader {
    fn open(config: Option<&str>, sensor: Option<&str>) -> Result<Self, String> {
        let config = config.map_or_else(|| Ok(Config::default()), |path| Config::load(Path::new(path)));
        let config = config.map_err(|error| error.to_string())?;
        let names: Vec<&str> = config.sensor.iter().map(|sensor| sensor.name.as_str()).collect();
        let sensor = sensor.or(names.first().copied()).unwrap_or_default();
        if !names.contains(&sensor) {
            return Err(format!("no sensor {sensor:?}; sensors are: {}", names.join(", ")));
        }
        let ipc = Ipc::open(&config.ipc).map_err(|error| error.to_string())?;
        Ok(Self {
            images: EnergyscapeReader::open(&ipc, sensor).map_err(|error| error.to_string())?,
            status: StatusTopics::open(&ipc).map_err(|error| error.to_string())?,
            header: EnergyscapeHeader::default(),
            cells: Vec::new(),
        })
    }

    /// Copies the newest image that came since the last call; whether there was one within `limit`.
    fn next(&mut self, limit: Duration) -> bool {
        let begun = Instant::now();
        loop {
            let Self { images, header, cells, .. } = self;
            let copied = images.newest(|new_header, new_cells| {
                *header = *new_header;
                cells.clear();
                cells.extend_from_slice(new_cells);
            });
            if copied.is_some() || begun.elapsed() >= limit {
                return copied.is_some();
            }
            std::thread::sleep(PAUSE);
        }
    }
}

fn remember(error: &str) {
    let text = CString::new(error.replace('\0', " ")).unwrap_or_default();
    LAST_ERROR.with_borrow_mut(|last| *last = text);
}

/// Runs `work`, turns a panic into `failed`.
fn contained<T>(failed: T, work: impl FnOnce() -> T) -> T {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_or_else(|_| {
        remember("internal error; see standard error");
        failed
    })
}

/// # Safety
/// `text` is null or ends with a zero byte.
unsafe fn text<'a>(text: *const c_char) -> Result<Option<&'a str>, String> {
    if text.is_null() {
        return Ok(None);
    }
    // SAFETY: not null, and the caller vouches for the end.
    let text = unsafe { CStr::from_ptr(text) };
    text.to_str().map(Some).map_err(|_| "a name that is not UTF-8".to_owned())
}

/// # Safety
/// `config` and `sensor` are null or end with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn noctule_open(config: *const c_char, sensor: *const c_char) -> *mut Reader {
    contained(std::ptr::null_mut(), || {
        // SAFETY: the caller's promise is ours.
        let names = unsafe { text(config).and_then(|config| Ok((config, text(sensor)?))) };
        match names.and_then(|(config, sensor)| Reader::open(config, sensor)) {
            Ok(reader) => Box::into_raw(Box::new(reader)),
            Err(error) => {
                remember(&error);
                std::ptr::null_mut()
            }
        }
    })
}

/// # Safety
/// `reader` comes from [`noctule_open`] and is used by one thread at a time; the other two are null or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn noctule_next(
    reader: *mut Reader,
    timeout_ms: u32,
    header: *mut *const EnergyscapeHeader,
    cells: *mut *const f32,
) -> c_int {
    contained(FAILED, || {
        // SAFETY: the caller vouches for the pointer and for being alone.
        let Some(reader) = (unsafe { reader.as_mut() }) else {
            remember("no reader");
            return FAILED;
        };
        if !reader.next(Duration::from_millis(u64::from(timeout_ms))) {
            return NOTHING;
        }
        // SAFETY: null, or the caller's to be written.
        unsafe {
            if !header.is_null() {
                header.write(&raw const reader.header);
            }
            if !cells.is_null() {
                cells.write(reader.cells.as_ptr());
            }
        }
        SOMETHING
    })
}

/// # Safety
/// As [`noctule_next`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn noctule_newest_command(reader: *mut Reader, command: *mut VelocityCommand) -> c_int {
    contained(FAILED, || {
        // SAFETY: the caller vouches for the pointer and for being alone.
        let Some(reader) = (unsafe { reader.as_ref() }) else {
            remember("no reader");
            return FAILED;
        };
        let Some(newest) = reader.status.command() else { return NOTHING };
        if !command.is_null() {
            // SAFETY: not null, and the caller's to be written.
            unsafe { command.write(newest) };
        }
        SOMETHING
    })
}

/// Nanoseconds of CLOCK_BOOTTIME, the clock of all stamps.
#[unsafe(no_mangle)]
pub extern "C" fn noctule_now_ns() -> u64 {
    SystemClock.now().boottime_ns
}

/// Why the last call of this thread failed; valid until its next one.
#[unsafe(no_mangle)]
pub extern "C" fn noctule_error() -> *const c_char {
    LAST_ERROR.with_borrow(|last| last.as_ptr())
}

/// # Safety
/// `reader` is null or comes from [`noctule_open`], and is not used any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn noctule_close(reader: *mut Reader) {
    contained((), || {
        if !reader.is_null() {
            // SAFETY: made by `noctule_open`, given back once.
            drop(unsafe { Box::from_raw(reader) });
        }
    });
}
