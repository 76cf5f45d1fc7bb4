//! `noctule masks`: the control regions as each sensor sees them, as arrays and as pictures.

use super::args::MasksArguments;
use super::output::{cannot_create, make_folder, print_line, write_npy};
use super::{Failure, exit};
use crate::io::picture;
use crate::service::wiring;

/// Writes `mask_<layer>_<sensor>.npy` (`i8`, `[direction][range]`) and a picture of the same name for each.
///
/// # Errors
/// Exit 73, 74, 77, 78.
pub fn masks(arguments: &MasksArguments) -> Result<(), Failure> {
    let config = super::config::load(&arguments.choice)?;
    let setup = wiring::sensing(&config).map_err(|error| Failure::new(exit::CONFIG, error))?;
    let masks = wiring::masks(&config, &setup).map_err(|error| Failure::new(exit::CONFIG, error))?;
    make_folder(&arguments.out)?;
    let grid = &setup.plan.grid;
    let shape = [grid.direction_count() as u64, grid.range_count() as u64];
    for mask in masks.masks() {
        let sensor = &setup.sensors[mask.sensor_index];
        let stem = format!("mask_{}_{}", mask.layer.as_str(), sensor.name);
        write_npy(&arguments.out.join(format!("{stem}.npy")), &shape, &mask.values)?;
        let path = arguments.out.join(format!("{stem}.png"));
        let picture = picture::render_mask(mask, grid, sensor);
        picture::write_png(&path, &picture).map_err(|error| cannot_create(&path, &error))?;
        let left = mask.values.iter().filter(|value| **value > 0).count();
        let right = mask.values.iter().filter(|value| **value < 0).count();
        print_line(&format!("{stem}: {left} cells left, {right} cells right"))?;
    }
    Ok(())
}
