//! Contract: regions, masks, flow lines and energyscapes lie over the robot where the axes say, left and right are told apart,
//! what is unseen looks unseen, and no input, empty, NaN or huge, makes a plot panic or run long.

mod plot_scale;

use noctule::config::Config;
use noctule::geometry::flow_lines::FlowLinesRegion;
use noctule::geometry::shape::Shape;
use noctule::io::picture::Picture;
use noctule::io::plot::{
    FlowCurve, FlowMark, FlowPanel, PlottedRegions, PlottedRobot, energyscapes_together, flow_lines, frames,
    layer_colour, masks_together, regions,
};
use noctule::sensor::{Mount, SensorSetup};
use noctule::signal::{Direction, Energyscape, LayerName, Mask, PolarGrid};
use plot_scale::Scale;
use std::sync::Arc;
use std::time::{Duration, Instant};

const WHITE: [u8; 3] = [255, 255, 255];
const FOOTPRINT_M: f64 = 0.2;

/// Bearings -89.5 to 89.5 deg, ranges 0.3 to 5 m.
fn grid() -> Arc<PolarGrid> {
    let directions = (0..180).map(|index| Direction::horizontal((f64::from(index) - 89.5).to_radians())).collect();
    Arc::new(PolarGrid::new(directions, 0.3, 0.05, 95))
}

/// Sensors at the robot's centre that look ahead, or wherever `mounts` says.
fn sensors(mounts: &[Mount]) -> Vec<SensorSetup> {
    let template = Config::default().sensor_setups().expect("the default sensors").remove(0);
    let sensor =
        |(index, mount): (usize, &Mount)| SensorSetup { name: format!("s{index}"), mount: *mount, ..template.clone() };
    mounts.iter().enumerate().map(sensor).collect()
}

fn robot<'a>(sensors: &'a [SensorSetup], grid: &'a PolarGrid, hidden: &'a [Vec<bool>]) -> PlottedRobot<'a> {
    PlottedRobot { footprint_radius_m: FOOTPRINT_M, sensors, grid, hidden }
}

/// A box on the left, ahead of the robot: with it a plot reaches from -0.6 to 1.0 m in x and from -0.6 to 0.6 m in y.
fn box_on_the_left() -> Shape {
    Shape::Rectangle { x_m: [0.5, 1.0], y_m: [0.25, 0.55] }
}

/// Ticks every 0.2 m, the left of the robot on the left.
#[track_caller]
fn scale_about_robot(picture: &Picture) -> Scale {
    Scale::read(picture, ([0.6, -0.6], 7), ([-0.6, 1.0], 9))
}

#[test]
fn a_region_lies_where_it_is_in_its_layers_colour_and_nowhere_else() {
    let (grid, sensors, shapes) = (grid(), sensors(&[Mount::default()]), [box_on_the_left()]);
    let shown = PlottedRegions { shapes: &[(LayerName::ObstacleAvoidance, &shapes)], flow_lines: &[] };
    let picture = regions("test", &robot(&sensors, &grid, &[]), &shown);
    let scale = scale_about_robot(&picture);
    let inside = scale.colour(&picture, 0.4, 0.75);
    let full = layer_colour(LayerName::ObstacleAvoidance);
    for part in 0..3 {
        let tinted = 255.0 + (f64::from(full[part]) - 255.0) / 3.0;
        assert!((f64::from(inside[part]) - tinted).abs() < 3.0, "{inside:?} is a third of {full:?} on white");
    }
    for (y_m, x_m) in [(0.27, 0.52), (0.53, 0.98)] {
        assert_ne!(scale.colour(&picture, y_m, x_m), WHITE, "({x_m}, {y_m}) lies inside");
    }
    for (y_m, x_m) in [(-0.4, 0.75), (0.23, 0.75), (0.57, 0.75), (0.4, 0.48), (0.4, 1.02)] {
        assert_eq!(scale.colour(&picture, y_m, x_m), WHITE, "({x_m}, {y_m}) lies outside");
    }
}

