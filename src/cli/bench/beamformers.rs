//! `noctule bench --beamformers`: what each beamformer makes of the same scenes, as a table, JSON and a picture.
//!
//! In: a configuration and a backend. Out: sharpness, side lobes, dynamic range and time of each, computed by
//! [`crate::service::image_quality`].

use super::super::args::{BackendArgument, BenchArguments};
use super::super::output::{print_line, progress, write_picture};
use super::super::{Failure, exit};
use crate::config::Config;
use crate::imaging::params::Prefer;
use crate::io::plot::frames;
use crate::service::image_quality::{Quality, Scenes, candidates};
use serde_json::{Value, json};

/// Images in a row of the picture.
const COLUMNS: usize = 4;

/// Runs the command.
///
/// # Errors
/// Exit 69 without the backend asked for, 65 when the configuration cannot be simulated, 73 for a picture that cannot be written.
pub fn beamformers(config: &Config, arguments: &BenchArguments) -> Result<(), Failure> {
    let failed = |error| Failure::new(exit::DATA, error);
    let prefer = arguments.backend.map_or(Prefer::Cpu, BackendArgument::into);
    let scenes = Scenes::new(config).map_err(failed)?;
    let candidates = candidates();
    let bar = progress(candidates.len() as u64, "imaging");
    let mut found = Vec::new();
    for candidate in &candidates {
        found.push(scenes.judge(candidate, prefer).map_err(failed)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    if let Some(path) = &arguments.plot {
        let shown: Vec<_> = found.iter().map(|quality| (quality.name, &quality.image)).collect();
        write_picture(path, &frames(&shown, COLUMNS))?;
    }
    if arguments.json {
        let rows: Vec<Value> = found.iter().map(row).collect();
        return print_line(&json!({ "machine": super::machine(config), "beamformers": rows }).to_string());
    }
    print_line("levels in dB against the loud echo; one sensor, times in ms")?;
    print_line("beamformer                         loud  width  side lobe    noise   beside   behind     time")?;
    for Quality { name, loud_db, width_deg, side_lobe_db, noise_db, beside_db, behind_db, time_ms, .. } in &found {
        print_line(&format!(
            "{name:<32} {loud_db:>6.2} {width_deg:>5.1}\u{b0} {side_lobe_db:>10.1} {noise_db:>8.1} {beside_db:>8.0} {behind_db:>8.0} {time_ms:>8.2}"
        ))?;
    }
    Ok(())
}

fn row(quality: &Quality) -> Value {
    json!({
        "name": quality.name,
        "loud_db": quality.loud_db,
        "width_deg": quality.width_deg,
        "side_lobe_db": quality.side_lobe_db,
        "noise_db": quality.noise_db,
        "weakest_beside_db": quality.beside_db,
        "weakest_behind_db": quality.behind_db,
        "median_ms": quality.time_ms,
    })
}
