//! Contract: once it runs, the controller's thread allocates nothing of its own, driving or not. The transport takes and gives
//! back one small block for every sample sent (its reference-counted guard of the sample, in every variant of 0.10.0).

mod ipc_rig;

use ipc_rig::{Base, FakeDaemon, Metronome, Place, is, moves};
use noctule::controller_process::{ControllerParams, run};
use noctule::io::wire::message::Request;
use noctule::safety::{GateParams, MotionLimits, SafetyParams};
use noctule::signal::GateState;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::time::Duration;

static COUNTED: AtomicU64 = AtomicU64::new(0);
static LIVE_BYTES: AtomicI64 = AtomicI64::new(0);

thread_local! {
    static WATCHED: Cell<bool> = const { Cell::new(false) };
}

/// Counts the allocations of threads that asked for it.
struct Counting;

// SAFETY: every call goes unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if WATCHED.try_with(Cell::get).unwrap_or(false) {
            COUNTED.fetch_add(1, Ordering::Relaxed);
            LIVE_BYTES.fetch_add(layout.size() as i64, Ordering::Relaxed);
        }
        // SAFETY: as above.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        if WATCHED.try_with(Cell::get).unwrap_or(false) {
            LIVE_BYTES.fetch_sub(layout.size() as i64, Ordering::Relaxed);
        }
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn the_controllers_thread_allocates_nothing_of_its_own_while_it_drives_holds_and_latches() {
    let place = Place::new();
    let limits = MotionLimits { linear_m_s: 0.3, angular_rad_s: 1.0, linear_m_s2: 1.0, angular_rad_s2: 3.0 };
    let params =
        ControllerParams { ipc: place.params.clone(), gate: GateParams::new(&SafetyParams::default(), limits) };
    let stop = Arc::new(AtomicBool::new(false));
    let stopping = Arc::clone(&stop);
    let controller = std::thread::spawn(move || {
        WATCHED.with(|watched| watched.set(true));
        run(&params, false, &stopping).expect("ran");
        WATCHED.with(|watched| watched.set(false));
    });
    let mut daemon = FakeDaemon::new(&place.root(), &place.params.prefix, 5);
    let mut base = Base::new(&place);
    let soon = Duration::from_secs(5);
    base.listen_until(soon, || (), |_| true);
    assert!(COUNTED.load(Ordering::Relaxed) > 0, "the counter sees the start's allocations");

    let mut metronome = Metronome::new(Duration::from_millis(100));
    let mut every = || {
        if metronome.due() {
            daemon.send(|_| {});
        }
    };
    base.listen_for(Duration::from_millis(300), &mut every);
    base.ask(Request::Arm, 5);
    base.listen_until(soon, &mut every, |sample| is(sample, GateState::Track));
    // Everybody is connected now.
    let mark = |base: &mut Base| {
        base.listen();
        let sent = base.heard.last().expect("heard").sequence;
        (COUNTED.load(Ordering::Relaxed), LIVE_BYTES.load(Ordering::Relaxed), sent)
    };
    let before = mark(&mut base);
    base.listen_for(Duration::from_secs(2), &mut every);
    base.listen_until(soon, || (), |sample| is(sample, GateState::Hold));
    base.listen_until(soon, &mut every, |sample| is(sample, GateState::Track) && moves(sample));
    base.ask(Request::Stop, 0);
    base.listen_until(soon, &mut every, |sample| is(sample, GateState::Latched));
    base.listen_for(Duration::from_millis(500), &mut every);
    let after = mark(&mut base);
    stop.store(true, Ordering::Relaxed);
    controller.join().expect("ended");
    let (allocated, grown_bytes, sent) = (after.0 - before.0, after.1 - before.1, after.2 - before.2);
    assert!(sent > 100, "{sent} samples sent");
    // The two marks are each taken up to one sample beside the count of samples.
    assert!(allocated <= sent + 2, "{allocated} allocations for {sent} samples");
    assert!(grown_bytes.abs() <= 512, "{grown_bytes} bytes more than before: not one block in flight, a leak");
}
