//! How well this machine keeps time: cores, governor, clock, limits of priority and memory.

use super::Line;
use crate::cli::series;
use rustix::process::{Resource, getrlimit};
use std::collections::BTreeMap;

/// A ping set of three sensors keeps one core busy; the controller and whoever watches need another.
const CORES_MIN: usize = 2;
/// Clocks of the kernel that are read without a system call.
const FAST_CLOCKS: [&str; 5] = ["tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "xen"];

pub(super) fn look(lines: &mut Vec<Line>) {
    lines.push(cores());
    lines.push(governor());
    lines.push(clock());
    lines.push(priority());
    lines.push(memory());
}

fn cores() -> Line {
    const ABOUT: &str = "cores";
    let count = series::cores();
    let found = format!("{count} usable");
    if count >= CORES_MIN {
        Line::ok(ABOUT, found)
    } else {
        Line::note(ABOUT, found, "`noctule bench --latency --busy` tells whether the deadline is met")
    }
}

fn read(path: &str) -> Option<String> {
    Some(std::fs::read_to_string(path).ok()?.trim().to_owned())
}

fn governor() -> Line {
    const ABOUT: &str = "cpu frequency";
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for index in 0..4096 {
        let Some(found) = read(&format!("/sys/devices/system/cpu/cpu{index}/cpufreq/scaling_governor")) else { break };
        *counts.entry(found).or_default() += 1;
    }
    if counts.is_empty() {
        return Line::ok(ABOUT, "the system does not scale it, or does not tell");
    }
    let told: Vec<String> = counts.iter().map(|(name, count)| format!("{name} on {count}")).collect();
    let slow = ["powersave", "conservative"].iter().any(|name| counts.contains_key(*name));
    let found = format!("governor {}", told.join(", "));
    if slow {
        Line::note(
            ABOUT,
            found,
            "cpupower frequency-set -g performance, when `noctule bench --latency` shows late sets",
        )
    } else {
        Line::ok(ABOUT, found)
    }
}

fn clock() -> Line {
    const ABOUT: &str = "clock";
    match read("/sys/devices/system/clocksource/clocksource0/current_clocksource") {
        None => Line::ok(ABOUT, "CLOCK_BOOTTIME; the system does not tell its source"),
        Some(source) if FAST_CLOCKS.contains(&source.as_str()) => {
            Line::ok(ABOUT, format!("CLOCK_BOOTTIME from {source}"))
        }
        Some(source) => Line::note(
            ABOUT,
            format!("CLOCK_BOOTTIME from {source}, which is slow to read"),
            "see /sys/devices/system/clocksource/clocksource0/available_clocksource for a better one",
        ),
    }
}

fn priority() -> Line {
    const ABOUT: &str = "priority";
    let limit = getrlimit(Resource::Rtprio).current;
    let told = limit.map_or("without limit".to_owned(), |limit| limit.to_string());
    if rustix::process::geteuid().is_root() || limit != Some(0) {
        return Line::ok(ABOUT, format!("real-time priority up to {told}"));
    }
    Line::note(
        ABOUT,
        "this user may not ask for real-time priority (RLIMIT_RTPRIO 0)",
        "not needed; the systemd units give Nice=-10. For more: LimitRTPRIO= in the unit, or /etc/security/limits.conf",
    )
}

fn memory() -> Line {
    let limit = getrlimit(Resource::Memlock).current;
    let told = limit.map_or("without limit".to_owned(), |bytes| format!("{} KiB", bytes / 1024));
    let swap = read("/proc/swaps").map_or(0, |text| text.lines().count().saturating_sub(1));
    if swap > 0 {
        return Line::note(
            "memory",
            format!(
                "{swap} swap areas; RLIMIT_MEMLOCK {told}; shared memory is reserved at start, but may be swapped out"
            ),
            "swapoff -a on a robot, or MemorySwapMax=0 in the units",
        );
    }
    Line::ok("memory", format!("no swap; RLIMIT_MEMLOCK {told}; shared memory is reserved at start"))
}
