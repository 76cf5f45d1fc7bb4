//! The buffers of the GPU backend by name, so that dispatches can be listed before there is a device.
//!
//! In: nothing. Out: [`Resource`]. How large each is and what it begins with is said by the blueprint (`schedule.rs`).

macro_rules! resources {
    ($($name:ident),+ $(,)?) => {
        /// The buffers. `Work*` carry complex rows from kernel to kernel in turns.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(super) enum Resource {
            $($name),+
        }

        impl Resource {
            /// All of them, in order.
            pub(super) const ALL: &[Resource] = &[$(Resource::$name),+];
        }
    };
}

resources!(
    Raw,
    BitStreams,
    BitSums,
    Corrections,
    Pcm,
    BandTaps,
    WorkA,
    WorkB,
    Spectra,
    Reference,
    Gains,
    Turns,
    Beams,
    Targets,
    Magnitudes,
    Smoothing,
    Signals,
    Along,
    Squares,
    Emitters,
    FocusRanges,
    Interpolator,
    Picks,
    Echoes,
    Arrivals,
    CleanTable,
    Pulse,
    Entries,
    Rows,
    Ranges,
    Image,
    Sums,
);
