//! Contract: what is plotted lies where the axes say, in the colours that the legends give, mirrored input gives a mirrored
//! picture, and no input, empty, NaN or huge, makes a plot panic or run long. Places are read off the ticks, as a person does.

mod plot_scale;

use noctule::io::picture::Picture;
use noctule::io::plot::{
    HeatMapOptions, HeatMeasure, PathsOptions, PlottedPoint, PlottedRun, heat_map, layer_colour, paths, paths_by_layout,
};
use noctule::signal::LayerName;
use noctule::sim::{Mover, PathLoop, Pillar, Wall, World};
use plot_scale::{Scale, dark};
use std::time::{Duration, Instant};

const WHITE: [u8; 3] = [255, 255, 255];
const LAYERS: [LayerName; 6] = LayerName::ALL;

fn open_wall(points: &[[f64; 2]]) -> Wall {
    Wall { points: points.to_vec(), closed: false }
}

/// A room from 0 to 10 m by 0 to 8 m with a wall inside, along x = 3 from y = 2 to 6.
fn room() -> World {
    let outer = Wall { points: vec![[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]], closed: true };
    World { walls: vec![outer, open_wall(&[[3.0, 2.0], [3.0, 6.0]])], ..World::default() }
}

fn run(layer: LayerName, places: impl IntoIterator<Item = [f64; 2]>) -> PlottedRun<'static> {
    let points = places.into_iter().map(|[x_m, y_m]| PlottedPoint { x_m, y_m, layer }).collect();
    PlottedRun { layout: "sim-1", points, collided: false, reached_goal: true }
}

/// A run straight along y from x = `from` to `to`, a point every 3 cm.
fn straight(layer: LayerName, y_m: f64, from_m: f64, to_m: f64) -> PlottedRun<'static> {
    let count = ((to_m - from_m).abs() / 0.03) as usize;
    run(layer, (0..=count).map(|index| [from_m + (to_m - from_m) * index as f64 / count as f64, y_m]))
}

/// The scale of a map of the room: a tick a metre.
#[track_caller]
fn scale_of_room(picture: &Picture) -> Scale {
    Scale::read(picture, ([0.0, 10.0], 11), ([0.0, 8.0], 9))
}

#[test]
fn a_wall_stands_at_the_ticks_of_its_metres() {
    for picture in [heat_map(&room(), &[], &HeatMapOptions::default()), paths(&room(), &[], &PathsOptions::default())] {
        let scale = scale_of_room(&picture);
        for (x_m, y_m) in [(3.0, 2.1), (3.0, 5.9), (0.0, 4.0), (10.0, 4.0), (5.0, 0.0), (5.0, 8.0)] {
            let (x, y) = scale.pixel(x_m, y_m);
            assert!(dark(&picture, x, y), "no wall at ({x_m}, {y_m})");
        }
        for (x_m, y_m) in [(2.95, 4.0), (3.05, 4.0), (3.0, 1.95), (3.0, 6.05), (5.0, 7.95)] {
            assert_eq!(scale.colour(&picture, x_m, y_m), WHITE, "({x_m}, {y_m}) is empty");
        }
    }
}

#[test]
fn a_visited_place_is_coloured_as_far_as_the_footprint_reaches_and_no_farther() {
    let options = HeatMapOptions { footprint_radius_m: 0.2, ..HeatMapOptions::default() };
    let picture = heat_map(&room(), &[straight(LayerName::PassThrough, 4.0, 4.0, 8.0)], &options);
    let scale = scale_of_room(&picture);
    for (x_m, y_m) in [(4.0, 4.0), (6.0, 4.0), (6.0, 4.17), (6.0, 3.83), (8.17, 4.0)] {
        assert_ne!(scale.colour(&picture, x_m, y_m), WHITE, "({x_m}, {y_m}) was visited");
    }
    for (x_m, y_m) in [(6.0, 4.24), (6.0, 3.76), (8.24, 4.0), (3.76, 4.0), (6.0, 6.0)] {
        assert_eq!(scale.colour(&picture, x_m, y_m), WHITE, "({x_m}, {y_m}) was not visited");
    }
}

