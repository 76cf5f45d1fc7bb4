//! A base driver to copy: what noctule-controller commands, made safe for motors by a watchdog of 250 ms of its own.
//!
//! In: `noctule/platform`, read by byte offsets as `noctule topics` prints them (nothing of the noctule crate is used). Out: what the motors
//! are told, and a record on standard output. The watchdog runs in a thread that never touches the transport: opening or reading
//! shared memory may hang, the motors must stop all the same. It judges by the stamp inside the sample, never by arrival.
//!
//!     cargo run --release --example base_driver -- /run/noctule noctule_      # root and prefix as in `noctule topics`
//!
//! The record has a line for each sample received (`S`) and for each change of what the motors are told (`M`).

use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Silence after which the motors stop.
pub const WATCHDOG_NS: u64 = 250_000_000;
/// A stamp this far ahead comes from a broken clock.
const AHEAD_MAX_NS: u64 = 50_000_000;
/// Period of the motor loop.
const TICK: Duration = Duration::from_millis(5);
/// Pause between two searches for a controller that is not there yet.
const SEARCH_PAUSE: Duration = Duration::from_millis(20);
/// Silence after which the reader opens its subscriber anew: the supervisor may have wiped all shared memory.
const REOPEN_NS: u64 = 1_000_000_000;
/// Name and schema of the type whose layout stands in [`Sample`].
const SERVICE: &str = "noctule/platform";
pub const SCHEMA_HASH: u64 = 0x00a1_73b4_f9f3_68da;

/// A sample: 120 bytes, every field at a multiple of four. The name is that of the wire type, whatever language reads it.
#[repr(C)]
#[derive(Debug, Clone, Copy, ZeroCopySend)]
#[type_name("noctule.PlatformVelocity.v1")]
pub struct Sample {
    words: [u64; 15],
}

/// Byte offsets of the fields that are read here.
pub mod offset {
    pub const SCHEMA_HASH: usize = 0;
    pub const SEQUENCE: usize = 8;
    pub const SENT_NS: usize = 16;
    pub const LINEAR_M_S: usize = 32;
    pub const ANGULAR_RAD_S: usize = 40;
    pub const EPOCH: usize = 48;
    pub const COMMAND_SEQUENCE: usize = 56;
    pub const CAPTURED_NS: usize = 64;
    pub const STATE: usize = 104;
    pub const REASON: usize = 108;
    pub const DAEMON_STATE: usize = 112;
}

impl Sample {
    pub fn new(words: [u64; 15]) -> Self {
        Self { words }
    }

    pub fn u64_at(&self, offset: usize) -> u64 {
        self.words.get(offset / 8).copied().unwrap_or(0)
    }

    pub fn f64_at(&self, offset: usize) -> f64 {
        f64::from_bits(self.u64_at(offset))
    }

    pub fn u32_at(&self, offset: usize) -> u32 {
        let bytes = self.u64_at(offset).to_ne_bytes();
        let half = if offset.is_multiple_of(8) {
            [bytes[0], bytes[1], bytes[2], bytes[3]]
        } else {
            [bytes[4], bytes[5], bytes[6], bytes[7]]
        };
        u32::from_ne_bytes(half)
    }
}

/// CLOCK_BOOTTIME: goes on while the machine sleeps, and no wall clock moves it.
pub fn now_ns() -> u64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    u64::try_from(time.tv_sec).unwrap_or(0) * 1_000_000_000 + u64::try_from(time.tv_nsec).unwrap_or(0)
}

/// What the motors are to do by the newest sample; read by the motor loop, written by the reader.
#[derive(Debug, Clone, Copy, Default)]
pub struct Wanted {
    pub sent_ns: u64,
    pub linear_m_s: f64,
    pub angular_rad_s: f64,
}

impl Wanted {
    /// Zero for anything that is old, from the future or not a number. Written so that whatever cannot be compared stops.
    pub fn at(&self, now_ns: u64) -> (f64, f64) {
        let young =
            now_ns.saturating_sub(self.sent_ns) <= WATCHDOG_NS && self.sent_ns.saturating_sub(now_ns) <= AHEAD_MAX_NS;
        if young && self.linear_m_s.is_finite() && self.angular_rad_s.is_finite() {
            (self.linear_m_s, self.angular_rad_s)
        } else {
            (0.0, 0.0)
        }
    }
}

