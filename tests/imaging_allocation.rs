//! The imager allocates nothing after its first ping set, whatever the format and the number of threads.
//! One test in a process of its own, since the allocator counts for all threads.

mod checks;
mod common;

use checks::{figure, is_the_test, is_the_test_runner, trials};
use common::scenes::{Case, random_masks};
use noctule::imaging::params::Prefer;
use noctule::imaging::{Imager, ImagerOptions};
use noctule::signal::SampleFormat;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The system's allocator with a counter.
struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is handed to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if !is_the_test_runner() {
            ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        }
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_ping_set_allocates_nothing_after_the_first() {
    is_the_test();
    let rounds = trials(10_000, 20);
    let mut most = 0;
    for format in [SampleFormat::PcmF32, SampleFormat::PcmI16, SampleFormat::Pdm] {
        let case = Case::standard("allocation", format, 2, 9);
        let plan = case.plan();
        let masks = random_masks(&plan, 7);
        let mut pings = case.random_pings(1);
        for threads in [1, 3] {
            let options = ImagerOptions { threads: Some(threads), ..ImagerOptions::default() };
            let mut imager = Imager::open(Arc::clone(&plan), Arc::clone(&masks), Prefer::Cpu, options).unwrap();
            imager.image(&pings).unwrap();
            let before = ALLOCATIONS.load(Ordering::Relaxed);
            for round in 0..rounds {
                pings.present[0] = round % 3 != 0;
                imager.image(&pings).unwrap();
            }
            let count = ALLOCATIONS.load(Ordering::Relaxed) - before;
            most = most.max(count);
            assert_eq!(count, 0, "{format:?} on {threads} threads: {count} allocations in {rounds} ping sets");
        }
    }
    figure(39, "allocations of the CPU backend, three formats, one and three threads", most, "0", 6 * rounds);
    // The counter counts.
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    std::hint::black_box(Vec::<u8>::with_capacity(100));
    assert!(ALLOCATIONS.load(Ordering::Relaxed) > before);
}
