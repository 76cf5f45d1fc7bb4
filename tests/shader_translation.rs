//! Every pipeline that the backend builds is valid and can be written as SPIR-V, Metal and Direct3D source; Tint accepts it, too.
//! Machines with those drivers are not needed: this is what wgpu's own translation would be given. Without `tint` its part is skipped.
#![cfg(feature = "gpu")]

mod common;

use common::scenes::{Case, Sweep, random_array, random_masks};
use naga::ShaderStage;
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use noctule::imaging::backend::Stage;
use noctule::imaging::gpu::stage::{KERNELS, source};
use noctule::imaging::gpu::{PipelineUse, pipelines};
use noctule::imaging::params::ImagingParams;
use noctule::sensor::RecordingFormat;
use noctule::signal::{Direction, SampleFormat};
use std::collections::HashMap;
use std::process::Command;

fn validated(text: &str) -> Result<(naga::Module, ModuleInfo), String> {
    let module = naga::front::wgsl::parse_str(text).map_err(|error| error.emit_to_string(text))?;
    // No capability beyond WebGPU's own: what passes here passes everywhere.
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .map_err(|error| error.emit_to_string(text))?;
    Ok((module, info))
}

/// Every pipeline that the backend builds for these plans, and the plans themselves by name: default sizes in every format with one
/// to three sensors, a wide array, several arrays, a grid without mirror images, smoothing, one without any folding, and one with
/// CLEAN.
fn all_pipelines() -> Vec<PipelineUse> {
    let mut cases = Vec::new();
    for format in [SampleFormat::Pdm, SampleFormat::PcmI16, SampleFormat::PcmF32] {
        cases.extend((1..=3).map(|sensors| Case::standard("default", format, sensors, 1)));
    }
    let pcm = |sample_rate_hz, samples| RecordingFormat {
        format: SampleFormat::PcmF32,
        sample_rate_hz,
        samples,
        decimation: 1,
    };
    let bearings = |count: u32| -> Vec<Direction> {
        (0..count)
            .map(|i| Direction::horizontal((-89.5 + 179.0 * f64::from(i) / f64::from(count)).to_radians()))
            .collect()
    };
    // The wide case of the performance section: 80 to 20 kHz, 13,122 samples, 180 bearings.
    let arrays = vec![random_array(32, 0.1, true, 1); 3];
    let mut wide = Case::new("wide", arrays, Sweep::new(80e3, 20e3, 450e3), pcm(450e3, 13_122), bearings(180));
    wide.params = ImagingParams { range_min_m: 0.01, range_max_m: 4.5, range_step_m: Some(4.573e-3), ..wide.params };
    cases.push(wide);
    let arrays = vec![random_array(256, 0.2, false, 2), random_array(9, 0.05, true, 3)];
    let mut mixed = Case::new("mixed", arrays, Sweep::new(50e3, 25e3, 250e3), pcm(250e3, 7919), bearings(2000));
    mixed.params = ImagingParams { smoothing_hz: Some(900.0), range_min_m: 0.3, range_max_m: 4.1, ..mixed.params };
    cases.push(mixed);
    let mut coarse = Case::standard("coarse", SampleFormat::PcmI16, 1, 7);
    coarse.params = ImagingParams { range_step_m: Some(0.05), ..coarse.params };
    cases.push(coarse);
    let mut clean = Case::standard("clean", SampleFormat::PcmF32, 2, 3);
    clean.params.clean_rounds = Some(2);
    cases.push(clean);
    let mut all: Vec<PipelineUse> = Vec::new();
    for case in cases {
        let plan = case.plan();
        for pipeline in pipelines(&plan, &random_masks(&plan, 1)).unwrap() {
            if !all.contains(&pipeline) {
                all.push(pipeline);
            }
        }
    }
    all
}

#[test]
fn every_pipeline_is_valid_and_written_for_vulkan_metal_and_direct3d() {
    let pipelines = all_pipelines();
    for kernel in KERNELS {
        let used = pipelines.iter().any(|pipeline| pipeline.entry_point == kernel.entry_point);
        assert!(used, "no plan here uses {}", kernel.entry_point);
    }
    let mut modules = HashMap::new();
    for pipeline in &pipelines {
        let (module, info) = modules.entry(pipeline.stage).or_insert_with(|| {
            validated(source(pipeline.stage)).unwrap_or_else(|error| panic!("{}: {error}", pipeline.stage.stem()))
        });
        translate(module, info, pipeline);
    }
    println!("{} pipelines", pipelines.len());
}