#[test]
fn what_no_sensor_sees_is_grey_and_what_is_hidden_from_one_is_hatched() {
    let (grid, shapes) = (grid(), [box_on_the_left()]);
    let both = sensors(&[Mount::default(), Mount { distance_m: 0.0, bearing_rad: 0.0, yaw_rad: 0.0 }]);
    // From the second sensor the bearings from -60 to -20 deg are hidden; the first still sees there.
    let bearing_deg = |index: usize| index as f64 - 89.5;
    let hides = (0..180).map(|index| (-60.0..-20.0).contains(&bearing_deg(index))).collect();
    let hidden = vec![vec![false; 180], hides];
    let shown = PlottedRegions { shapes: &[(LayerName::ObstacleAvoidance, &shapes)], flow_lines: &[] };
    let picture = regions("test", &robot(&both, &grid, &hidden), &shown);
    let scale = scale_about_robot(&picture);
    let grey = scale.colour(&picture, -0.5, -0.3);
    assert!(grey != WHITE && grey[0] == grey[1] && grey[1] == grey[2], "behind, {grey:?}");
    assert_eq!(scale.colour(&picture, 0.1, 0.24), grey, "nearer than the first range");
    assert_eq!(scale.colour(&picture, 0.1, 0.8), WHITE, "ahead");
    let shades = |bearing_deg: f64| {
        let mut shades: Vec<[u8; 3]> = (40..58)
            .map(|step| 0.01 * f64::from(step))
            .map(|range_m| {
                let bearing_rad = bearing_deg.to_radians();
                scale.colour(&picture, range_m * bearing_rad.sin(), range_m * bearing_rad.cos())
            })
            .collect();
        shades.sort_unstable();
        shades.dedup();
        shades
    };
    assert_eq!(shades(-40.0).len(), 2, "white and hatching: {:?}", shades(-40.0));
    assert_eq!(shades(-15.0), [WHITE], "beside the hidden bearings");
}

/// A mask with the cells from `bearings_deg` and 0.5 to 0.9 m.
fn mask(sensor_index: usize, bearings_deg: [f64; 2], side: i8) -> Mask {
    let grid = grid();
    let mut values = vec![0; grid.cell_count()];
    for (index, direction) in grid.directions().iter().enumerate() {
        let inside = (bearings_deg[0]..bearings_deg[1]).contains(&direction.azimuth_rad.to_degrees());
        for range in (0..grid.range_count()).filter(|range| inside && (0.5..0.9).contains(&grid.range_m(*range))) {
            values[grid.cell(index, range)] = side;
        }
    }
    Mask { layer: LayerName::CollisionAvoidance, sensor_index, values }
}

fn polar(scale: &Scale, picture: &Picture, range_m: f64, bearing_deg: f64) -> [u8; 3] {
    let bearing_rad = bearing_deg.to_radians();
    scale.colour(picture, range_m * bearing_rad.sin(), range_m * bearing_rad.cos())
}

/// Scale of a plot whose masks reach to 0.88 m ahead: ticks every 0.2 m.
fn scale_of_masks(picture: &Picture) -> Scale {
    Scale::read(picture, ([0.6, -0.6], 7), ([-0.6, 0.8], 8))
}

#[test]
fn masks_of_all_sensors_lie_over_the_robot_warm_on_the_left_cold_on_the_right_and_darker_where_they_meet() {
    let (grid, both) = (grid(), sensors(&[Mount::default(), Mount::default()]));
    let masks =
        [mask(0, [0.0, 30.0], 1), mask(1, [-20.0, 0.0], -1), mask(1, [-20.0, 0.0], -1), mask(0, [-20.0, -10.0], -1)];
    let masks: Vec<&Mask> = masks.iter().collect();
    let picture = masks_together("test", LayerName::CollisionAvoidance, &masks[..2], &robot(&both, &grid, &[]));
    let scale = scale_of_masks(&picture);
    let (left, right) = (polar(&scale, &picture, 0.7, 15.0), polar(&scale, &picture, 0.7, -10.0));
    assert!(left[0] > left[2] && right[2] > right[0], "orange {left:?}, blue {right:?}");
    for (range_m, bearing_deg) in [(0.7, 32.0), (0.7, -22.0), (0.45, 15.0), (0.93, 15.0)] {
        assert_eq!(polar(&scale, &picture, range_m, bearing_deg), WHITE, "{range_m} m, {bearing_deg} deg");
    }
    let picture = masks_together("test", LayerName::CollisionAvoidance, &masks[1..], &robot(&both, &grid, &[]));
    let (two, three) = (polar(&scale, &picture, 0.7, -5.0), polar(&scale, &picture, 0.7, -15.0));
    assert!(three[0] < two[0] && two[0] < right[0], "{three:?} {two:?} {right:?}");
    let other = masks_together("test", LayerName::FlowFollowing, &masks, &robot(&both, &grid, &[]));
    let coloured = |pixel: [u8; 3]| pixel[0].abs_diff(pixel[2]) > 20;
    let (width, height) = other.size_px();
    let found = (0..height as i32).flat_map(|y| (0..width as i32).map(move |x| (x, y)));
    let area = found.filter(|(x, y)| other.pixel(*x, *y).is_some_and(coloured)).count();
    assert_eq!(area, 0, "masks of another layer are left out");
}

