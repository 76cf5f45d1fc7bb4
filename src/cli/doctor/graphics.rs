//! Which adapters there are, and why a GPU is not seen.
//!
//! In: what the configuration prefers, and the machine. Out: lines. The adapters are listed by the imaging itself, in a thread that
//! is left behind when a driver hangs.

use super::Line;
use crate::imaging::params::Prefer;
use std::path::{Path, PathBuf};

const ABOUT: &str = "gpu";
/// Variables that change what the Vulkan loader or a driver shows.
const VARIABLES: [&str; 8] = [
    "VK_DRIVER_FILES",
    "VK_ICD_FILENAMES",
    "VK_ADD_DRIVER_FILES",
    "VK_LOADER_DRIVERS_SELECT",
    "VK_LOADER_DRIVERS_DISABLE",
    "MESA_VK_DEVICE_SELECT",
    "CUDA_VISIBLE_DEVICES",
    "NVIDIA_VISIBLE_DEVICES",
];
/// Where distributions put the loader.
const LIBRARY_FOLDERS: [&str; 9] = [
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib/arm-linux-gnueabihf",
    "/lib/x86_64-linux-gnu",
    "/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/run/opengl-driver/lib",
];
const DRIVER_FOLDERS: [&str; 4] = [
    "/usr/share/vulkan/icd.d",
    "/etc/vulkan/icd.d",
    "/usr/local/share/vulkan/icd.d",
    "/run/opengl-driver/share/vulkan/icd.d",
];

pub(super) fn look(prefer: Prefer, lines: &mut Vec<Line>) {
    let usable = adapters(prefer, lines);
    if !usable {
        reasons(lines);
        let found = "no GPU is usable: the CPU images";
        let remedy = "the reasons stand above; imaging.backend = \"auto\" or \"cpu\" does without";
        lines.push(match prefer {
            Prefer::Gpu => {
                Line::problem(ABOUT, "no adapter is usable, and imaging.backend = \"gpu\" asks for one", remedy)
            }
            Prefer::Auto => Line::note(ABOUT, found, remedy),
            Prefer::Cpu => Line::ok(ABOUT, "none usable, and none is asked for (imaging.backend = \"cpu\")"),
        });
    }
}

#[cfg(not(feature = "gpu"))]
fn adapters(_: Prefer, lines: &mut Vec<Line>) -> bool {
    lines.push(Line::note(
        ABOUT,
        "this build has no GPU support",
        "build it with the feature gpu, which is on by default",
    ));
    false
}

/// Lists the adapters; whether one would be taken.
#[cfg(feature = "gpu")]
fn adapters(prefer: Prefer, lines: &mut Vec<Line>) -> bool {
    use crate::imaging::gpu::AdapterKind;
    let (sender, receiver) = std::sync::mpsc::sync_channel(1);
    let spawned = std::thread::Builder::new().name("noctule adapters".to_owned()).spawn(move || {
        let _ = sender.send(crate::life::panic::contained(crate::imaging::gpu::adapters));
    });
    let listed = spawned.ok().and_then(|_| receiver.recv_timeout(std::time::Duration::from_secs(10)).ok());
    let Some(listed) = listed else {
        lines.push(Line::problem(
            ABOUT,
            "a driver did not list its adapters within 10 s, or broke down",
            "repair the driver, or name another one in VK_DRIVER_FILES",
        ));
        return false;
    };
    if listed.is_empty() {
        let looked = crate::imaging::gpu::compiled_backends().join(", ");
        lines.push(Line::note(ABOUT, format!("there is no adapter ({looked} was asked)"), "see the lines below"));
    }
    let mut usable = false;
    for adapter in &listed {
        let software = adapter.kind == AdapterKind::Software;
        match &adapter.refused {
            None => {
                usable = true;
                lines.push(Line::ok(ABOUT, adapter.to_string()));
            }
            Some(_) if software && prefer == Prefer::Gpu => {
                usable = true;
                lines.push(Line::note(
                    ABOUT,
                    format!(
                        "{adapter}: a program on the processor, taken because imaging.backend = \"gpu\" asks for any"
                    ),
                    "backend = \"cpu\" is many times faster than a software adapter",
                ));
            }
            Some(reason) if software => {
                lines.push(Line::ok(ABOUT, format!("{adapter}: not taken by itself: {reason}")));
            }
            Some(reason) => lines.push(Line::note(
                ABOUT,
                format!("{adapter}: not usable: {reason}"),
                "a newer driver may offer more; else the CPU images",
            )),
        }
    }
    usable
}

