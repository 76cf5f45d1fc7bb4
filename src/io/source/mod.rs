//! Where ping sets come from: the simulator, a recording, or drivers that publish raw pings.
//!
//! A source fills buffers that belong to the caller and never waits longer than it is told. It may read the clock; it
//! stamps each ping with its time of emission, which nothing later changes.

pub mod live;
pub mod recorded;
pub mod replay;
pub mod simulator;

use crate::geometry::Pose2;
use crate::io::ros::PipelineStep;
use crate::signal::{PingSet, Velocity};
use crate::time::Stamp;
use std::time::Duration;

/// What a source had to give.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// The buffer holds the next ping set.
    Set,
    /// Nothing came in time.
    Nothing,
    /// The source has ended: the recording is over.
    End,
}

/// Why a source cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// A recording is damaged or does not fit the configuration.
    #[error(transparent)]
    Recording(#[from] super::recording_file::RecordingError),
    /// Raw pings cannot be received or published.
    #[error(transparent)]
    Ipc(#[from] super::IpcError),
    /// A recorded run is damaged or does not fit the configuration.
    #[error(transparent)]
    Record(#[from] super::record::RecordError),
    /// Anything else, in one sentence that names what was found.
    #[error("{0}")]
    Other(String),
}

/// What the pipeline was told around a set of a recorded run, with times moved to the present.
#[derive(Debug, Clone)]
pub struct Moment {
    /// The "now" of the set.
    pub now: Stamp,
    /// The velocity that was wanted.
    pub wanted: Velocity,
    /// Where odometry said that the robot was.
    pub pose: Option<Pose2>,
    /// What the pipeline was told between the set before and this one.
    pub steps: Vec<PipelineStep>,
    /// The epoch of then, which arm requests carry.
    pub epoch: u64,
}

/// One way for ping sets to come in.
pub trait Source {
    /// Fills `pings` with the next ping set, waiting at most `limit`.
    ///
    /// # Errors
    /// [`SourceError`] when the source cannot go on at all. A ping that cannot be used is not an error: it is absent.
    fn next_ping_set(&mut self, pings: &mut PingSet, limit: Duration) -> Result<Delivery, SourceError>;

    /// The velocity that the source itself asks for, if it has a guidance (the simulator's waypoints).
    fn wanted_velocity(&self) -> Option<Velocity> {
        None
    }

    /// For a set of a recorded run: what the pipeline was told with it, and before it.
    fn moment(&mut self) -> Option<Moment> {
        None
    }

    /// What this source is, in a few words for the log.
    fn describe(&self) -> String;
}
