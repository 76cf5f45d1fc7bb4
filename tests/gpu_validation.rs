//! An error of the Vulkan validation layers ends a test process: every GPU test listens, and a planted error is heard.
//! Without the layers the control is skipped, unless `NOCTULE_REQUIRE_VALIDATION=1`.
#![cfg(feature = "gpu")]

mod common;

use common::gpu::gpu;
use common::scenes::{Case, random_masks};
use noctule::imaging::backend::{Backend, Image};
use noctule::imaging::gpu::GpuBackend;
use noctule::signal::SampleFormat;
use std::process::{Command, Output};

/// Set in a child process: which of the two below it is.
const CHILD: &str = "NOCTULE_TEST_VALIDATION";

/// Runs one test of this file again, alone, with the layers on.
fn again(name: &str, child: &str) -> Output {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", name, "--nocapture"]).env(CHILD, child).env("WGPU_VALIDATION", "1").env("WGPU_DEBUG", "1");
    command.output().unwrap()
}

/// What only the layers see: a buffer of no size, asked for behind wgpu's own checks.
fn plant_an_error() {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle().with_env());
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
    let (device, _queue) = pollster::block_on(adapters[0].request_device(&wgpu::DeviceDescriptor::default())).unwrap();
    let descriptor = wgpu::hal::BufferDescriptor {
        label: None,
        size: 0,
        usage: wgpu::wgt::BufferUses::COPY_DST,
        memory_flags: wgpu::hal::MemoryFlags::empty(),
    };
    // SAFETY: the buffer is neither used nor bound; the process ends at the call or right after it.
    unsafe {
        let raw = device.as_hal::<wgpu::hal::api::Vulkan>().unwrap();
        let _ = wgpu::hal::Device::create_buffer(&*raw, &descriptor);
    }
    std::process::exit(0);
}

#[test]
fn a_planted_error_of_the_layers_ends_the_process_and_a_ping_set_does_not() {
    const NAME: &str = "a_planted_error_of_the_layers_ends_the_process_and_a_ping_set_does_not";
    match std::env::var(CHILD).as_deref() {
        Ok("planted") => {
            assert!(gpu());
            plant_an_error();
        }
        Ok(_) => {
            assert!(gpu());
            let case = Case::standard("validated", SampleFormat::Pdm, 2, 20);
            let plan = case.plan();
            let masks = random_masks(&plan, 3);
            let mut image = Image::empty(&plan, &masks);
            let mut backend = GpuBackend::open(plan, masks, true, 8000).unwrap();
            backend.image(&case.random_pings(1), &mut image).unwrap();
        }
        Err(_) if !gpu() => {}
        Err(_) => {
            let (clean, planted) = (again(NAME, "clean"), again(NAME, "planted"));
            let (clean_text, planted_text) =
                (String::from_utf8_lossy(&clean.stderr), String::from_utf8_lossy(&planted.stderr));
            // Layers before 2023 do not know WGSL, which debug information names as the source of a shader.
            let too_old = clean_text.contains("Invalid source language operand");
            if (planted.status.success() || too_old) && std::env::var("NOCTULE_REQUIRE_VALIDATION").is_err() {
                println!("skipped: there are no Vulkan validation layers, or they are older than WGSL");
                return;
            }
            assert!(clean.status.success(), "{clean_text}");
            let heard = planted_text.contains("the validation layers found an error");
            assert!(!planted.status.success() && heard, "the planted error passed unheard: {planted_text}");
        }
    }
}
