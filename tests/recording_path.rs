//! Contract: recording costs whoever decides a copy and nothing else: no allocation, no wait for a writer that is stalled; what finds
//! no place is dropped and counted. A recorder that waits, planted, is found by the same judge.

mod checks;
mod record_rig;

use noctule::io::record::{Entry, RecordOptions, Recording, RunReader, Tally};
use noctule::safety::DaemonEvent;
use noctule::service::tape::Tape;
use record_rig::{Drive, EPOCH, config, subject};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use std::time::Duration;

thread_local! {
    static COUNTS: Cell<bool> = const { Cell::new(false) };
    static COUNTED: Cell<u64> = const { Cell::new(0) };
}

/// Counts the allocations of this thread while it asks for it.
struct Counting;

// SAFETY: every call goes unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if COUNTS.try_with(Cell::get).unwrap_or(false) {
            let _ = COUNTED.try_with(|counted| counted.set(counted.get() + 1));
        }
        // SAFETY: as above.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn counted(what: impl FnOnce()) -> u64 {
    let before = COUNTED.get();
    COUNTS.set(true);
    what();
    COUNTS.set(false);
    COUNTED.get() - before
}

fn options(path: &Path, patient: bool, slot_count: usize) -> RecordOptions {
    RecordOptions { patient, slot_count, reserve_bytes: 0, ..RecordOptions::new(path) }
}

#[test]
fn noting_and_copying_allocate_nothing() {
    let folder = tempfile::tempdir().expect("folder");
    let config = config();
    let mut drive = Drive::new(&config);
    let recording = Recording::start(&options(&folder.path().join("run.mcap"), false, 4), subject(&config));
    let Recording { tap, recorder } = recording.expect("started");
    let mut tape = Tape::new(tap, EPOCH, drive.begun());
    drive.tell(&mut tape, DaemonEvent::Started);
    drive.ping_set(&mut tape);
    let pings = drive.pings.clone();
    let images = drive.pipeline.image().energyscapes.clone();
    let grid = drive.setup.plan.grid.clone();
    let header = |index| Some(noctule::io::wire::message::EnergyscapeHeader::for_grid(&grid, index, 343.0));
    let headers = [header(0), header(1), header(2)];
    let now = drive.begun();
    // Some of the sets find a slot and some do not: both ways are free of allocations.
    let found = counted(|| {
        for _ in 0..64 {
            tape.told(&DaemonEvent::Tick, now);
            tape.before(now, &pings, noctule::signal::Velocity::ZERO, None);
            tape.command(now, noctule::io::wire::message::VelocityCommand::blank());
            tape.after(now, &pings, &images, &headers);
        }
    });
    drop(tape);
    let tally = recorder.finish(Duration::from_secs(60)).expect("finished");
    checks::figure(39, "allocations of the deciding thread for recording", found, "0", 64);
    // A set that is dropped may be told in the log, the first time and ever more rarely.
    let told = 8 * u64::from(tally.dropped_sets > 0);
    assert!(found <= 4 * told, "{found} allocations, {tally:?}");
    assert!(counted(|| drop(std::hint::black_box(vec![1_u8; 16]))) >= 1, "the measure sees one");
}

/// Eight ping sets recorded by a writer that takes a fifth of a second for each image: longest time that the tape took, and the tally.
fn beside_a_stalled_writer(path: &Path, patient: bool) -> (Duration, Tally) {
    let config = config();
    let mut subject = subject(&config);
    for scanner in &mut subject.scanners {
        *scanner = Box::new(|_, _| std::thread::sleep(Duration::from_millis(200)));
    }
    let mut drive = Drive::new(&config);
    let Recording { tap, recorder } = Recording::start(&options(path, patient, 3), subject).expect("started");
    let mut tape = Tape::new(tap, EPOCH, drive.begun());
    drive.tell(&mut tape, DaemonEvent::Started);
    let longest = (0..8).map(|_| drive.ping_set(&mut tape)).max().unwrap_or_default();
    drop(tape);
    (longest, recorder.finish(Duration::from_secs(60)).expect("finished"))
}

#[test]
fn a_stalled_writer_delays_no_command_and_what_it_misses_is_counted() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("run.mcap");
    let (longest, tally) = beside_a_stalled_writer(&path, false);
    let told = format!("{:.1} ms", longest.as_secs_f64() * 1e3);
    checks::figure(37, "longest wait of the deciding thread for a stalled recorder", told, "< 100 ms", 8);
    // A copy of three pings and images takes 1 ms; a busy machine may take the processor away for some time slices. Waiting for the
    // writer takes 600 ms.
    assert!(longest < Duration::from_millis(100), "{longest:?}");
    assert!(tally.dropped_sets >= 1 && tally.dropped_notes == 0, "{tally:?}");
    // What is missing is known in the file: its steps are there, without pings.
    let mut reader = RunReader::open(&path).expect("opened");
    let (mut with, mut without) = (0, 0);
    while let Some(entry) = reader.next_entry().expect("whole") {
        if let Entry::Step(step) = entry
            && step.kind == 1
        {
            with += u64::from(step.has_pings == 1);
            without += u64::from(step.has_pings == 0);
        }
    }
    assert_eq!((with + without, without), (8, tally.dropped_sets));

    // Negative control: a recorder that waits for a place is seen to delay.
    let (longest, tally) = beside_a_stalled_writer(&folder.path().join("patient.mcap"), true);
    assert!(longest > Duration::from_millis(300), "the planted wait was not seen: {longest:?}");
    assert_eq!(tally.dropped_sets, 0);
}
