//! Runs as JSON, whose keys are a contract (specification, section 11), and as lines for people.
//!
//! No time of the machine is in either: the same runs give the same bytes.

use crate::service::proving::Run;
use crate::service::trial::Trial;
use serde_json::{Map, Value, json};

/// The runs that were driven.
pub fn records(runs: &[Run], world: &str) -> Vec<Value> {
    runs.iter().filter_map(|run| Some(record(run, run.outcome.as_ref().ok()?, world))).collect()
}

fn record(run: &Run, trial: &Trial, world: &str) -> Value {
    let score = &trial.score;
    let shares: Map<String, Value> =
        trial.layer_share().iter().map(|(layer, share)| (layer.as_str().to_owned(), json!(share))).collect();
    let end = trial.track.last().map(|point| {
        let pose = point.pose;
        json!({ "x_m": pose.x_m, "y_m": pose.y_m, "heading_deg": pose.heading_rad.to_degrees() })
    });
    json!({
        "world": world,
        "layout": run.layout,
        "seed": run.seed,
        "collided": score.collided,
        "reached_goal": score.reached_goal,
        "waypoints_reached": score.waypoints_reached,
        "longest_stuck_s": score.longest_stuck_s,
        "longest_stuck_unhindered_s": trial.longest_stuck_unhindered_s,
        "duration_s": score.duration_s,
        "path_length_m": score.path_length_m,
        "min_clearance_m": score.min_clearance_m,
        "mean_speed_m_s": score.mean_speed_m_s,
        "turn_changes_per_m": trial.turn_changes_per_m,
        "layer_share": shares,
        "end": end,
    })
}

/// The runs that could not be driven, and why.
pub fn failures(runs: &[Run]) -> Vec<Value> {
    let failed = |run: &Run| {
        let error = run.outcome.as_ref().err()?;
        Some(json!({ "layout": run.layout, "seed": run.seed, "error": error.to_string() }))
    };
    runs.iter().filter_map(failed).collect()
}

/// Several runs in one.
#[derive(Default)]
struct Tally {
    runs: usize,
    failed: usize,
    collided: usize,
    reached_goal: usize,
    longest_stuck_s: f64,
    longest_stuck_unhindered_s: f64,
    /// Absent before the first run that was driven.
    min_clearance_m: Option<f64>,
    turn_changes_per_m: f64,
    path_length_m: f64,
    duration_s: f64,
}

impl Tally {
    fn of<'a>(runs: impl Iterator<Item = &'a Run>) -> Self {
        let mut tally = Self::default();
        for run in runs {
            tally.runs += 1;
            match &run.outcome {
                Ok(trial) => tally.add(trial),
                Err(_) => tally.failed += 1,
            }
        }
        tally
    }

    fn add(&mut self, trial: &Trial) {
        let score = &trial.score;
        self.collided += usize::from(score.collided);
        self.reached_goal += usize::from(score.reached_goal);
        self.longest_stuck_s = self.longest_stuck_s.max(score.longest_stuck_s);
        self.longest_stuck_unhindered_s = self.longest_stuck_unhindered_s.max(trial.longest_stuck_unhindered_s);
        let clearance_m = self.min_clearance_m.map_or(score.min_clearance_m, |least| least.min(score.min_clearance_m));
        self.min_clearance_m = Some(clearance_m);
        self.turn_changes_per_m = self.turn_changes_per_m.max(trial.turn_changes_per_m);
        self.path_length_m += score.path_length_m;
        self.duration_s += score.duration_s;
    }

    fn mean_speed_m_s(&self) -> f64 {
        if self.duration_s > 0.0 { self.path_length_m / self.duration_s } else { 0.0 }
    }

    fn json(&self) -> Map<String, Value> {
        let value = json!({
            "runs": self.runs,
            "failed": self.failed,
            "collided": self.collided,
            "reached_goal": self.reached_goal,
            "longest_stuck_s": self.longest_stuck_s,
            "longest_stuck_unhindered_s": self.longest_stuck_unhindered_s,
            "min_clearance_m": self.min_clearance_m,
            "mean_speed_m_s": self.mean_speed_m_s(),
            "turn_changes_per_m": self.turn_changes_per_m,
        });
        match value {
            Value::Object(map) => map,
            _ => Map::new(),
        }
    }

    fn line(&self, name: &str) -> String {
        format!(
            "{name:12} {:>6} {:>7} {:>6} {:>6} {:>7.1} {:>8} {:>6.2} {:>7.1} {:>8.1} {:>7.2}",
            self.runs,
            self.collided,
            self.reached_goal,
            self.failed,
            self.duration_s,
            self.min_clearance_m.map_or("-".to_owned(), |least_m| format!("{least_m:.2}")),
            self.mean_speed_m_s(),
            self.longest_stuck_s,
            self.longest_stuck_unhindered_s,
            self.turn_changes_per_m
        )
    }
}

