//! Contract: A* over the occupancy grid finds a way as cheap as the cheapest, keeps the robot clear of everything occupied, and
//! says none where there is none. The oracle relaxes all steps until nothing changes; its geometry is its own.

use nalgebra::Vector2;
use noctule::detect::route::{GridMap, Route, RouteOptions, route};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const WIDTH: usize = 14;
const HEIGHT: usize = 11;

fn map(percent: &[u8], cell_m: f64) -> GridMap<'_> {
    GridMap { width: WIDTH, height: HEIGHT, cell_m, origin_m: Vector2::new(-0.7, 0.3), percent }
}

fn middle_m(map: &GridMap, cell: usize) -> Vector2<f64> {
    map.origin_m + Vector2::new((cell % WIDTH) as f64, (cell / WIDTH) as f64) * map.cell_m
}

/// Distance of a place from the square of a cell.
fn gap_m(map: &GridMap, cell: usize, place_m: Vector2<f64>) -> f64 {
    let half = Vector2::repeat(0.5 * map.cell_m);
    let middle_m = middle_m(map, cell);
    (place_m - place_m.sup(&(middle_m - half)).inf(&(middle_m + half))).norm()
}

fn is_occupied(percent: u8, options: &RouteOptions) -> bool {
    percent != 255 && percent >= options.occupied_percent
}

/// Cost of a step into each cell per metre; nothing where the robot cannot stand.
fn weights(map: &GridMap, options: &RouteOptions) -> Vec<Option<f64>> {
    let stands = |cell: usize| {
        let others = map.percent.iter().enumerate().filter(|(_, percent)| is_occupied(**percent, options));
        others
            .into_iter()
            .all(|(other, _)| other != cell && gap_m(map, other, middle_m(map, cell)) >= options.robot_radius_m - 1e-9)
    };
    (0..WIDTH * HEIGHT)
        .map(|cell| if map.percent[cell] == 255 { options.unknown_cost } else { Some(1.0) }.filter(|_| stands(cell)))
        .collect()
}

/// Cheapest cost from `start` to every cell.
fn cheapest(map: &GridMap, options: &RouteOptions, start: usize) -> Vec<f64> {
    let weights = weights(map, options);
    let mut costs = vec![f64::INFINITY; WIDTH * HEIGHT];
    costs[start] = 0.0;
    loop {
        let mut changed = false;
        for from in (0..WIDTH * HEIGHT).filter(|cell| costs[*cell].is_finite()).collect::<Vec<_>>() {
            let (x, y) = ((from % WIDTH) as i32, (from / WIDTH) as i32);
            for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                let at = |x: i32, y: i32| {
                    let inside = (0..WIDTH as i32).contains(&x) && (0..HEIGHT as i32).contains(&y);
                    inside.then(|| (y as usize) * WIDTH + x as usize)
                };
                let Some(to) = at(x + dx, y + dy) else { continue };
                let open = |cell: Option<usize>| cell.is_some_and(|cell| weights[cell].is_some());
                let cuts = dx != 0 && dy != 0 && !(open(at(x + dx, y)) && open(at(x, y + dy)));
                let Some(weight) = weights[to].filter(|_| !cuts) else { continue };
                let cost = costs[from] + weight * map.cell_m * f64::from(dx * dx + dy * dy).sqrt();
                if cost < costs[to] - 1e-12 {
                    (costs[to], changed) = (cost, true);
                }
            }
        }
        if !changed {
            return costs;
        }
    }
}

fn random_percent(random: &mut ChaCha8Rng) -> Vec<u8> {
    let draw = |random: &mut ChaCha8Rng| match random.random_range(0..10) {
        0..2 => 90,
        2..4 => 255,
        4 => 60,
        _ => 5,
    };
    (0..WIDTH * HEIGHT).map(|_| draw(random)).collect()
}

/// Places along a way, a centimetre apart.
fn places(found: &Route) -> Vec<Vector2<f64>> {
    let along = |pair: &[Vector2<f64>]| {
        let (from, to) = (pair[0], pair[1]);
        (0..=40).map(move |step| from + (to - from) * (f64::from(step) / 40.0)).collect::<Vec<_>>()
    };
    found.points_m.windows(2).flat_map(along).collect()
}

