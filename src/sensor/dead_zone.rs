//! Bearings that other sensors' housings and configured obstructions hide from a sensor.
