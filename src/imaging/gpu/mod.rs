//! GPU twin.
