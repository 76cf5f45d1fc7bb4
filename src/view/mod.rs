//! The live page: what daemon and controller tell, drawn in a browser, as Prometheus metrics, and for Foxglove and Lichtblick.
//!
//! | file | what |
//! |---|---|
//! | [`board`], `listener` | the newest of every topic, counts and history; the thread that listens |
//! | [`screen`] | an energyscape, made small enough for a screen |
//! | [`robot`], [`state`], [`detections`], [`why`] | what the page is told: the robot once, then every ping set, and why it moves so |
//! | [`access`] | token, session, Host and Origin: who may look |
//! | [`server`], `page` | connections within limits, files and sockets of the page |
//! | [`metrics`] | the page of numbers |
//! | `foxglove` | the protocol of Foxglove and Lichtblick |
//!
//! Goes in: the topics and the configuration that the daemon uses. Comes out: HTTP. Looks only: it publishes nothing, commands
//! nothing, and is a process of its own, so that nobody's browser is in the way of the robot. The only place that names axum,
//! hyper and tokio.

pub mod access;
pub mod board;
pub mod detections;
mod foxglove;
mod listener;
pub mod metrics;
mod page;
pub mod robot;
pub mod screen;
pub mod server;
pub mod state;
pub mod why;

pub use server::{ViewError, ViewOptions, ViewServer};
