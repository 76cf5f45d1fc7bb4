//! `noctule detect edges`: the midlines between the walls of a world, as a table, JSON or picture.

use crate::cli::args::{ConfigChoice, EdgesArguments};
use crate::cli::output::{print_line, write_picture};
use crate::cli::{Failure, exit};
use crate::detect::voronoi::{self, EdgeGraph};
use crate::io::plot::{EdgePanel, edge_panels};
use crate::service::corridor::wall_pieces;
use crate::sim::World;
use nalgebra::Vector2;
use serde_json::{Value, json};

/// Corners of the polygon that stands for a round pillar.
const PILLAR_CORNERS: usize = 16;

/// Runs the command.
///
/// # Errors
/// 65 for a world of no use, 73, 74, 77, 78.
pub(super) fn edges(arguments: &EdgesArguments, choice: &ConfigChoice) -> Result<(), Failure> {
    let config = crate::cli::config::load(choice)?;
    let world = crate::cli::simulate::choice::world(&arguments.world)?;
    let safe_width_m = config.detect.projection.safe_width_m;
    let start_m = Vector2::from(world.start.corner) + 0.5 * Vector2::from(world.start.size);
    let graph = voronoi::edges(&wall_pieces(&world, PILLAR_CORNERS), safe_width_m, start_m)
        .map_err(|error| Failure::new(exit::DATA, format!("{}: {error}", arguments.world.display())))?;
    if arguments.json {
        print_line(&format!("{:#}", to_json(&graph, safe_width_m)))?;
    } else {
        table(&graph).iter().try_for_each(|line| print_line(line))?;
    }
    arguments.plot.as_ref().map_or(Ok(()), |path| {
        let title = format!("edges at least {safe_width_m} m wide");
        write_picture(path, &edge_panels(&title, &[panel(&world, &graph)], 1))
    })
}

fn panel<'a>(world: &'a World, graph: &EdgeGraph) -> EdgePanel<'a> {
    let line = |points_m: &Vec<Vector2<f64>>| points_m.iter().map(|point| (*point).into()).collect();
    EdgePanel {
        title: format!("{} nodes, {} midlines", graph.nodes.len(), graph.midlines.len()),
        world,
        lines_m: graph.midlines.iter().map(|midline| line(&midline.points_m)).collect(),
        way: Vec::new(),
        collided: false,
    }
}

fn table(graph: &EdgeGraph) -> Vec<String> {
    let place = |node: usize| {
        let place_m = graph.nodes[node].place_m;
        format!("({:.3}, {:.3})", place_m.x, place_m.y)
    };
    let mut lines = vec![format!("{:>4}  {:>18}  {:>18}  {:>9}  {:>9}", "edge", "from", "to", "length_m", "width_m")];
    lines.extend(graph.midlines.iter().enumerate().map(|(index, midline)| {
        let (from, to) = (place(midline.from), place(midline.to));
        format!("{index:>4}  {from:>18}  {to:>18}  {:>9.3}  {:>9.3}", midline.length_m, 2.0 * midline.clearance_m)
    }));
    lines
}

fn to_json(graph: &EdgeGraph, safe_width_m: f64) -> Value {
    let point = |point: &Vector2<f64>| json!([point.x, point.y]);
    let nodes =
        graph.nodes.iter().map(|node| json!({"place_m": point(&node.place_m), "clearance_m": node.clearance_m}));
    let midlines = graph.midlines.iter().map(|midline| {
        json!({
            "from": midline.from,
            "to": midline.to,
            "length_m": midline.length_m,
            "clearance_m": midline.clearance_m,
            "points_m": midline.points_m.iter().map(point).collect::<Vec<_>>(),
        })
    });
    json!({
        "safe_width_m": safe_width_m,
        "nodes": nodes.collect::<Vec<_>>(),
        "midlines": midlines.collect::<Vec<_>>(),
    })
}
