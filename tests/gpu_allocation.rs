//! Check 39, GPU half: a ping set on the GPU allocates the same again and again and keeps nothing of it; comparing it with the CPU's
//! image allocates nothing. One test in a process of its own, since the allocator counts for all threads.
#![cfg(feature = "gpu")]

mod checks;
mod common;

use checks::{figure, is_the_test, is_the_test_runner, trials};
use common::gpu::gpu;
use common::scenes::{Case, random_masks};
use noctule::imaging::backend::BackendKind;
use noctule::imaging::cpu::CpuBackend;
use noctule::imaging::drill::Drill;
use noctule::imaging::gpu::GpuBackend;
use noctule::imaging::{CHECK_EVERY, CrossCheck, Imager};
use noctule::signal::SampleFormat;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

/// The system's allocator with counters of calls and of bytes that were not given back.
struct Counting;

static CALLS: AtomicI64 = AtomicI64::new(0);
static LIVE_BYTES: AtomicI64 = AtomicI64::new(0);

// SAFETY: every call is handed to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if !is_the_test_runner() {
            CALLS.fetch_add(1, Ordering::Relaxed);
            LIVE_BYTES.fetch_add(layout.size() as i64, Ordering::Relaxed);
        }
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        if !is_the_test_runner() {
            LIVE_BYTES.fetch_sub(layout.size() as i64, Ordering::Relaxed);
        }
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn now() -> (i64, i64) {
    (CALLS.load(Ordering::Relaxed), LIVE_BYTES.load(Ordering::Relaxed))
}

#[test]
fn a_ping_set_on_the_gpu_leaves_nothing_allocated_and_its_comparison_allocates_nothing() {
    is_the_test();
    let case = Case::standard("allocation", SampleFormat::PcmF32, 2, 30);
    let (plan, mut pings) = (case.plan(), case.random_pings(1));
    let masks = random_masks(&plan, 7);
    // Quarantine, checks and comparison around a device that allocates nothing itself.
    let cpu = CpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), Some(1)).unwrap();
    let drill = Box::new(Drill::new(Box::new(cpu), Box::new(|_| None)));
    let mut imager = Imager::with_backends(Arc::clone(&plan), Arc::clone(&masks), Some(drill), Some(1), "").unwrap();
    let mut frame = |imager: &mut Imager| {
        pings.sequence += 1;
        assert_eq!(imager.image(&pings).unwrap().backend, BackendKind::Gpu);
        imager.cross_check(&pings)
    };
    frame(&mut imager);
    // Asked before the counting begins: looking at the environment allocates, and so does the test runner after a minute.
    let frames = trials(10_000, 400);
    let before = now();
    let compared = (0..frames).filter(|_| frame(&mut imager) == CrossCheck::Passed).count();
    assert!(compared >= frames / CHECK_EVERY as usize);
    // Read before it is told: telling allocates.
    let after = now();
    figure(39, "allocations around the GPU's own", after.0 - before.0, "0", frames);
    assert_eq!(after, before);

    if !gpu() {
        return;
    }
    let device = GpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), true, 8000).unwrap();
    let mut imager = Imager::with_backends(plan, masks, Some(Box::new(device)), Some(1), "").unwrap();
    (0..100).for_each(|_| assert_ne!(frame(&mut imager), CrossCheck::Mismatch));
    let blocks = 5;
    let of_block = trials(2000, 40);
    let mut counts = Vec::new();
    let (_, live_before) = now();
    for _ in 0..blocks {
        let (before, _) = now();
        (0..of_block).for_each(|_| assert_ne!(frame(&mut imager), CrossCheck::Mismatch));
        counts.push((now().0 - before) as f64 / of_block as f64);
    }
    let kept = now().1 - live_before;
    let (least, most) =
        counts.iter().fold((f64::MAX, 0.0_f64), |(least, most), count| (least.min(*count), most.max(*count)));
    figure(
        39,
        "allocations of a ping set on the GPU, by block",
        format!("{least:.1} to {most:.1}"),
        "constant",
        blocks * of_block,
    );
    figure(39, "bytes kept of all ping sets on the GPU", kept, "0", blocks * of_block);
    assert!(most - least <= 0.02 * least, "{counts:?}");
    // Lists of the library may have grown once more; a leak of one block a ping set would be far above.
    assert!(kept.abs() <= 4096, "{kept} bytes after {} ping sets", blocks * of_block);
    // The counter counts.
    let (before, _) = now();
    std::hint::black_box(Vec::<u8>::with_capacity(100));
    assert!(now().0 > before);
}
