//! Single reflectors and where an image shows them.

use super::scenes::{Case, Echo};
use noctule::imaging::params::Prefer;
use noctule::imaging::plan::ImagingPlan;
use noctule::imaging::{Imager, ImagerOptions};
use noctule::signal::{Direction, Energyscape, MaskTable, SampleFormat};
use std::sync::Arc;

/// The whole imager on the CPU.
pub fn imager(plan: &Arc<ImagingPlan>) -> Imager {
    let masks = Arc::new(MaskTable::default());
    Imager::open(Arc::clone(plan), masks, Prefer::Cpu, ImagerOptions::default()).unwrap()
}

/// The default case without noise, all bearings.
pub fn quiet(format: SampleFormat) -> Case {
    Case { noise: 0.0, tone: 0.0, ..Case::standard("quiet", format, 1, 1) }
}

pub fn reflector(amplitude: f64, range_m: f64, bearing_deg: f64) -> Echo {
    Echo::of_point(amplitude, range_m, Direction::horizontal(bearing_deg.to_radians()))
}

/// Place and height of a peak through three equally spaced values, relative to the middle one: the top of a parabola through their
/// logarithms, since a compressed echo falls off like a bell rather than like a parabola.
fn parabola(left: f32, middle: f32, right: f32) -> (f64, f64) {
    let (a, b, c) = (f64::from(left).ln(), f64::from(middle).ln(), f64::from(right).ln());
    let place = 0.5 * (a - c) / (a - 2.0 * b + c);
    (place, (b - 0.25 * (a - c) * place).exp())
}

/// Range, bearing in degrees and strength of the largest peak, refined between cells.
pub fn peak(image: &Energyscape) -> (f64, f64, f64) {
    let grid = &image.grid;
    let (direction, range) = grid.direction_and_range(image.peak().0);
    let at = |d: usize, r: usize| image.values[grid.cell(d, r)];
    let (range_offset, strength) = parabola(at(direction, range - 1), at(direction, range), at(direction, range + 1));
    let (offset, _) = parabola(at(direction - 1, range), at(direction, range), at(direction + 1, range));
    let bearing = |d: usize| grid.directions()[d].azimuth_rad.to_degrees();
    let bearing_deg = bearing(direction) + offset * (bearing(direction + 1) - bearing(direction));
    (grid.range_m(range) + range_offset * grid.range_step_m(), bearing_deg, strength)
}
