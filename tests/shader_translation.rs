//! Every kernel, with the constants of a real pipeline, is valid and can be written as SPIR-V, Metal and Direct3D source.
//! Machines with those drivers are not needed: this is what wgpu's own translation would be given.
#![cfg(feature = "gpu")]

use naga::ShaderStage;
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use noctule::imaging::backend::Stage;
use noctule::imaging::gpu::stage::{KERNELS, source};

fn validated(text: &str) -> Result<(naga::Module, ModuleInfo), String> {
    let module = naga::front::wgsl::parse_str(text).map_err(|error| error.emit_to_string(text))?;
    // No capability beyond WebGPU's own: what passes here passes everywhere.
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .map_err(|error| error.emit_to_string(text))?;
    Ok((module, info))
}

/// Constants of a pipeline; a shader that does not declare one is not given it.
fn constants(text: &str) -> naga::back::PipelineConstants {
    let all = [
        ("PHASES", 8.0),
        ("RADIX_ROWS", 5.0),
        ("RADIX_COLUMNS", 5.0),
        ("LEN", 1250.0),
        ("SPAN", 25.0),
        ("SENSORS", 3.0),
        ("SENSOR_B", 1.0),
        ("SENSOR_C", 2.0),
        ("CHANNELS", 32.0),
    ];
    let declared = all.into_iter().filter(|(name, _)| text.contains(&format!("override {name}:")));
    declared.map(|(name, value)| (name.to_owned(), value)).collect()
}

#[test]
fn every_kernel_is_valid_and_written_for_vulkan_metal_and_direct3d() {
    for kernel in KERNELS {
        let text = source(kernel.stage);
        let (module, info) = validated(text).unwrap_or_else(|error| panic!("{}: {error}", kernel.stage.stem()));
        let entry = (ShaderStage::Compute, kernel.entry_point);
        let (module, info) =
            naga::back::pipeline_constants::process_overrides(&module, &info, Some(entry), &constants(text))
                .unwrap_or_else(|error| panic!("{}: {error}", kernel.entry_point));
        let name = (ShaderStage::Compute, kernel.entry_point.to_owned());

        let options = naga::back::spv::PipelineOptions { shader_stage: name.0, entry_point: name.1.clone() };
        let words = naga::back::spv::write_vec(&module, &info, &naga::back::spv::Options::default(), Some(&options))
            .unwrap_or_else(|error| panic!("{}: SPIR-V: {error}", kernel.entry_point));
        assert_eq!(words[0], 0x0723_0203, "SPIR-V begins with its magic number");

        let options = naga::back::msl::Options { lang_version: (2, 4), ..Default::default() };
        let pipeline = naga::back::msl::PipelineOptions { entry_point: Some(name.clone()), ..Default::default() };
        let (metal, _) = naga::back::msl::write_string(&module, &info, &options, &pipeline)
            .unwrap_or_else(|error| panic!("{}: Metal: {error}", kernel.entry_point));
        assert!(metal.contains(&format!("kernel void {}", kernel.entry_point)), "{}", kernel.entry_point);

        let options = naga::back::hlsl::Options::default();
        let pipeline = naga::back::hlsl::PipelineOptions { entry_point: Some(name) };
        let mut direct3d = String::new();
        naga::back::hlsl::Writer::new(&mut direct3d, &options, &pipeline)
            .write(&module, &info, None)
            .unwrap_or_else(|error| panic!("{}: Direct3D: {error}", kernel.entry_point));
        // The writers put an underscore behind a name that ends in a digit.
        assert!(direct3d.contains(&format!("void {}", kernel.entry_point)), "{}", kernel.entry_point);
    }
}

#[test]
fn a_fault_planted_in_a_shader_is_not_translated() {
    let text = source(Stage::DelayAndSum);
    for (from, to) in [
        ("frequency * turns", "bin * turns"),
        ("let quad = QUAD_FIRST + id.y;", ""),
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
