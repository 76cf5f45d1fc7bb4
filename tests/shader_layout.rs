//! The uniform block has the same layout in Rust as in every shader, and the table of kernels is what the shaders declare.
//! Both are read back by naga from the very text that the GPU backend compiles.
#![cfg(feature = "gpu")]

use naga::{AddressSpace, Module, StorageAccess, TypeInner};
use noctule::imaging::backend::Stage;
use noctule::imaging::gpu::stage::{Access, KERNELS, source};
use noctule::imaging::gpu::{PARAMS_LAYOUT, Params};

fn module(text: &str) -> Module {
    naga::front::wgsl::parse_str(text).unwrap_or_else(|error| panic!("{}", error.emit_to_string(text)))
}

/// Name and offset of every member of a struct, and its size.
fn layout_of(module: &Module, name: &str) -> (Vec<(String, usize)>, usize) {
    let (_, ty) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).expect("the struct is declared");
    let TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is a struct") };
    let member = |member: &naga::StructMember| (member.name.clone().unwrap_or_default(), member.offset as usize);
    (members.iter().map(member).collect(), *span as usize)
}

fn layout_in_rust() -> Vec<(String, usize)> {
    PARAMS_LAYOUT.iter().map(|(name, offset)| ((*name).to_owned(), *offset)).collect()
}

#[test]
fn the_uniform_block_has_the_same_offsets_in_rust_and_in_every_shader() {
    for stage in Stage::ALL {
        let (members, size) = layout_of(&module(source(stage)), "Params");
        assert_eq!(members, layout_in_rust(), "{}", stage.stem());
        assert_eq!(size, size_of::<Params>(), "{}", stage.stem());
    }
}

#[test]
fn a_field_too_many_too_few_or_out_of_place_is_seen() {
    let text = source(Stage::Demodulate);
    for (from, to) in [
        ("    raw_count: u32,", "    raw_count: u32,\n    added: u32,"),
        ("    raw_count: u32,", ""),
        ("    raw_count: u32,", "    raw_total: u32,"),
        ("    raw_count: u32,", "    raw_count: vec2<u32>,"),
    ] {
        assert!(text.contains(from));
        let mut planted = text.replacen(from, to, 1);
        if to.is_empty() || to.contains("raw_total") || to.contains("vec2") {
            planted = planted.replace("params.raw_count", "params.raw_stride");
        }
        assert_ne!(layout_of(&module(&planted), "Params").0, layout_in_rust(), "{to:?}");
    }
}

/// The storage bindings that an entry point uses, directly or through what it calls.
fn used_bindings(module: &Module, info: &naga::valid::ModuleInfo, index: usize) -> Vec<(u32, Access)> {
    let mut used: Vec<(u32, Access)> = module
        .global_variables
        .iter()
        .filter(|(handle, _)| !info.get_entry_point(index)[*handle].is_empty())
        .filter_map(|(_, variable)| match (variable.space, &variable.binding) {
            (AddressSpace::Storage { access }, Some(binding)) => {
                let write = access.contains(StorageAccess::STORE);
                Some((binding.binding, if write { Access::Write } else { Access::Read }))
            }
            _ => None,
        })
        .collect();
    used.sort_by_key(|(binding, _)| *binding);
    used
}

#[test]
fn the_table_of_kernels_is_what_the_shaders_declare() {
    for stage in Stage::ALL {
        let module = module(source(stage));
        let mut validator =
            naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty());
        let info = validator.validate(&module).unwrap();
        let mut listed: Vec<&str> =
            KERNELS.iter().filter(|kernel| kernel.stage == stage).map(|kernel| kernel.entry_point).collect();
        for (index, entry) in module.entry_points.iter().enumerate() {
            let kernel = KERNELS.iter().find(|kernel| kernel.stage == stage && kernel.entry_point == entry.name);
            let kernel = kernel.unwrap_or_else(|| panic!("{}: {} is not in the table", stage.stem(), entry.name));
            assert_eq!(entry.workgroup_size, kernel.workgroup, "{}", entry.name);
            assert_eq!(used_bindings(&module, &info, index), kernel.bindings, "{}", entry.name);
            listed.retain(|name| *name != entry.name);
        }
        assert!(listed.is_empty(), "{}: no entry point {listed:?}", stage.stem());
    }
}

#[test]
fn kernels_stay_within_the_limits_that_every_webgpu_device_has() {
    for kernel in KERNELS {
        assert!(kernel.workgroup.iter().product::<u32>() <= 256, "{}", kernel.entry_point);
        assert!(kernel.bindings.len() <= 8, "{}", kernel.entry_point);
    }
    for stage in Stage::ALL {
        let module = module(source(stage));
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).unwrap();
        let shared = module.global_variables.iter().filter(|(_, variable)| variable.space == AddressSpace::WorkGroup);
        let bytes: u32 = shared.map(|(_, variable)| layouter[variable.ty].size).sum();
        assert!(bytes <= 16 << 10, "{}: {bytes} bytes of workgroup memory", stage.stem());
    }
}

#[test]
fn every_shader_says_what_it_computes_what_it_binds_and_who_its_twin_is() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/");
    for stage in Stage::ALL {
        let text = std::fs::read_to_string(format!("{folder}{}.wgsl", stage.stem())).unwrap();
        let header: String = text.lines().take_while(|line| line.starts_with("//")).collect();
        for word in ["Twin:", "Bindings:", "Workgroups "] {
            assert!(
                header.replace("Workgroups:", "Workgroups ").contains(word),
                "{}: no {word:?} in its header",
                stage.stem()
            );
        }
        assert!(header.contains("ne invocation") || header.contains("ne workgroup"), "{}", stage.stem());
        assert!(header.contains(&format!("src/imaging/cpu/{}.rs", stage.stem())), "{}", stage.stem());
    }
}
