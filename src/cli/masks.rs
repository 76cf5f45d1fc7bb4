//! `noctule masks`: the control regions as each sensor sees them, as arrays and as pictures, and the flow lines they rest on.

use super::args::MasksArguments;
use super::output::{cannot_create, make_folder, print_line, write_npy};
use super::{Failure, exit};
use crate::config::Config;
use crate::flow::MaskSet;
use crate::io::picture::{self, Picture};
use crate::io::plot::{self, PlottedRegions, PlottedRobot};
use crate::service::wiring::SensingSetup;
use crate::service::{plots, regions, wiring};
use crate::signal::{LayerName, Mask};
use std::path::Path;

/// Writes `mask_<layer>_<sensor>.npy` (`i8`, `[direction][range]`) and a picture of the same name for each;
/// `masks_<layer>.png` for all sensors together, `regions.png`, and `flow_lines_<sensor>.png`.
///
/// # Errors
/// Exit 73, 74, 77, 78.
pub fn masks(arguments: &MasksArguments) -> Result<(), Failure> {
    let config = super::config::load_or_layout(&arguments.choice, arguments.layout.as_deref())?;
    let setup = wiring::sensing(&config).map_err(|error| Failure::new(exit::CONFIG, error))?;
    let masks = wiring::masks(&config, &setup).map_err(|error| Failure::new(exit::CONFIG, error))?;
    make_folder(&arguments.out)?;
    let grid = &setup.plan.grid;
    let shape = [grid.direction_count() as u64, grid.range_count() as u64];
    for mask in masks.masks() {
        let sensor = &setup.sensors[mask.sensor_index];
        let stem = format!("mask_{}_{}", mask.layer.as_str(), sensor.name);
        write_npy(&arguments.out.join(format!("{stem}.npy")), &shape, &mask.values)?;
        write(&arguments.out, &stem, &picture::render_mask(mask, grid, sensor))?;
        let left = mask.values.iter().filter(|value| **value > 0).count();
        let right = mask.values.iter().filter(|value| **value < 0).count();
        print_line(&format!("{stem}: {left} cells left, {right} cells right"))?;
    }
    overviews(&config, &setup, &masks, arguments)
}

fn write(folder: &Path, stem: &str, picture: &Picture) -> Result<(), Failure> {
    let path = folder.join(format!("{stem}.png"));
    picture::write_png(&path, picture).map_err(|error| cannot_create(&path, &error))
}

/// What concerns the whole robot: all regions, all sensors' masks of a layer, and each sensor's flow lines.
fn overviews(
    config: &Config,
    setup: &SensingSetup,
    masks: &MaskSet,
    arguments: &MasksArguments,
) -> Result<(), Failure> {
    let grid = &setup.plan.grid;
    let zones = config.dead_zones(&setup.sensors, grid.directions());
    let hidden: Vec<Vec<bool>> = zones.into_iter().map(|zone| zone.hidden).collect();
    let footprint_radius_m = config.platform.radius_m;
    let robot = PlottedRobot { footprint_radius_m, sensors: &setup.sensors, grid, hidden: &hidden };
    let params = regions::mask_params(&config.control, &config.platform, &config.imaging.directions);
    let shapes = [
        (LayerName::CorridorFollowing, params.corridor_following.as_slice()),
        (LayerName::ObstacleAvoidance, params.obstacle_avoidance.as_slice()),
        (LayerName::CollisionAvoidance, params.collision_avoidance.as_slice()),
    ];
    let shown = PlottedRegions { shapes: &shapes, flow_lines: &params.flow_lines };
    let name = arguments.layout.as_deref().unwrap_or("the configured robot");
    write(&arguments.out, "regions", &plot::regions(name, &robot, &shown))?;
    let all: Vec<&Mask> = masks.masks().collect();
    for layer in LayerName::LAYERS.into_iter().filter(|layer| all.iter().any(|mask| mask.layer == *layer)) {
        write(&arguments.out, &format!("masks_{}", layer.as_str()), &plot::masks_together(name, layer, &all, &robot))?;
    }
    for (sensor, hidden) in setup.sensors.iter().zip(&hidden) {
        let title = format!("{name}, sensor {}: where its echoes move", sensor.name);
        let marks = plots::flow_marks(&sensor.mount, grid, hidden);
        let picture = plot::flow_lines(&title, &plots::flow_panels(&sensor.mount, grid), &marks, grid, hidden);
        write(&arguments.out, &format!("flow_lines_{}", sensor.name), &picture)?;
    }
    Ok(())
}
