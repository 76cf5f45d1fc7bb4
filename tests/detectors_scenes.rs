//! Contract: what the detectors say of simulated scenes is what stands there: the scan of the whole robot, the figures and drives of paper
//! 001, edges between walls, the virtual sonar ring of paper 003. One file a subject, in one program, since each links everything.

mod checks;

#[path = "detectors_scenes/edges.rs"]
mod edges;
#[path = "detectors_scenes/projection.rs"]
mod projection;
#[path = "detectors_scenes/ring.rs"]
mod ring;
#[path = "detectors_scenes/scan.rs"]
mod scan;