/// Why a GPU that the machine has may not be seen.
fn reasons(lines: &mut Vec<Line>) {
    hardware(lines);
    nodes(lines);
    loader(lines);
    for name in VARIABLES {
        if let Some(value) = std::env::var_os(name) {
            lines.push(Line::note(
                ABOUT,
                format!("{name} = {} decides which drivers and devices are seen", value.to_string_lossy()),
                format!("unset {name}, or correct it"),
            ));
        }
    }
    if let Some(value) = std::env::var_os("WGPU_BACKEND") {
        let found = format!("WGPU_BACKEND = {} is set and has no effect here", value.to_string_lossy());
        lines.push(Line::note(ABOUT, found, "imaging.backend and --backend choose"));
    }
}

/// Display controllers on the bus, and whether a driver has them.
fn hardware(lines: &mut Vec<Line>) {
    let entries = std::fs::read_dir("/sys/bus/pci/devices").into_iter().flatten().flatten();
    let text = |path: PathBuf| std::fs::read_to_string(path).unwrap_or_default().trim().to_owned();
    let mut found = 0;
    for entry in entries {
        let path = entry.path();
        if !text(path.join("class")).starts_with("0x03") {
            continue;
        }
        found += 1;
        let (vendor, device) = (text(path.join("vendor")), text(path.join("device")));
        let name = format!("display controller {} {vendor}:{device}", entry.file_name().to_string_lossy());
        let driver = std::fs::read_link(path.join("driver")).ok();
        let driver = driver.and_then(|link| link.file_name().map(|name| name.to_string_lossy().into_owned()));
        lines.push(match driver {
            Some(driver) => Line::ok(ABOUT, format!("{name}, driver {driver}")),
            None => Line::note(ABOUT, format!("{name} has no kernel driver"), driver_advice(&vendor)),
        });
    }
    if found == 0 {
        lines.push(Line::ok(ABOUT, "no display controller on the PCI bus"));
    }
}

fn driver_advice(vendor: &str) -> &'static str {
    match vendor {
        "0x10de" => "install NVIDIA's driver, or nouveau and mesa-vulkan-drivers",
        "0x1002" => "load amdgpu; install mesa-vulkan-drivers and the firmware package",
        "0x8086" => "load i915 or xe; install mesa-vulkan-drivers",
        _ => "install the maker's kernel driver",
    }
}

/// Device files, without which no driver reaches its device.
fn nodes(lines: &mut Vec<Line>) {
    let folder = Path::new("/dev/dri");
    let nodes = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut render: Vec<PathBuf> = nodes
        .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("renderD")))
        .collect();
    render.sort();
    if render.is_empty() {
        lines.push(Line::note(
            ABOUT,
            if folder.is_dir() { "/dev/dri has no render node" } else { "there is no /dev/dri" },
            "load the kernel driver; in a container hand it in: --device /dev/dri (NVIDIA: --gpus all)",
        ));
    }
    for path in render {
        let readable = rustix::fs::access(&path, rustix::fs::Access::READ_OK | rustix::fs::Access::WRITE_OK);
        lines.push(match readable {
            Ok(()) => Line::ok(ABOUT, format!("{} may be used", path.display())),
            Err(error) => Line::note(
                ABOUT,
                format!("{} may not be used: {error}", path.display()),
                "add this user to the group render (usermod -aG render USER) and log in again; units: SupplementaryGroups=render",
            ),
        });
    }
}

/// The Vulkan loader and the drivers that it would load.
fn loader(lines: &mut Vec<Line>) {
    if !cfg!(all(target_os = "linux", feature = "gpu")) {
        return;
    }
    let extra = std::env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
    let folders = LIBRARY_FOLDERS.iter().map(PathBuf::from).chain(std::env::split_paths(&extra));
    if folders.map(|folder| folder.join("libvulkan.so.1")).all(|path| !path.exists()) {
        let found = "the Vulkan loader (libvulkan.so.1) is not in the usual places";
        lines.push(Line::note(ABOUT, found, "apt install libvulkan1 mesa-vulkan-drivers, or the maker's driver"));
    }
    let manifests = DRIVER_FOLDERS.iter().flat_map(|folder| std::fs::read_dir(folder).into_iter().flatten().flatten());
    let mut names: Vec<String> = manifests.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.retain(|name| name.ends_with(".json"));
    names.sort();
    lines.push(if names.is_empty() {
        let found = format!("no Vulkan driver is installed ({} are empty)", DRIVER_FOLDERS[..2].join(", "));
        Line::note(ABOUT, found, "apt install mesa-vulkan-drivers, or the maker's driver")
    } else {
        Line::ok(ABOUT, format!("Vulkan drivers: {}", names.join(", ")))
    });
}