/// Drives until `ended`; `record` is told everything. Put the motors where the line of an `M` is written.
pub fn drive(root: &str, prefix: &str, record: impl Write + Send + 'static, ended: impl Fn() -> bool) {
    let wanted = Arc::new(Mutex::new(Wanted::default()));
    let record = Arc::new(Mutex::new(record));
    let (shared, written) = (Arc::clone(&wanted), Arc::clone(&record));
    std::thread::spawn(move || {
        let mut told = None;
        loop {
            let now = now_ns();
            let motors = shared.lock().unwrap_or_else(PoisonError::into_inner).at(now);
            if told != Some(motors) {
                told = Some(motors);
                note(&written, &format!("M {now} {} {}", motors.0, motors.1));
            }
            std::thread::sleep(TICK);
        }
    });
    while !ended() {
        let Some((subscriber, _node)) = subscribe(root, prefix) else {
            std::thread::sleep(SEARCH_PAUSE);
            continue;
        };
        let mut heard_ns = now_ns();
        while now_ns().saturating_sub(heard_ns) < REOPEN_NS && !ended() {
            while let Ok(Some(sample)) = subscriber.receive() {
                heard_ns = now_ns();
                if let Some(newest) = read(&sample, heard_ns, &record) {
                    *wanted.lock().unwrap_or_else(PoisonError::into_inner) = newest;
                }
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Reads a sample, whoever wrote it; `None` for another layout.
fn read(sample: &Sample, received_ns: u64, record: &Mutex<impl Write>) -> Option<Wanted> {
    if sample.u64_at(offset::SCHEMA_HASH) != SCHEMA_HASH {
        return None;
    }
    let (sent_ns, sequence) = (sample.u64_at(offset::SENT_NS), sample.u64_at(offset::SEQUENCE));
    let (linear_m_s, angular_rad_s) = (sample.f64_at(offset::LINEAR_M_S), sample.f64_at(offset::ANGULAR_RAD_S));
    let (epoch, captured_ns) = (sample.u64_at(offset::EPOCH), sample.u64_at(offset::CAPTURED_NS));
    let command = sample.u64_at(offset::COMMAND_SEQUENCE);
    let (state, reason) = (sample.u32_at(offset::STATE), sample.u32_at(offset::REASON));
    let daemon_state = sample.u32_at(offset::DAEMON_STATE);
    note(
        record,
        &format!(
            "S {received_ns} {sent_ns} {sequence} {linear_m_s} {angular_rad_s} {epoch} {command} {captured_ns} {state} {reason} {daemon_state}"
        ),
    );
    Some(Wanted { sent_ns, linear_m_s, angular_rad_s })
}

/// One write call a line; a record that cannot be written stops no motor loop.
fn note(record: &Mutex<impl Write>, line: &str) {
    let _ = record.lock().unwrap_or_else(PoisonError::into_inner).write_all(format!("{line}\n").as_bytes());
}

type Reader = (Subscriber<ipc::Service, Sample, ()>, Node<ipc::Service>);

/// Opens the topic once the controller has made it. An explicit configuration: the transport's own search finds other people's files.
fn subscribe(root: &str, prefix: &str) -> Option<Reader> {
    let mut config = Config::default();
    config.global.set_root_path(&Path::new(root.as_bytes()).ok()?);
    config.global.prefix = FileName::new(prefix.as_bytes()).ok()?;
    if !std::path::Path::new(root).exists() {
        return None;
    }
    let node = NodeBuilder::new().config(&config).create::<ipc::Service>().ok()?;
    let service = node.service_builder(&SERVICE.try_into().ok()?).publish_subscribe::<Sample>();
    let schema = AttributeVerifier::new()
        .require(&"noctule.schema".try_into().ok()?, &format!("{SCHEMA_HASH:016x}").as_str().try_into().ok()?)
        .ok()?;
    let service = service.open_with_attributes(&schema).ok()?;
    Some((service.subscriber_builder().create().ok()?, node))
}

#[allow(dead_code, reason = "tests take this file as a module")]
fn main() {
    let mut arguments = std::env::args().skip(1);
    let root = arguments.next().unwrap_or_else(|| "/run/noctule".to_owned());
    let prefix = arguments.next().unwrap_or_else(|| "noctule_".to_owned());
    drive(&root, &prefix, std::io::stdout(), || false);
}