/// The runs of each layout, in the order of the runs.
fn by_layout(runs: &[Run]) -> Vec<(&str, Tally)> {
    let parts = runs.chunk_by(|a, b| a.entrant == b.entrant);
    parts.map(|part| (part[0].layout.as_str(), Tally::of(part.iter()))).collect()
}

/// All runs in one, and those of each layout.
pub fn summary(runs: &[Run]) -> Value {
    let mut summary = Tally::of(runs.iter()).json();
    let layouts: Map<String, Value> =
        by_layout(runs).iter().map(|(name, tally)| ((*name).to_owned(), Value::Object(tally.json()))).collect();
    summary.insert("layouts".to_owned(), Value::Object(layouts));
    Value::Object(summary)
}

/// The summary for people: the worst of each layout and of all.
pub fn summary_lines(runs: &[Run]) -> Vec<String> {
    let layouts = by_layout(runs);
    let header = format!(
        "{:12} {:>6} {:>7} {:>6} {:>6} {:>7} {:>8} {:>6} {:>7} {:>8} {:>7}",
        "summary", "runs", "contact", "goal", "failed", "time_s", "clear_m", "m/s", "stop_s", "alone_s", "turns/m"
    );
    let mut lines = vec![String::new(), header];
    if layouts.len() > 1 {
        lines.extend(layouts.iter().map(|(name, tally)| tally.line(name)));
    }
    lines.push(Tally::of(runs.iter()).line("all"));
    lines
}

/// What stands above the lines.
pub fn header() -> String {
    format!(
        "{:12} {:>6} {:8} {:>7} {:>7} {:>7} {:>6} {:>8} {:>7} {:>8} {:>7}  layers",
        "layout", "seed", "result", "goals", "time_s", "path_m", "m/s", "clear_m", "stop_s", "alone_s", "turns/m"
    )
}

/// One run; `alone_s` is the longest stop with no mover near.
pub fn line(run: &Run, waypoints: usize) -> String {
    let trial = match &run.outcome {
        Ok(trial) => trial,
        Err(error) => return format!("{:12} {:>6} failed: {error}", run.layout, run.seed),
    };
    let score = &trial.score;
    let result = match (score.collided, score.reached_goal) {
        (true, _) => "CONTACT",
        (false, true) => "goal",
        (false, false) => "missed",
    };
    let shares = trial.layer_share();
    let layers: Vec<String> = shares
        .iter()
        .filter(|(_, share)| *share > 0.0)
        .map(|(layer, share)| format!("{} {:.0} %", layer.as_str(), share * 100.0))
        .collect();
    format!(
        "{:12} {:>6} {:8} {:>7} {:>7.1} {:>7.2} {:>6.2} {:>8.2} {:>7.1} {:>8.1} {:>7.2}  {}",
        run.layout,
        run.seed,
        result,
        format!("{}/{waypoints}", score.waypoints_reached),
        score.duration_s,
        score.path_length_m,
        score.mean_speed_m_s,
        score.min_clearance_m,
        score.longest_stuck_s,
        trial.longest_stuck_unhindered_s,
        trial.turn_changes_per_m,
        layers.join(", ")
    )
}
