//! How a process of the running robot lives and ends: what daemon and controller share of it.
//!
//! | file | what |
//! |---|---|
//! | [`stop`] | asked to end by a signal, they end in order; on the spot where nothing is held yet |
//! | [`mod@panic`] | a thread that panics takes the whole process with it, exit 70 |
//! | [`notify`] | what the service manager is told |
//! | [`log_queue`] | a log that holds nobody up |
//!
//! Knows nothing of sonar and never decides for the robot.

pub mod log_queue;
pub mod notify;
pub mod panic;
pub mod stop;

pub use log_queue::LogQueue;
pub use notify::Notifier;
pub use stop::{Stop, stop_flag};