#[test]
fn a_place_that_more_runs_came_over_is_darker_and_one_run_counts_once() {
    let along = |y_m| straight(LayerName::PassThrough, y_m, 4.0, 8.0);
    let there_and_back: Vec<[f64; 2]> = (0..=400).map(|index| [4.0 + 2.0 - 0.01 * f64::from(index), 6.0]).collect();
    let twice = there_and_back.iter().chain(there_and_back.iter().rev()).copied();
    let runs = [along(2.0), along(2.0), along(2.0), along(4.0), run(LayerName::PassThrough, twice)];
    let options = |measure| HeatMapOptions { footprint_radius_m: 0.1, measure, ..HeatMapOptions::default() };
    let picture = heat_map(&room(), &runs, &options(HeatMeasure::Runs));
    let scale = scale_of_room(&picture);
    let brightness = |colour: [u8; 3]| colour.iter().map(|part| u32::from(*part)).sum::<u32>();
    let [three, one, back] = [2.0, 4.0, 6.0].map(|y_m| scale.colour(&picture, 5.0, y_m));
    assert!(brightness(three) + 100 < brightness(one), "{three:?} {one:?}");
    assert_eq!(one, back, "the same run, there and back, is one run");
    let picture = heat_map(&room(), &runs, &options(HeatMeasure::PingSets));
    assert_ne!(
        scale.colour(&picture, 5.0, 4.0),
        scale.colour(&picture, 5.0, 6.0),
        "there and back takes more ping sets"
    );
}

#[test]
fn a_run_is_drawn_in_the_colours_of_the_layers_that_decided() {
    let runs: Vec<PlottedRun> =
        LAYERS.iter().enumerate().map(|(row, layer)| straight(*layer, 1.0 + row as f64, 4.0, 8.0)).collect();
    let picture = paths(&room(), &runs, &PathsOptions::default());
    let scale = scale_of_room(&picture);
    for (row, layer) in LAYERS.iter().enumerate() {
        assert_eq!(scale.colour(&picture, 6.0, 1.0 + row as f64), layer_colour(*layer), "{layer:?}");
        // The legend's own line stands below the map.
        let (width, height) = picture.size_px();
        let below = scale.pixel(0.0, 0.0).1 + 60;
        let in_legend = (below..height as i32)
            .flat_map(|y| (0..width as i32).map(move |x| (x, y)))
            .filter(|(x, y)| picture.pixel(*x, *y) == Some(layer_colour(*layer)))
            .count();
        assert!(in_legend > 30, "{layer:?} has no sign in the legend");
    }
    let mut colours = LAYERS.map(layer_colour).to_vec();
    colours.sort_unstable();
    colours.dedup();
    assert_eq!(colours.len(), LAYERS.len(), "no colour stands for two layers");
}

