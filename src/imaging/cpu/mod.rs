//! CPU twin.
