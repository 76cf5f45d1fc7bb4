//! From the edges of a diagram to a graph of midlines: what is reached from the start, chains joined, coinciding vertices made one.

use super::{EdgeGraph, Midline, Node};
use crate::detect::projection::Edge;
use nalgebra::Vector2;

/// Vertices closer than this are one.
const MERGE_M: f64 = 1e-3;

/// Vertices and what joins them.
pub(super) struct Links {
    places_m: Vec<Vector2<f64>>,
    /// The vertex that stands for each.
    same: Vec<usize>,
    links: Vec<Link>,
}

struct Link {
    ends: [usize; 2],
    points_m: Vec<Vector2<f64>>,
    clearance_m: f64,
}

impl Links {
    pub(super) fn new(places_m: impl Iterator<Item = Vector2<f64>>) -> Self {
        let places_m: Vec<Vector2<f64>> = places_m.collect();
        let mut order: Vec<usize> = (0..places_m.len()).collect();
        order.sort_by(|a, b| places_m[*a].x.total_cmp(&places_m[*b].x));
        let mut same: Vec<usize> = (0..places_m.len()).collect();
        for (rank, &vertex) in order.iter().enumerate() {
            let near =
                order[..rank].iter().rev().take_while(|other| places_m[vertex].x - places_m[**other].x <= MERGE_M);
            let twin = near.copied().find(|other| (places_m[vertex] - places_m[*other]).norm() <= MERGE_M);
            if let Some(twin) = twin {
                same[vertex] = same[twin];
            }
        }
        Self { places_m, same, links: Vec::new() }
    }

    pub(super) fn join(&mut self, from: usize, to: usize, points_m: Vec<Vector2<f64>>, clearance_m: f64) {
        let ends = [self.same[from], self.same[to]];
        if ends[0] != ends[1] {
            self.links.push(Link { ends, points_m, clearance_m });
        }
    }

    /// The graph of what can be reached from the vertex that is nearest to `start_m` and in sight of it.
    pub(super) fn graph(
        self,
        start_m: Vector2<f64>,
        walls: &[Edge],
        clearance_m: impl Fn(Vector2<f64>) -> f64,
    ) -> EdgeGraph {
        let mut at: Vec<Vec<usize>> = vec![Vec::new(); self.places_m.len()];
        for (index, link) in self.links.iter().enumerate() {
            link.ends.iter().for_each(|end| at[*end].push(index));
        }
        let reached = self.reached(&at, start_m, walls);
        let is_node = |vertex: usize| reached[vertex] && at[vertex].len() != 2;
        let mut graph = EdgeGraph::default();
        let mut number = vec![usize::MAX; self.places_m.len()];
        let mut used = vec![false; self.links.len()];
        let mut begin: Vec<usize> = (0..self.places_m.len()).filter(|vertex| is_node(*vertex)).collect();
        // A ring without any junction begins anywhere.
        begin.extend((0..self.places_m.len()).filter(|vertex| reached[*vertex] && at[*vertex].len() == 2));
        for vertex in begin {
            for &first in &at[vertex] {
                if used[first] {
                    continue;
                }
                let (last, midline) = self.chain(&at, &mut used, (vertex, first));
                let [from, to] = [vertex, last].map(|vertex| {
                    if number[vertex] == usize::MAX {
                        number[vertex] = graph.nodes.len();
                        let place_m = self.places_m[vertex];
                        graph.nodes.push(Node { place_m, clearance_m: clearance_m(place_m) });
                    }
                    number[vertex]
                });
                graph.midlines.push(Midline { from, to, ..midline });
            }
        }
        graph
    }

    /// Follows links from a vertex until the next node, or round to where it began.
    fn chain(&self, at: &[Vec<usize>], used: &mut [bool], (vertex, first): (usize, usize)) -> (usize, Midline) {
        let mut midline = Midline {
            from: 0,
            to: 0,
            points_m: vec![self.places_m[vertex]],
            length_m: 0.0,
            clearance_m: f64::INFINITY,
        };
        let (mut here, mut link) = (vertex, first);
        loop {
            used[link] = true;
            let Link { ends, points_m, clearance_m } = &self.links[link];
            midline.clearance_m = midline.clearance_m.min(*clearance_m);
            let forward = ends[0] == here;
            let next = if forward { points_m.iter().skip(1).copied().collect() } else { reversed(points_m) };
            midline.points_m.extend(next);
            here = if forward { ends[1] } else { ends[0] };
            let onward = at[here].iter().copied().find(|other| !used[*other]);
            match onward {
                Some(onward) if at[here].len() == 2 && here != vertex => link = onward,
                _ => break,
            }
        }
        midline.length_m = midline.points_m.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        (here, midline)
    }

    fn reached(&self, at: &[Vec<usize>], start_m: Vector2<f64>, walls: &[Edge]) -> Vec<bool> {
        let mut candidates: Vec<usize> = (0..self.places_m.len()).filter(|vertex| !at[*vertex].is_empty()).collect();
        let far_m = |vertex: &usize| (self.places_m[*vertex] - start_m).norm();
        candidates.sort_by(|a, b| far_m(a).total_cmp(&far_m(b)));
        let in_sight = |vertex: &&usize| walls.iter().all(|wall| !crosses(wall, start_m, self.places_m[**vertex]));
        let mut reached = vec![false; self.places_m.len()];
        let mut open: Vec<usize> = candidates.iter().find(in_sight).copied().into_iter().collect();
        while let Some(vertex) = open.pop() {
            if !std::mem::replace(&mut reached[vertex], true) {
                open.extend(at[vertex].iter().flat_map(|link| self.links[*link].ends));
            }
        }
        reached
    }
}

fn reversed(points_m: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    points_m.iter().rev().skip(1).copied().collect()
}

fn crosses(wall: &Edge, from_m: Vector2<f64>, to_m: Vector2<f64>) -> bool {
    let sight = Edge { start_m: from_m, end_m: to_m };
    let apart = |edge: &Edge, other: &Edge| edge.local_m(other.start_m).y * edge.local_m(other.end_m).y < 0.0;
    apart(wall, &sight) && apart(&sight, wall)
}
