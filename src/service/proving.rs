//! The proving ground: many trials on a few threads, told in the order of layouts and seeds.
//!
//! Goes in: a world, robots ([`Entrant`]), seeds, conditions. Comes out: one [`Run`] for each robot and seed, in that order,
//! whatever the number of threads: a trial depends on world, robot, seed and conditions alone. A trial that fails is a
//! result among the others. No command line and no file is known here; the only clock read is that of the progress report.

use super::trial::{Moment, SensorLoss, Trial, TrialOptions, TrialRig};
use super::{ServiceError, crew};
use crate::imaging::params::Prefer;
use crate::sim::{SimParams, World};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};

/// A robot to be driven, and what it is called.
pub struct Entrant {
    /// Name of its layout.
    pub name: String,
    /// The robot.
    pub rig: TrialRig,
    /// Sensors that it loses on the way.
    pub losses: Vec<SensorLoss>,
}

/// What is to be driven.
pub struct Programme<'a> {
    /// The world.
    pub world: &'a World,
    /// The robots.
    pub entrants: &'a [Entrant],
    /// Acoustics of every run.
    pub acoustics: SimParams,
    /// Backend of every run.
    pub prefer: Prefer,
    /// Seed of each robot's first run; the next runs have the next seeds.
    pub first_seed: u64,
    /// Runs of each robot.
    pub runs: u64,
    /// Threads, at least 1.
    pub jobs: usize,
}

/// One drive.
#[derive(Debug)]
pub struct Run {
    /// Index of the robot in the programme.
    pub entrant: usize,
    /// Name of its layout.
    pub layout: String,
    /// Seed.
    pub seed: u64,
    /// How it went, or why it could not be driven.
    pub outcome: Result<Trial, ServiceError>,
}

/// What is told while a programme is driven.
pub enum Told<'a> {
    /// Ping sets done of those that it takes if every run lasts until the time limit. A run that ends earlier counts whole.
    Progress {
        /// Done.
        sets: u64,
        /// Of so many.
        of: u64,
    },
    /// A run is over; runs are told in the order of robots and seeds.
    Finished(&'a Run),
}

impl Programme<'_> {
    /// Drives everything and tells `hear`, on the calling thread, how it goes on.
    ///
    /// # Errors
    /// [`ServiceError::Internal`] when no thread can be started. What goes wrong in a run is in its [`Run::outcome`].
    pub fn drive(&self, hear: &mut dyn FnMut(Told)) -> Result<Vec<Run>, ServiceError> {
        let run_count = self.entrants.len() * self.runs as usize;
        let sets = AtomicU64::new(0);
        let of = self.entrants.iter().map(|entrant| self.sets_max(entrant) * self.runs).sum();
        let mut told = 0;
        let mut tell = |finished: &[Option<Run>]| {
            hear(Told::Progress { sets: sets.load(Ordering::Relaxed), of });
            while let Some(run) = finished.get(told).and_then(Option::as_ref) {
                hear(Told::Finished(run));
                told += 1;
            }
        };
        crew::work_off(run_count, self.jobs, "noctule-run", || (), |(), index| self.run(index, &sets), &mut tell)
    }

    /// Ping sets of a run that lasts until the world's time limit.
    fn sets_max(&self, entrant: &Entrant) -> u64 {
        (self.world.time_limit_s * entrant.rig.config().control.rate_hz).ceil() as u64
    }

    fn run(&self, index: usize, sets: &AtomicU64) -> Run {
        let (entrant, number) = (index / self.runs as usize, index as u64 % self.runs);
        let robot = &self.entrants[entrant];
        let seed = self.first_seed.wrapping_add(number);
        let options = TrialOptions {
            acoustics: self.acoustics,
            seed,
            prefer: self.prefer,
            losses: robot.losses.clone(),
            slips: Vec::new(),
        };
        let mut count = 0;
        let mut watch = |_: &Moment| {
            count += 1;
            sets.fetch_add(1, Ordering::Relaxed);
            true
        };
        // The other runs are worth keeping even when one of them finds a fault in this program.
        let driven = catch_unwind(AssertUnwindSafe(|| robot.rig.run(self.world.clone(), &options, &mut watch)));
        let died = |_| Err(ServiceError::Internal("the run died; its last words are on standard error".to_owned()));
        let outcome = driven.unwrap_or_else(died);
        sets.fetch_add(self.sets_max(robot).saturating_sub(count), Ordering::Relaxed);
        Run { entrant, layout: robot.name.clone(), seed, outcome }
    }
}
