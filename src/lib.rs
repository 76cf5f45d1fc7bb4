//! noctule: sonar processing for mobile robots.
pub mod config;
pub mod control;
pub mod document;
pub mod flow;
pub mod geometry;
pub mod imaging;
pub mod io;
pub mod parameter;
pub mod safety;
pub mod sensor;
pub mod service;
pub mod signal;
pub mod sim;
pub mod time;
