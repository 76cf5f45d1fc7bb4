//! `noctule bench --emissions`: what each emission plan is worth against cross-talk, as a table, JSON and a picture.
//!
//! In: a configuration. Out: rejection, resolution, ghosts, misses and latency of each plan, computed by
//! [`crate::service::emission_trials`]; always on the CPU, on all cores.

use super::super::args::BenchArguments;
use super::super::output::{print_line, progress, write_picture};
use super::super::series::cores;
use super::super::{Failure, exit};
use crate::config::Config;
use crate::io::plot::frames;
use crate::service::ServiceError;
use crate::service::emission_trials::{
    CANDIDATES, Candidate, Judgement, Shown, Tally, configured, facing, fan, judge, rooms, show,
};
use crate::signal::Energyscape;
use serde_json::{Value, json};

/// Scenes of which the picture shows the one with most ghosts.
const SHOWN_OF: usize = 8;

/// Runs the command.
///
/// # Errors
/// Exit 65 when the configuration cannot be simulated with a plan, 73 for a picture that cannot be written.
pub fn emissions(config: &Config, arguments: &BenchArguments) -> Result<(), Failure> {
    let failed = |error: ServiceError| Failure::new(exit::DATA, error);
    let places = arguments.places as usize;
    let bar = progress(CANDIDATES.len() as u64, "listening");
    let (mut found, mut fitting) = (Vec::new(), Vec::new());
    for candidate in &CANDIDATES {
        match judge(config, candidate, places, cores()) {
            Ok(judgement) => {
                found.push(judgement);
                fitting.push(*candidate);
            }
            // Turns that do not fit the ping period, or a sweep from a file that cannot be cut: a line, not a failure.
            Err(ServiceError::Parameter(error)) => log::warn!("{}: {error}", candidate.name),
            Err(error) => return Err(failed(error)),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if found.is_empty() {
        return Err(Failure::new(exit::DATA, "no plan of emission fits this configuration"));
    }
    if let Some(path) = &arguments.plot {
        let images = pictured(config, &fitting).map_err(failed)?;
        let shown: Vec<(&str, &Energyscape)> = images.iter().map(|(name, image)| (name.as_str(), image)).collect();
        write_picture(path, &frames(&shown, fitting.len() + 1))?;
    }
    if arguments.json {
        let rows: Vec<Value> = found.iter().map(row).collect();
        return print_line(&json!({ "machine": super::machine(config), "emissions": rows }).to_string());
    }
    print_line("by a hundred ping sets: ghosts (of them in the way) / own echoes missed")?;
    print_line(&format!(
        "{:<22} {:>9} {:>8} {:>12} {:>6} {:>26} {:>15} {:>15} {:>15}",
        "plan",
        "rejection",
        "width",
        "range error",
        "added",
        "robot, of echoes",
        "other noise",
        "all ahead",
        "other robot"
    ))?;
    for judgement in &found {
        print_line(&line(judgement))?;
    }
    Ok(())
}

fn line(judgement: &Judgement) -> String {
    let Judgement { name, sharpness, added_s, robot, noise, fan, facing } = judgement;
    let rejection = sharpness.rejection_db.map_or("none".to_owned(), |below_db| format!("{below_db:.1} dB"));
    let counts = |tally: &Tally| {
        let [ghosts, way, misses] =
            [tally.ghosts, tally.in_the_way, tally.misses].map(|count| tally.per_hundred(count));
        format!("{ghosts:.0} ({way:.0}) / {misses:.0}")
    };
    let facing = facing.as_ref().map_or("\u{2013}".to_owned(), counts);
    let robot = format!("{} of {:.0}", counts(robot), robot.per_hundred(robot.echoes));
    format!(
        "{name:<22} {rejection:>9} {:>5.1} mm {:>9.1} mm {:>3.0} ms {robot:>26} {:>15} {:>15} {facing:>15}",
        1e3 * sharpness.width_m,
        1e3 * sharpness.range_error_m,
        1e3 * added_s,
        counts(noise),
        counts(fan),
    )
}

fn row(judgement: &Judgement) -> Value {
    let tally = |tally: &Tally| {
        json!({
            "ping_sets": tally.sets,
            "own_echoes": tally.echoes,
            "ghosts": tally.ghosts,
            "in_the_way": tally.in_the_way,
            "missed": tally.misses,
        })
    };
    json!({
        "name": judgement.name,
        "rejection_db": judgement.sharpness.rejection_db,
        "width_m": judgement.sharpness.width_m,
        "range_error_m": judgement.sharpness.range_error_m,
        "added_s": judgement.added_s,
        "robot": tally(&judgement.robot),
        "other_noise": tally(&judgement.noise),
        "all_ahead": tally(&judgement.fan),
        "other_robot": judgement.facing.as_ref().map(tally),
    })
}

/// A row of the worst place in a room, one of the worst with all sensors ahead, and one of another robot: own emission alone, then every
/// plan. The place is the worst of the first plan.
fn pictured(config: &Config, fitting: &[Candidate]) -> Result<Vec<(String, Energyscape)>, ServiceError> {
    let robots: Vec<Config> = fitting.iter().map(|candidate| configured(config, candidate)).collect();
    let scenes = |robot: &Config, row: usize| match row {
        0 => rooms(robot, SHOWN_OF.div_ceil(4)),
        1 => rooms(&fan(robot), SHOWN_OF.div_ceil(4)),
        _ => Ok(facing(robot, SHOWN_OF)),
    };
    let mut images = Vec::new();
    for row in 0..3 {
        let mut worst: Option<(usize, Shown)> = None;
        let plain = scenes(&robots[0], row)?;
        for (index, scene) in plain.iter().enumerate() {
            let shown = show(scene, None)?;
            if worst.as_ref().is_none_or(|(_, before)| shown.ghosts > before.ghosts) {
                worst = Some((index, shown));
            }
        }
        let Some((index, first)) = worst else { continue };
        images.push((format!("{}: own sound alone", plain[index].name), first.own));
        for (candidate, robot) in fitting.iter().zip(&robots) {
            let scene = &scenes(robot, row)?[index];
            let shown = show(scene, Some(first.sensor))?;
            images.push((format!("{}, {} ghosts", candidate.name, shown.ghosts), shown.heard));
        }
    }
    Ok(images)
}
