//! What a GPU can do to us: be missing, be no GPU, be slow, get lost. Each is an error in time, never a panic and never a hang.
//! Without any adapter the tests that need one are skipped, unless `NOCTULE_REQUIRE_GPU=1`.
#![cfg(feature = "gpu")]

mod common;

use common::gpu::gpu;
use common::scenes::{Case, heavy, random_masks};
use noctule::imaging::backend::{Backend, BackendError, BackendKind, Image, Stage};
use noctule::imaging::gpu::{AdapterKind, GpuBackend, adapters};
use noctule::imaging::params::Prefer;
use noctule::imaging::plan::ImagingPlan;
use noctule::imaging::{Imager, ImagerOptions};
use noctule::signal::{MaskTable, PingSet, SampleFormat};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// More than a busy machine needs for a ping set.
const AMPLE_MS: u64 = 8000;

fn scene() -> (Arc<ImagingPlan>, Arc<MaskTable>, PingSet) {
    let case = Case::standard("device", SampleFormat::PcmF32, 1, 30);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    (plan, masks, case.random_pings(1))
}

fn open(plan: &Arc<ImagingPlan>, masks: &Arc<MaskTable>, deadline_ms: u64) -> GpuBackend {
    GpuBackend::open(Arc::clone(plan), Arc::clone(masks), true, deadline_ms).unwrap()
}

#[test]
fn a_destroyed_device_is_lost_at_every_call_and_nothing_panics() {
    if !gpu() {
        return;
    }
    let (plan, masks, pings) = scene();
    let mut backend = open(&plan, &masks, AMPLE_MS);
    let mut image = Image::empty(&plan, &masks);
    backend.image(&pings, &mut image).unwrap();
    backend.destroy_device();
    for _ in 0..3 {
        let start = Instant::now();
        let error = backend.image(&pings, &mut image).unwrap_err();
        assert!(matches!(error, BackendError::Lost(_)), "{error}");
        assert!(start.elapsed() < Duration::from_millis(500));
    }
    for stage in Stage::ALL {
        let error = backend.image_up_to(stage, &pings, 0, &mut image).unwrap_err();
        assert!(matches!(error, BackendError::Lost(_)), "{stage:?}: {error}");
    }
    drop(backend);
    open(&plan, &masks, AMPLE_MS).image(&pings, &mut image).unwrap();
}

#[test]
fn a_ping_set_of_a_lost_gpu_is_imaged_on_the_cpu() {
    if !gpu() {
        return;
    }
    let (plan, masks, pings) = scene();
    let gpu = open(&plan, &masks, AMPLE_MS);
    gpu.destroy_device();
    let mut imager = Imager::with_backends(plan, masks, Some(Box::new(gpu)), Some(1), "").unwrap();
    let image = imager.image(&pings).unwrap();
    assert_eq!(image.backend, BackendKind::Cpu);
    assert!(image.energyscapes[0].peak().1 > 0.0);
    assert!(matches!(imager.last_failure(), Some(BackendError::Lost(_))));
}

#[test]
fn a_device_that_is_late_is_given_up_at_the_deadline_and_not_waited_for_at_the_end() {
    if !gpu() {
        return;
    }
    let (plan, masks, pings) = heavy();
    let mut backend = open(&plan, &masks, 1);
    let mut image = Image::empty(&plan, &masks);
    let mut took = Vec::new();
    for _ in 0..5 {
        let start = Instant::now();
        let result = backend.image(&pings, &mut image);
        took.push(start.elapsed());
        match result {
            Err(BackendError::Timeout { limit_ms: 1 }) => {}
            Err(error) => panic!("{error}"),
            // A GPU that is faster has not failed.
            Ok(()) => assert_ne!(backend.adapter().kind, AdapterKind::Software),
        }
    }
    // The least of five, since other programs on this machine may hold us up; one wait without a limit would hold up all.
    let least = took.iter().min().unwrap();
    assert!(*least < Duration::from_millis(40), "{took:?}");
    let start = Instant::now();
    drop(backend);
    assert!(start.elapsed() < Duration::from_millis(200), "{:?}", start.elapsed());
}

#[test]
fn a_software_adapter_is_not_a_gpu_unless_asked_for() {
    if !gpu() {
        return;
    }
    let (plan, masks, _) = scene();
    let hardware = adapters().iter().any(|adapter| adapter.kind != AdapterKind::Software);
    match GpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), false, AMPLE_MS) {
        Ok(backend) => assert_ne!(backend.adapter().kind, AdapterKind::Software),
        Err(error) => {
            assert!(!hardware, "{error}");
            let text = error.to_string();
            assert!(
                matches!(error, BackendError::Unavailable(_)) && text.contains("software adapter is not a GPU"),
                "{text}"
            );
        }
    }
    let report = open(&plan, &masks, AMPLE_MS).report().clone();
    assert_eq!(report.kind, BackendKind::Gpu);
    assert!(hardware || report.adapter.contains("software"), "{}", report.adapter);
}

#[test]
fn the_best_kind_of_adapter_comes_first_and_refusals_have_a_reason() {
    let list = adapters();
    assert!(list.is_sorted_by_key(|adapter| adapter.kind));
    for adapter in list {
        assert!(["vulkan", "metal", "dx12"].contains(&adapter.backend.as_str()), "{adapter}");
        if adapter.kind == AdapterKind::Software {
            assert!(adapter.refused.is_some_and(|reason| reason.contains("software")));
        }
    }
}

#[test]
fn a_table_that_does_not_fit_the_plan_is_refused_in_words() {
    let (plan, masks, _) = scene();
    let mut table = MaskTable::clone(&masks);
    table.cells[0] = plan.grid.cell_count() as u32;
    let error = GpuBackend::open(plan, Arc::new(table), true, AMPLE_MS).unwrap_err();
    assert!(error.to_string().contains("the mask table names cell"), "{error}");
}

/// Set in the child process of the test below: names what it should find.
const CHILD: &str = "NOCTULE_TEST_WITHOUT_DRIVER";

/// The driver is chosen when a process first looks for one, so this test runs itself again with none to find.
#[test]
fn without_a_driver_the_gpu_is_unavailable_and_auto_takes_the_cpu() {
    if std::env::var_os(CHILD).is_none() {
        let itself = std::env::current_exe().unwrap();
        let output = Command::new(itself)
            .args(["--exact", "without_a_driver_the_gpu_is_unavailable_and_auto_takes_the_cpu", "--nocapture"])
            .env(CHILD, "1")
            .env("VK_DRIVER_FILES", "/nonexistent")
            .env("VK_ICD_FILENAMES", "/nonexistent")
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        return;
    }
    if cfg!(not(target_os = "linux")) {
        return;
    }
    assert_eq!(adapters(), Vec::new());
    let (plan, masks, pings) = scene();
    let error = GpuBackend::open(Arc::clone(&plan), Arc::clone(&masks), true, AMPLE_MS).unwrap_err();
    assert!(matches!(&error, BackendError::Unavailable(reason) if reason.contains("no Vulkan")), "{error}");
    let options = ImagerOptions::default();
    assert!(Imager::open(Arc::clone(&plan), Arc::clone(&masks), Prefer::Gpu, options).is_err());
    let mut imager = Imager::open(plan, masks, Prefer::Auto, options).unwrap();
    assert_eq!(imager.kind(), BackendKind::Cpu);
    assert!(imager.report().reason.contains("no Vulkan"), "{}", imager.report().reason);
    imager.image(&pings).unwrap();
}
