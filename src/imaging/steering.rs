//! Directions of interest and the delay of every direction at every microphone. Pure.
