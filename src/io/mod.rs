//! The only place that touches shared memory, files and screens.
//!
//! | file | what |
//! |---|---|
//! | [`topics`] | names, layouts and depths of all topics |
//! | [`wire`] | the types on them |
//! | [`node`], `session`, `ports`, `watch` | set-up, ports, a way out of a hang |
//! | `root`, `files`, `probe` | root directory, locks, what lies there, whether it still does |
//! | [`daemon_topics`], [`detector_topics`], [`raw_topics`], [`clients`], [`status_topics`], [`view_topics`], [`energyscape_reader`] | who publishes and listens to what |
//! | [`c_header`], [`relay`] | the types for clients in C, copies for other machines |
//! | [`echo`] | what passes on a topic, for people and programs |
//! | [`record`] | a run to MCAP and back |
//! | [`ros`] | our nouns as ROS 2 messages |
//! | [`survey`] | root, files and neighbours as seen from outside, for diagnosis |
//! | [`source`] | where ping sets come from |
//! | [`recording_file`], [`picture`], [`plot`], [`plot_layouts`] | files in, pictures out |

pub mod c_header;
mod canvas;
pub mod clients;
pub mod daemon_topics;
pub mod detector_topics;
pub mod echo;
pub mod energyscape_reader;
pub mod error;
mod files;
pub mod node;
pub mod params;
pub mod picture;
pub mod plot;
pub mod plot_layouts;
mod polar;
mod ports;
mod probe;
pub mod raw_topics;
pub mod record;
pub mod recording_file;
pub mod relay;
mod root;
pub mod ros;
mod session;
pub mod source;
pub mod status_topics;
pub mod survey;
pub mod topics;
pub mod view_topics;
mod watch;
pub mod wire;

pub use canvas::encode_png;
pub use clients::{ControllerTopics, InputPublisher, OperatorClient, PlatformSubscriber};
pub use daemon_topics::{DaemonTopics, LastWord};
pub use detector_topics::DetectorTopics;
pub use echo::{Echo, EchoLimit};
pub use energyscape_reader::EnergyscapeReader;
pub use error::IpcError;
pub use files::{free_bytes_of, wipe};
pub use node::Ipc;
pub use params::IpcParams;
pub use raw_topics::{LiveTopics, RawPublisher, RawRefusal, RawShape};
pub use relay::Relay;
pub use status_topics::StatusTopics;
pub use view_topics::ViewTopics;

use std::hash::{BuildHasher, Hasher};

/// A number above zero that no other start of any process has: the standard library's hashers are keyed by the system's
/// randomness.
fn fresh_id() -> u64 {
    let mut hasher = std::collections::hash_map::RandomState::new().build_hasher();
    hasher.write_u32(std::process::id());
    hasher.finish().max(1)
}
