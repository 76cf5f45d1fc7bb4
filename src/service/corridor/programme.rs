//! Many runs through random corridors on a few threads, one table: every detector drives the same corridors.
//!
//! Goes in: a robot, detectors ([`Entry`]), seeds. Comes out: runs in the order of detectors and seeds, whatever the number of threads,
//! and [`CorridorSummary`]. A run depends on robot, seed and detector alone.

use super::{Corridor, CorridorRun};
use crate::detect::{Detector, ProjectionParams};
use crate::service::trial::TrialRig;
use crate::service::{ServiceError, crew};
use serde::Serialize;

/// Limits of the classical detector in the table.
const CLASSICAL_LIMITS_M: [f64; 4] = [0.2, 0.3, 0.4, 0.5];

/// A detector that drives.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// What the table calls it.
    pub name: String,
    /// What detects.
    pub detector: Detector,
    /// Its parameters; the path is the corridor's.
    pub params: ProjectionParams,
}

impl Entry {
    /// Vector projection that counts reflectors on the safe path, as in the paper, and the classical detector at four limits.
    #[must_use]
    pub fn all(params: &ProjectionParams) -> Vec<Entry> {
        let projection = |name: &str, safe_path_only| Entry {
            name: name.to_owned(),
            detector: Detector::Projection,
            params: ProjectionParams { safe_path_only, ..params.clone() },
        };
        let classical = CLASSICAL_LIMITS_M.map(|limit_m| Entry {
            name: format!("classical {limit_m} m"),
            detector: Detector::Classical { limit_m },
            params: params.clone(),
        });
        let projections = [projection("projection", true), projection("projection, paper", false)];
        projections.into_iter().chain(classical).collect()
    }
}

/// Random corridors and who drives them.
pub struct CorridorProgramme<'a> {
    /// The robot.
    pub rig: &'a TrialRig,
    /// The detectors.
    pub entries: &'a [Entry],
    /// A corridor that all drive instead of random ones.
    pub corridor: Option<Corridor>,
    /// Seed of the first corridor; the next have the next seeds.
    pub first_seed: u64,
    /// Number of corridors.
    pub runs: u64,
    /// Threads, at least 1.
    pub jobs: usize,
}

/// A row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CorridorSummary {
    /// The detector.
    pub detector: String,
    /// Runs.
    pub runs: usize,
    /// Obstacles on the safe path that the robot came to.
    pub met: usize,
    /// Of these, those at which it stopped.
    pub detected: usize,
    /// Stops at what is not on the safe path.
    pub false_stops: usize,
    /// Of these, those at the building's walls.
    pub wall_stops: usize,
    /// Way driven by all.
    pub way_m: f64,
    /// Runs that reached the end of the path.
    pub arrived: usize,
    /// Runs that ended at an obstacle that cannot be passed.
    pub rightly_blocked: usize,
    /// Runs that gave up where there was a way.
    pub wrongly_blocked: usize,
    /// Runs that touched something.
    pub contacts: usize,
    /// Runs that ended for lack of time.
    pub late: usize,
    /// Smallest gap between footprint and anything, of all runs.
    pub min_clearance_m: f64,
    /// Median over the runs of the smallest gap.
    pub median_clearance_m: f64,
}

impl CorridorSummary {
    /// The row of some runs.
    #[must_use]
    pub fn of<'a>(detector: &str, runs: impl Iterator<Item = &'a CorridorRun>) -> Self {
        let runs: Vec<&CorridorRun> = runs.collect();
        let sum = |count: fn(&CorridorRun) -> usize| runs.iter().map(|run| count(run)).sum();
        let mut clearances_m: Vec<f64> = runs.iter().map(|run| run.min_clearance_m).collect();
        clearances_m.sort_by(f64::total_cmp);
        Self {
            detector: detector.to_owned(),
            runs: runs.len(),
            met: sum(|run| run.met),
            detected: sum(|run| run.detected),
            false_stops: sum(|run| run.false_stops),
            wall_stops: sum(|run| run.wall_stops),
            way_m: runs.iter().map(|run| run.way_m).sum(),
            arrived: sum(|run| run.arrived.into()),
            rightly_blocked: sum(|run| run.rightly_blocked.into()),
            wrongly_blocked: sum(|run| (run.blocked && !run.rightly_blocked).into()),
            contacts: sum(|run| run.collided.into()),
            late: sum(|run| (!run.arrived && !run.blocked && !run.collided).into()),
            min_clearance_m: clearances_m.first().copied().unwrap_or(f64::NAN),
            median_clearance_m: clearances_m.get(clearances_m.len() / 2).copied().unwrap_or(f64::NAN),
        }
    }
}

impl CorridorProgramme<'_> {
    /// The corridor of a run.
    #[must_use]
    pub fn corridor(&self, number: u64) -> Corridor {
        if let Some(corridor) = &self.corridor {
            return corridor.clone();
        }
        let safe_width_m = self.entries.first().map_or(0.6, |entry| entry.params.safe_width_m);
        Corridor::random(self.first_seed.wrapping_add(number), safe_width_m)
    }

    /// Drives everything: a list of runs for each detector. `progress` is told the runs done.
    ///
    /// # Errors
    /// The first run that could not be driven, or when no thread can be started.
    pub fn drive(&self, progress: &mut dyn FnMut(u64)) -> Result<Vec<Vec<CorridorRun>>, ServiceError> {
        let count = self.entries.len() * self.runs as usize;
        let mut tell = |finished: &[Option<_>]| progress(finished.iter().flatten().count() as u64);
        let work = |(): &mut (), index| self.run(index);
        let runs = crew::work_off(count, self.jobs, "noctule-corridor", || (), work, &mut tell)?;
        let runs: Vec<CorridorRun> = runs.into_iter().collect::<Result<_, _>>()?;
        Ok(runs.chunks(self.runs.max(1) as usize).map(<[CorridorRun]>::to_vec).collect())
    }

    fn run(&self, index: usize) -> Result<CorridorRun, ServiceError> {
        let (entry, number) = (&self.entries[index / self.runs as usize], index as u64 % self.runs);
        let seed = self.first_seed.wrapping_add(number);
        self.corridor(number).drive(self.rig, entry.detector, &entry.params, seed, &mut |_| true)
    }
}