#[test]
fn mirrored_masks_make_a_mirrored_picture_with_the_sides_exchanged() {
    let (grid, one) = (grid(), sensors(&[Mount::default()]));
    let picture = |mask: &Mask| masks_together("", LayerName::CollisionAvoidance, &[mask], &robot(&one, &grid, &[]));
    let (left, right) = (picture(&mask(0, [10.0, 40.0], 1)), picture(&mask(0, [-40.0, -10.0], -1)));
    let scale = scale_of_masks(&left);
    let kind = |pixel: [u8; 3]| {
        i32::from(pixel[0] > pixel[2].saturating_add(20)) - i32::from(pixel[2] > pixel[0].saturating_add(20))
    };
    let mut seen = [0, 0];
    for bearing in -80..=80 {
        for step in 0..40 {
            // Places within cells: at their borders rounding decides.
            let (range_m, bearing_deg) = (0.31 + 0.0137 * f64::from(step), f64::from(bearing) + 0.5);
            if (range_m * bearing_deg.to_radians().sin()).abs() > 0.6 {
                continue; // beside the picture
            }
            let pair = [(&left, bearing_deg), (&right, -bearing_deg)];
            let [a, b] = pair.map(|(picture, bearing_deg)| kind(polar(&scale, picture, range_m, bearing_deg)));
            seen[usize::from(a != 0)] += 1;
            let at_border = [0.475, 0.525, 0.875, 0.925].iter().any(|border: &f64| (border - range_m).abs() < 0.004);
            assert!(a == -b || at_border, "{range_m} m, {bearing_deg} deg: {a} {b}");
        }
    }
    assert!(seen[0] > 1000 && seen[1] > 500, "{seen:?}");
}

#[test]
fn a_flow_line_runs_through_its_bearings_and_ranges_and_a_marked_one_is_coloured() {
    let grid = grid();
    let line = |marked| FlowCurve { points: (10..=40).map(|tenth| [0.5, 0.1 * f64::from(tenth)]).collect(), marked };
    let panel = |curves| FlowPanel { title: "test".to_owned(), curves };
    let marks = [FlowMark { name: "A".to_owned(), place: None }];
    // The farthest range is just 5 m, and so is the last tick; bearings are numbered every 15 deg, left on the left.
    let read = |picture: &Picture| Scale::read(picture, ([90.0, -90.0], 13), ([0.0, 5.0], 6));
    let plain = flow_lines("", &[panel(vec![line(None)])], &marks, &grid, &[]);
    let marked = flow_lines("", &[panel(vec![line(Some(0))])], &marks, &grid, &[]);
    let bearing_deg = 0.5_f64.to_degrees();
    for range_m in [1.2, 2.1, 3.8] {
        let ink = read(&plain).colour(&plain, bearing_deg, range_m);
        assert!(ink != WHITE && ink[0] == ink[2], "{range_m} m: {ink:?}");
        let ink = read(&marked).colour(&marked, bearing_deg, range_m);
        assert!(ink[0] > ink[2] + 100, "{range_m} m: {ink:?}");
        assert_eq!(read(&plain).colour(&plain, -bearing_deg, range_m), WHITE);
    }
    for range_m in [0.9, 4.1] {
        assert_eq!(read(&plain).colour(&plain, bearing_deg, range_m), WHITE, "beyond the line's ends");
    }
    assert_ne!(read(&plain).colour(&plain, 20.0, 0.15), WHITE, "too near to be heard");
}

#[test]
fn frames_stand_side_by_side_on_one_scale() {
    let loud = |value: f32| {
        let mut energyscape = Energyscape::zeros(grid(), 0);
        let cell = energyscape.grid.cell(120, 48); // 30.5 deg to the left, 2.7 m
        energyscape.values[cell] = value;
        energyscape
    };
    let shown = [loud(0.1), loud(0.1), loud(0.003)];
    let shown: Vec<(&str, &Energyscape)> = shown.iter().map(|energyscape| ("s", energyscape)).collect();
    let (single, film) = (frames(&shown[..1], 1), frames(&shown, 2));
    let (width, height) = single.size_px();
    let brightest = |picture: &Picture, column: i32, row: i32| {
        // Without the colour bar to the right of all frames.
        let (frame_width, frame_height) = (592, height as i32);
        let pixels = (0..frame_height).flat_map(|y| (0..frame_width).map(move |x| (x, y)));
        let heat = |pixel: [u8; 3]| i32::from(pixel[0]) - i32::from(pixel[2]);
        let at = |(x, y): (i32, i32)| picture.pixel(column * frame_width + x, row * frame_height + y).map_or(0, heat);
        pixels.map(|place| (at(place), place)).max_by_key(|found| found.0).expect("pixels")
    };
    let (loudest, place) = brightest(&single, 0, 0);
    assert!(loudest > 80 && place.0 < 592 / 2, "the echo is on the left: {loudest} at {place:?}");
    assert_eq!(brightest(&film, 1, 0), (loudest, place), "the second in its row");
    let below = brightest(&film, 0, 1);
    assert!(below.0 + 40 < loudest, "30 dB less is darker on the common scale: {below:?}");
    assert!(film.size_px().0 > width && film.size_px().1 == 2 * height);
}