/// CIE L*a*b* of an sRGB colour as a reader sees it whose `sight` turns linear RGB into what is left of it.
fn seen(colour: [u8; 3], sight: [[f64; 3]; 3]) -> [f64; 3] {
    let linear = colour.map(|part| {
        let part = f64::from(part) / 255.0;
        if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
    });
    let [r, g, b] = sight.map(|row| (0..3).map(|part| row[part] * linear[part]).sum::<f64>().clamp(0.0, 1.0));
    let root = |share: f64| if share > 0.008_856 { share.cbrt() } else { 7.787 * share + 16.0 / 116.0 };
    let x = root((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
    let y = root(0.2126 * r + 0.7152 * g + 0.0722 * b);
    let z = root((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Smallest distance between two of the colours for readers of any sight: Machado, Oliveira and Fernandes 2009, table 1.
fn closest(colours: &[[u8; 3]]) -> f64 {
    let sights = [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.152_286, 1.052_583, -0.204_868], [0.114_503, 0.786_281, 0.099_216], [-0.003_882, -0.048_116, 1.051_998]],
        [[0.367_322, 0.860_646, -0.227_968], [0.280_085, 0.672_501, 0.047_413], [-0.011_820, 0.042_940, 0.968_881]],
        [[1.255_528, -0.076_749, -0.178_779], [-0.078_411, 0.930_809, 0.147_602], [0.004_733, 0.691_367, 0.303_900]],
    ];
    let mut closest = f64::INFINITY;
    for sight in sights {
        for (index, first) in colours.iter().enumerate() {
            for second in &colours[index + 1..] {
                let (a, b) = (seen(*first, sight), seen(*second, sight));
                closest = closest.min((0..3).map(|part| (a[part] - b[part]).powi(2)).sum::<f64>().sqrt());
            }
        }
    }
    closest
}

#[test]
fn colour_blind_readers_tell_the_layers_apart() {
    // Measured: 17, blue and green without blue cones; 23 for the far more common lack of red or green ones. A distance of 2
    // is just seen side by side; lines apart need several times as much.
    assert!(closest(&LAYERS.map(layer_colour)) > 15.0, "{}", closest(&LAYERS.map(layer_colour)));
    assert!(closest(&[[200, 60, 40], [110, 105, 30]]) < 15.0, "red and olive, which many confuse");
}

/// Whether the picture holds anything as red as a contact's cross near a place.
fn crossed(picture: &Picture, scale: &Scale, x_m: f64, y_m: f64) -> bool {
    let (x, y) = scale.pixel(x_m, y_m);
    let red = |pixel: [u8; 3]| pixel[0] > 200 && pixel[1] < 40 && pixel[2] < 40;
    (-3..=3).any(|step| picture.pixel(x + step, y + step).is_some_and(red))
}

#[test]
fn a_contact_is_crossed_out_where_the_run_ended_and_only_there() {
    let clean = straight(LayerName::FlowFollowing, 2.0, 4.0, 8.0);
    let contact = PlottedRun { collided: true, ..straight(LayerName::FlowFollowing, 5.0, 4.0, 8.0) };
    let runs = [clean, contact];
    for picture in
        [heat_map(&room(), &runs, &HeatMapOptions::default()), paths(&room(), &runs, &PathsOptions::default())]
    {
        let scale = scale_of_room(&picture);
        assert!(crossed(&picture, &scale, 8.0, 5.0));
        assert!(!crossed(&picture, &scale, 8.0, 2.0) && !crossed(&picture, &scale, 4.0, 5.0));
    }
}

/// The world as a mirror on the plane x = 0 shows it.
fn mirrored_world(world: &World) -> World {
    let mut world = world.clone();
    let flip = |point: &mut [f64; 2]| point[0] = -point[0];
    world.walls.iter_mut().flat_map(|wall| &mut wall.points).for_each(flip);
    world.pillars.iter_mut().map(|pillar| &mut pillar.centre).for_each(flip);
    world.movers.iter_mut().flat_map(|mover| &mut mover.path).for_each(flip);
    world
}

#[test]
fn a_mirrored_world_with_mirrored_runs_is_the_mirrored_picture() {
    let walls = vec![
        open_wall(&[[-5.0, -4.0], [5.0, -4.0]]),
        open_wall(&[[-5.0, 4.0], [5.0, 4.0]]),
        open_wall(&[[2.0, 1.0], [3.0, 2.5]]),
    ];
    let pillars = vec![Pillar { centre: [-3.0, 1.0], radius_m: 0.2 }];
    let path = vec![[1.0, -1.0], [4.0, -2.0]];
    let movers = vec![Mover { radius_m: 0.3, path, speed_m_s: 0.5, repeat: PathLoop::PingPong, start_s: 0.0 }];
    let world = World { walls, pillars, movers, ..World::default() };
    let wave = |side: f64| {
        run(
            LayerName::ObstacleAvoidance,
            (0..100).map(|index| {
                let along = f64::from(index) * 0.03;
                [side * (along - 1.0), 0.5 * (2.0 * along).sin()]
            }),
        )
    };
    let options = PathsOptions::default();
    let (left, right) =
        (paths(&mirrored_world(&world), &[wave(-1.0)], &options), paths(&world, &[wave(1.0)], &options));
    assert_ne!(left, right);
    let scale = Scale::read(&right, ([-5.0, 5.0], 11), ([-4.0, 4.0], 9));
    let (from, to) = (scale.pixel(-5.0, 4.0), scale.pixel(5.0, -4.0));
    for y in from.1..=to.1 {
        for step in 0..=to.0 - from.0 {
            let pair = [left.pixel(from.0 + step, y), right.pixel(to.0 - step, y)].map(|pixel| pixel.expect("inside"));
            // Rounding may move the smooth edge of a stroke by a shade.
            let apart = (0..3).map(|part| pair[0][part].abs_diff(pair[1][part])).max().unwrap_or(0);
            assert!(apart <= 2, "({step}, {y}): {pair:?}");
        }
    }
}

#[test]
fn a_window_shows_its_part_of_the_world_and_nothing_spills_over_its_frame() {
    let mut world = room();
    world.waypoints = vec![[2.0, 4.0]];
    world.reach_m = 3.0; // a circle far larger than the window
    let runs = [straight(LayerName::FlowFollowing, 4.0, 1.0, 9.0)];
    let window_m = Some([[1.0, 3.0], [5.0, 5.0]]);
    let picture = paths(&world, &runs, &PathsOptions { window_m, ..PathsOptions::default() });
    // Grown by a border of 0.1 m: ticks every half metre from 1.0 to 5.0 and from 3.0 to 5.0.
    let scale = Scale::read(&picture, ([1.0, 5.0], 9), ([3.0, 5.0], 5));
    assert_eq!(scale.colour(&picture, 4.0, 4.0), layer_colour(LayerName::FlowFollowing));
    let (x, y) = scale.pixel(3.0, 4.5);
    assert!(dark(&picture, x, y), "the inner wall");
    let blue = |pixel: [u8; 3]| pixel[2] > pixel[0].saturating_add(60);
    let (width, height) = (picture.size_px().0 as i32, scale.pixel(1.0, 2.85).1);
    let (left, right) = (scale.pixel(0.88, 3.0).0, scale.pixel(5.12, 3.0).0);
    for (x, y) in (0..height).flat_map(|y| (0..left).chain(right..width).map(move |x| (x, y))) {
        assert!(!picture.pixel(x, y).is_some_and(blue), "({x}, {y}) lies outside the frame");
    }
    let inverted = PathsOptions { window_m: Some([[5.0, 5.0], [1.0, f64::NAN]]), ..PathsOptions::default() };
    assert_eq!(paths(&world, &runs, &inverted), paths(&world, &runs, &PathsOptions::default()), "no window");
}

#[test]
fn nothing_to_plot_is_still_a_picture() {
    for world in [World::default(), room()] {
        for runs in [vec![], vec![run(LayerName::Stopped, [])]] {
            let sizes = [
                heat_map(&world, &runs, &HeatMapOptions::default()).size_px(),
                paths(&world, &runs, &PathsOptions::default()).size_px(),
                paths_by_layout(&world, &runs, &PathsOptions::default()).size_px(),
            ];
            assert!(sizes.iter().all(|(width, height)| *width >= 300 && *height >= 60), "{sizes:?}");
        }
    }
}

/// A world whose every number is `odd`: what a caller may build by hand, without the validation of a file.
fn odd_world(odd: f64) -> World {
    let mut world = room();
    world.walls.push(open_wall(&[[0.0, 0.0], [odd, 1.0], [odd, odd]]));
    world.walls.push(open_wall(&[]));
    world.pillars = vec![Pillar { centre: [odd, 1.0], radius_m: 0.1 }, Pillar { centre: [1.0, 1.0], radius_m: odd }];
    let mover =
        |path: Vec<[f64; 2]>| Mover { radius_m: odd, path, speed_m_s: odd, repeat: PathLoop::Cycle, start_s: odd };
    world.movers = vec![mover(vec![]), mover(vec![[1.0, 1.0], [odd, odd]])];
    world.waypoints = vec![[odd, 0.0], [2.0, odd], [1.0, 2.0]];
    world.reach_m = odd;
    world.start.corner = [odd, 0.0];
    world.start.size = [odd, odd];
    world
}

#[test]
fn nan_and_huge_numbers_neither_panic_nor_hang_nor_move_what_is_sound() {
    for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, -1e300, 1e12, -1.0] {
        let sound = straight(LayerName::FlowFollowing, 4.0, 4.0, 8.0);
        let mut holed = sound.clone();
        holed.points[50].x_m = odd;
        holed.points[60].y_m = odd;
        let runs = [sound, holed, run(LayerName::Stopped, [[odd, odd], [1.0, 1.0], [odd, 1.0]])];
        let began = Instant::now();
        let options = HeatMapOptions { footprint_radius_m: odd, ..HeatMapOptions::default() };
        let picture = heat_map(&odd_world(odd), &runs, &options);
        assert!(picture.size_px().0 < 4000, "{odd}");
        let picture = paths(&odd_world(odd), &runs, &PathsOptions::default());
        if odd.abs() > 1e4 || odd.is_nan() {
            let scale = scale_of_room(&picture);
            assert_eq!(scale.colour(&picture, 6.5, 4.0), layer_colour(LayerName::FlowFollowing), "{odd}");
        }
        let _ = paths_by_layout(
            &odd_world(odd),
            &runs,
            &PathsOptions { long_side_px: u32::MAX, ..PathsOptions::default() },
        );
        // Measured: below 0.1 s; a stroke walked to its far end would take minutes.
        assert!(began.elapsed() < Duration::from_secs(5), "{odd}: {:?}", began.elapsed());
    }
}