#[test]
fn on_random_grids_the_way_is_as_cheap_as_the_cheapest_and_touches_nothing() {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let (mut ways, mut none) = (0, 0);
    for trial in 0..600 {
        let percent = random_percent(&mut random);
        let map = map(&percent, 0.2);
        let options = RouteOptions {
            robot_radius_m: [0.05, 0.1, 0.15, 0.25][trial % 4],
            unknown_cost: [Some(3.0), Some(1.0), None][trial % 3],
            ..RouteOptions::default()
        };
        let (start, goal) = (random.random_range(0..WIDTH * HEIGHT), random.random_range(0..WIDTH * HEIGHT));
        let expected = cheapest(&map, &options, start)[goal];
        let found = route(&map, middle_m(&map, start), middle_m(&map, goal), &options);
        let Some(found) = found else {
            assert!(expected.is_infinite(), "trial {trial}: a way of {expected} m was missed");
            none += 1;
            continue;
        };
        ways += 1;
        // A step along the diagonal costs 1.4142.
        assert!(
            (found.cost_m - expected).abs() < 1e-4 * expected.max(1.0),
            "trial {trial}: {} for {expected}",
            found.cost_m
        );
        assert!(found.length_m <= found.cost_m * (1.0 + 1e-4));
        for place_m in places(&found).into_iter().filter(|place_m| (place_m - middle_m(&map, start)).norm() > 0.3) {
            for cell in (0..WIDTH * HEIGHT).filter(|cell| is_occupied(percent[*cell], &options)) {
                assert!(
                    gap_m(&map, cell, place_m) >= options.robot_radius_m - 1e-6,
                    "trial {trial}: touches at {place_m}"
                );
            }
        }
    }
    assert!(ways > 100 && none > 100, "{ways} ways, {none} times none");
}

#[test]
fn a_closed_ring_a_place_outside_and_an_occupied_goal_have_no_way() {
    let mut percent = vec![0; WIDTH * HEIGHT];
    for (x, y) in (3..8).flat_map(|x| (3..8).map(move |y| (x, y))) {
        if x == 3 || x == 7 || y == 3 || y == 7 {
            percent[y * WIDTH + x] = 100;
        }
    }
    let map = map(&percent, 0.2);
    let (outside, inside) = (middle_m(&map, 0), middle_m(&map, 5 * WIDTH + 5));
    let options = RouteOptions::default();
    assert_eq!(route(&map, outside, inside, &options), None);
    assert_eq!(route(&map, outside, middle_m(&map, 3 * WIDTH + 3), &options), None, "an occupied goal");
    assert_eq!(route(&map, outside, Vector2::new(100.0, 0.0), &options), None, "outside the map");
    assert_eq!(route(&map, outside, Vector2::new(f64::NAN, 0.0), &options), None);
    let short = route(&map, outside, outside + Vector2::new(0.02, 0.0), &options).expect("the same cell");
    assert_eq!((short.points_m.len(), short.length_m), (2, 0.0));
}

#[test]
fn unknown_cells_are_gone_round_if_that_is_cheaper_and_never_entered_if_closed() {
    // A wall of unknown cells with a gap at its far end.
    let mut percent = vec![0; WIDTH * HEIGHT];
    for y in 0..HEIGHT - 1 {
        percent[y * WIDTH + 6] = 255;
    }
    let map = map(&percent, 0.2);
    let (from, to) = (middle_m(&map, 4), middle_m(&map, 8));
    let way = |unknown_cost| {
        let options = RouteOptions { unknown_cost, robot_radius_m: 0.05, ..RouteOptions::default() };
        route(&map, from, to, &options).expect("a way").length_m
    };
    assert!((way(Some(1.0)) - 0.8).abs() < 1e-9, "straight through");
    assert!((way(Some(5.0)) - 0.8).abs() < 1e-9, "still the cheapest");
    assert!(way(Some(200.0)) > 3.0 && way(None) > 3.0, "round it");
}