#[test]
fn an_energyscape_lies_where_its_sensor_looks() {
    let grid = grid();
    let left = Mount { distance_m: 0.2, bearing_rad: std::f64::consts::FRAC_PI_2, yaw_rad: 0.0 };
    let sensors = sensors(&[Mount::default(), left]);
    let mut energyscape = Energyscape::zeros(Arc::clone(&grid), 1);
    for direction in 80..100 {
        energyscape.values[grid.cell(direction, 48)] = 0.1; // straight ahead of the sensor, 2.7 m
    }
    let picture = energyscapes_together("test", &[&energyscape], &robot(&sensors, &grid, &[]));
    let scale = Scale::read(&picture, ([5.0, -5.0], 11), ([-5.0, 5.0], 11));
    let heat = |y_m: f64, x_m: f64| scale.colour(&picture, y_m, x_m)[0];
    assert!(heat(2.9, 0.0) > 200, "2.7 m to the left of the sensor, 2.9 m of the robot");
    assert!(heat(-2.9, 0.0) == 255 || heat(-2.9, 0.0) < 60, "not on the right");
    assert!(heat(2.6, 0.0) < 60 && heat(3.2, 0.0) < 60, "not nearer or farther");
}

#[test]
fn nothing_to_plot_is_still_a_picture() {
    let grid = grid();
    let none = robot(&[], &grid, &[]);
    let pictures = [
        regions("", &none, &PlottedRegions { shapes: &[], flow_lines: &[] }),
        masks_together("", LayerName::CollisionAvoidance, &[], &none),
        masks_together("", LayerName::CollisionAvoidance, &[&mask(0, [0.0, 1.0], 1)], &none),
        flow_lines("", &[], &[], &grid, &[]),
        flow_lines("", &[FlowPanel { title: String::new(), curves: vec![] }], &[], &grid, &[]),
        frames(&[], 0),
        energyscapes_together("", &[], &none),
    ];
    for (index, picture) in pictures.iter().enumerate() {
        assert!(picture.size_px().0 > 50 && picture.size_px().1 > 30, "picture {index}: {:?}", picture.size_px());
    }
}

#[test]
fn nan_and_huge_numbers_neither_panic_nor_hang() {
    let grid = grid();
    for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e12, -1.0] {
        let began = Instant::now();
        let mount = Mount { distance_m: odd, bearing_rad: 0.3, yaw_rad: odd };
        let sensors = sensors(&[mount, Mount::default()]);
        let robot = PlottedRobot { footprint_radius_m: odd, ..robot(&sensors, &grid, &[]) };
        let shapes = [
            box_on_the_left(),
            Shape::Circle { centre_m: [odd, 0.0], radius_m: odd },
            Shape::Rectangle { x_m: [0.0, odd], y_m: [odd, f64::INFINITY] },
            Shape::Polygon { points_m: vec![] },
        ];
        let lines = [FlowLinesRegion { lateral_m: [odd, 1.0], step_m: odd, x_m: [0.0, odd] }];
        let shown = PlottedRegions { shapes: &[(LayerName::CollisionAvoidance, &shapes)], flow_lines: &lines };
        let _ = regions("", &robot, &shown);
        let _ = masks_together("", LayerName::CollisionAvoidance, &[&mask(0, [0.0, 9.0], 1)], &robot);
        let curve = FlowCurve { points: vec![[odd, 1.0], [0.0, odd], [0.5, 2.0], [odd, odd]], marked: Some(7) };
        let marks = [FlowMark { name: "A".to_owned(), place: Some([odd, odd]) }];
        let _ = flow_lines("", &[FlowPanel { title: String::new(), curves: vec![curve] }], &marks, &grid, &[true; 9]);
        let mut energyscape = Energyscape::zeros(Arc::clone(&grid), 0);
        energyscape.values[7] = odd as f32;
        let _ = frames(&[("s", &energyscape)], 3);
        let _ = energyscapes_together("", &[&energyscape], &robot);
        // Measured: about 1 s on a busy machine; a loop that follows such a number would not end.
        assert!(began.elapsed() < Duration::from_secs(10), "{odd}: {:?}", began.elapsed());
    }
}
