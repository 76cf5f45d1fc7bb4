//! What the configuration asks of the machine, against what there is: shared memory, descriptors, disk.

use super::Line;
use crate::config::Config;
use crate::io::survey::Survey;
use crate::io::{DaemonTopics, DetectorTopics, RawPublisher, free_bytes_of};
use crate::service::wiring;
use rustix::process::{Resource, getrlimit};
use std::path::Path;

const SHARED_MEMORY: &str = "/dev/shm";
/// Less free room than this is soon filled by a recording: some minutes of raw pings of three sensors.
const DISK_MIN_BYTES: u64 = 10 << 30;
const MIB: f64 = 1024.0 * 1024.0;

pub(super) fn look(config: &Config, survey: &Survey, lines: &mut Vec<Line>) {
    match Sizes::of(config) {
        Ok(sizes) => {
            lines.push(shared_memory(&sizes, survey));
            lines.push(descriptors(&sizes));
        }
        Err(error) => lines.push(Line::problem("configuration", error, "correct it; `noctule check F` says where")),
    }
    lines.push(disk());
}

/// What daemon and drivers reserve.
struct Sizes {
    daemon_bytes: u64,
    raw_bytes: u64,
    descriptors: u64,
}

impl Sizes {
    fn of(config: &Config) -> Result<Self, String> {
        let setup = wiring::sensing(config).map_err(|error| error.to_string())?;
        let (sensors, cells) = (setup.sensor_names(), setup.cell_counts());
        let raw = setup.raw_shapes().into_iter().map(|(sensor, shape)| RawPublisher::needed_bytes(&sensor, shape));
        let (mut bytes, mut descriptors) =
            (DaemonTopics::needed_bytes(&sensors, &cells), DaemonTopics::needed_descriptors(&sensors, &cells));
        if config.detect.enabled {
            bytes += DetectorTopics::needed_bytes(&sensors);
            descriptors += DetectorTopics::needed_descriptors(&sensors);
        }
        Ok(Self { daemon_bytes: bytes, raw_bytes: raw.sum(), descriptors })
    }
}

fn mib(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / MIB)
}

fn shared_memory(sizes: &Sizes, survey: &Survey) -> Line {
    const ABOUT: &str = "shared memory";
    let Some(free) = free_bytes_of(Path::new(SHARED_MEMORY)) else {
        return Line::problem(ABOUT, format!("there is no {SHARED_MEMORY}"), "mount a tmpfs there");
    };
    let needed = sizes.daemon_bytes + sizes.raw_bytes;
    let what = format!(
        "{} needed at most (daemon {}, drivers of raw pings {}), {} free",
        mib(needed),
        mib(sizes.daemon_bytes),
        mib(sizes.raw_bytes),
        mib(free)
    );
    let taken = if survey.shared_bytes > 0 {
        format!("; {} taken by this prefix", mib(survey.shared_bytes))
    } else {
        String::new()
    };
    if needed <= free + survey.shared_bytes {
        return Line::ok(ABOUT, format!("{what}{taken}"));
    }
    let remedy = format!(
        "mount -o remount,size={}M {SHARED_MEMORY} (containers: --shm-size), or fewer sensors, directions or ranges",
        (needed as f64 / MIB * 1.5).ceil()
    );
    Line::problem(ABOUT, format!("{what}{taken}"), remedy)
}

fn descriptors(sizes: &Sizes) -> Line {
    const ABOUT: &str = "open files";
    let limit = getrlimit(Resource::Nofile);
    let told = |limit: Option<u64>| limit.map_or("without limit".to_owned(), |limit| limit.to_string());
    let found = format!(
        "the daemon needs up to {}, allowed are {} (it may raise that to {})",
        sizes.descriptors,
        told(limit.current),
        told(limit.maximum)
    );
    if limit.maximum.is_none_or(|most| sizes.descriptors <= most) {
        Line::ok(ABOUT, found)
    } else {
        Line::problem(ABOUT, found, "raise RLIMIT_NOFILE: ulimit -n 1024, or LimitNOFILE=1024 in the unit")
    }
}

fn disk() -> Line {
    const ABOUT: &str = "disk";
    let place = std::env::current_dir().unwrap_or_else(|_| "/".into());
    match free_bytes_of(&place) {
        None => Line::note(ABOUT, format!("{}: free room unknown", place.display()), "look at it with df"),
        Some(free) if free < DISK_MIN_BYTES => Line::note(
            ABOUT,
            format!("{}: {} free", place.display(), mib(free)),
            "raw pings of three sensors take up to 2 MB a ping set: record elsewhere, or free some room",
        ),
        Some(free) => Line::ok(ABOUT, format!("{}: {} free", place.display(), mib(free))),
    }
}