/// Writes one pipeline in all three languages.
fn translate(module: &naga::Module, info: &ModuleInfo, pipeline: &PipelineUse) {
    let entry = (ShaderStage::Compute, pipeline.entry_point);
    let constants: naga::back::PipelineConstants =
        pipeline.constants.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
    let (module, info) = naga::back::pipeline_constants::process_overrides(module, info, Some(entry), &constants)
        .unwrap_or_else(|error| panic!("{pipeline:?}: {error}"));
    let name = (ShaderStage::Compute, pipeline.entry_point.to_owned());

    let options = naga::back::spv::PipelineOptions { shader_stage: name.0, entry_point: name.1.clone() };
    let words = naga::back::spv::write_vec(&module, &info, &naga::back::spv::Options::default(), Some(&options))
        .unwrap_or_else(|error| panic!("{pipeline:?}: SPIR-V: {error}"));
    assert_eq!(words[0], 0x0723_0203, "SPIR-V begins with its magic number");

    let options = naga::back::msl::Options { lang_version: (2, 4), ..Default::default() };
    let msl = naga::back::msl::PipelineOptions { entry_point: Some(name.clone()), ..Default::default() };
    let (metal, _) = naga::back::msl::write_string(&module, &info, &options, &msl)
        .unwrap_or_else(|error| panic!("{pipeline:?}: Metal: {error}"));
    assert!(metal.contains(&format!("kernel void {}", pipeline.entry_point)), "{pipeline:?}");

    let options = naga::back::hlsl::Options::default();
    let hlsl = naga::back::hlsl::PipelineOptions { entry_point: Some(name) };
    let mut direct3d = String::new();
    naga::back::hlsl::Writer::new(&mut direct3d, &options, &hlsl)
        .write(&module, &info, None)
        .unwrap_or_else(|error| panic!("{pipeline:?}: Direct3D: {error}"));
    // The writers put an underscore behind a name that ends in a digit.
    assert!(direct3d.contains(&format!("void {}", pipeline.entry_point)), "{pipeline:?}");
}

/// Whether Tint, the compiler of another WebGPU implementation, accepts a text with these constants; what it says otherwise.
fn tint(text: &str, pipeline: &PipelineUse) -> Result<(), String> {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("kernel.wgsl"), folder.path().join("out.wgsl"));
    std::fs::write(&input, text).unwrap();
    let overrides: Vec<String> = pipeline.constants.iter().map(|(name, value)| format!("{name}={value}")).collect();
    let mut command = Command::new("tint");
    command.arg("--entry-point").arg(pipeline.entry_point).arg("-o").arg(output);
    if !overrides.is_empty() {
        command.arg("--overrides").arg(overrides.join(","));
    }
    let run = command.arg(input).output().unwrap();
    let said = [run.stdout, run.stderr].concat();
    if run.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&said).into_owned()) }
}

#[test]
fn the_compiler_of_another_webgpu_implementation_accepts_every_pipeline() {
    if Command::new("tint").arg("--help").output().is_err() {
        println!("skipped: tint is not on PATH");
        return;
    }
    let pipelines = all_pipelines();
    for pipeline in &pipelines {
        tint(source(pipeline.stage), pipeline).unwrap_or_else(|error| panic!("{pipeline:?}: {error}"));
    }
    // Negative control: the faults of the test below are faults to Tint as well.
    let last = pipelines.iter().find(|pipeline| pipeline.stage == Stage::DelayAndSum).unwrap();
    let planted = source(Stage::DelayAndSum).replacen("frequency * turns", "bin * turns", 1);
    assert!(tint(&planted, last).is_err());
}

#[test]
fn a_fault_planted_in_a_shader_is_not_translated() {
    let text = source(Stage::DelayAndSum);
    for (from, to) in [
        ("frequency * turns", "bin * turns"),
        ("let quad = params.quad_first + id.y;", ""),
        ("var<storage, read_write> output", "var<storage, read> output"),
    ] {
        assert!(text.contains(from), "{from}");
        assert!(validated(&text.replacen(from, to, 1)).is_err(), "{from}");
    }
}

#[test]
fn no_shader_trusts_the_sine_of_the_language() {
    // WGSL promises an absolute error of 2^-11 only; steering needs 2^-20.
    for stage in Stage::ALL {
        let module = validated(source(stage)).unwrap().0;
        let functions = module.functions.iter().map(|(_, function)| function);
        let entries = module.entry_points.iter().map(|entry| &entry.function);
        for function in functions.chain(entries) {
            for (_, expression) in function.expressions.iter() {
                if let naga::Expression::Math { fun, .. } = expression {
                    use naga::MathFunction::{Cos, Sin, Tan};
                    assert!(!matches!(fun, Sin | Cos | Tan), "{}: {:?}", stage.stem(), function.name);
                }
            }
        }
    }
}
