//! The table of kernels: shader, entry point, bindings and workgroup of every dispatch there can be.
//!
//! In: nothing. Out: what `program.rs` makes pipelines from, and what tests/shader_layout.rs compares with the shaders
//! themselves. Shaders are joined with their shared parts by plain concatenation. Never talks to a device.

use crate::imaging::backend::Stage;

/// How a kernel uses a binding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Read only.
    Read,
    /// Read and written.
    Write,
}

/// One entry point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kernel {
    /// The stage that it is a part of.
    pub stage: Stage,
    /// Name in the stage's shader.
    pub entry_point: &'static str,
    /// Threads of a workgroup.
    pub workgroup: [u32; 3],
    /// Storage bindings that it uses. Binding 0, the uniform block, is everybody's.
    pub bindings: &'static [(u32, Access)],
}

/// WGSL of a stage, shared parts first.
#[must_use]
pub fn source(stage: Stage) -> &'static str {
    macro_rules! joined {
        ($($file:literal),+) => { concat!($(include_str!(concat!("../../../shaders/", $file))),+) };
    }
    match stage {
        Stage::Demodulate => joined!("common/params.wgsl", "demodulate.wgsl"),
        Stage::MatchedFilter => {
            joined!("common/params.wgsl", "common/complex.wgsl", "common/fft.wgsl", "matched_filter.wgsl")
        }
        Stage::DelayAndSum => joined!("common/params.wgsl", "common/complex.wgsl", "delay_and_sum.wgsl"),
        Stage::Envelope => joined!("common/params.wgsl", "common/complex.wgsl", "common/fft.wgsl", "envelope.wgsl"),
        Stage::Focus => {
            joined!("common/params.wgsl", "common/complex.wgsl", "common/fft.wgsl", "focus.wgsl", "clean.wgsl")
        }
        Stage::MaskedEnergy => joined!("common/params.wgsl", "masked_energy.wgsl"),
    }
}

const ALONG: [u32; 3] = [64, 1, 1];
const BUTTERFLIES: [u32; 3] = [16, 8, 1];

const FOCUS_BINDINGS: &[(u32, Access)] = {
    use Access::{Read, Write};
    &[(1, Read), (4, Read), (5, Read), (6, Read), (7, Read), (8, Read), (9, Write), (10, Read)]
};

const CLEAN_FIT_BINDINGS: &[(u32, Access)] = {
    use Access::{Read, Write};
    &[(1, Read), (8, Read), (10, Read), (11, Write), (12, Write), (13, Write), (14, Read), (15, Read)]
};

/// All kernels, in the order of the stages.
pub const KERNELS: &[Kernel] = {
    use Access::{Read, Write};
    use Stage::{DelayAndSum, Demodulate, Envelope, Focus, MaskedEnergy, MatchedFilter};
    &[
        kernel(Demodulate, "transpose_words", ALONG, &[(1, Read), (2, Write)]),
        kernel(Demodulate, "demodulate_pdm", ALONG, &[(2, Write), (3, Read), (4, Read), (5, Write)]),
        kernel(Demodulate, "demodulate_i16", ALONG, &[(1, Read), (5, Write)]),
        kernel(Demodulate, "demodulate_f32", ALONG, &[(1, Read), (5, Write)]),
        kernel(MatchedFilter, "band_filter", ALONG, &[(1, Read), (2, Read), (4, Write)]),
        kernel(MatchedFilter, "forward_pass", BUTTERFLIES, &[(3, Read), (4, Write)]),
        kernel(MatchedFilter, "forward_last", BUTTERFLIES, &[(3, Read), (4, Write), (5, Read), (6, Read)]),
        kernel(DelayAndSum, "delay_and_sum", ALONG, &[(1, Read), (2, Read), (3, Read), (4, Write)]),
        kernel(Envelope, "inverse_first", BUTTERFLIES, &[(1, Read), (2, Write), (3, Read)]),
        kernel(Envelope, "inverse_pass", BUTTERFLIES, &[(1, Read), (2, Write), (3, Read)]),
        kernel(Envelope, "inverse_last", BUTTERFLIES, &[(1, Read), (3, Read), (4, Write)]),
        kernel(Envelope, "inverse_last_whole", BUTTERFLIES, &[(1, Read), (3, Read), (5, Write)]),
        kernel(Envelope, "smooth_rows", ALONG, &[(3, Read), (4, Write), (5, Write), (6, Read)]),
        kernel(Focus, "signal_first", BUTTERFLIES, &[(1, Read), (2, Write)]),
        kernel(Focus, "signal_pass", BUTTERFLIES, &[(1, Read), (2, Write)]),
        kernel(Focus, "signal_last", BUTTERFLIES, &[(1, Read), (3, Write)]),
        kernel(Focus, "focus", ALONG, FOCUS_BINDINGS),
        kernel(Focus, "focus_sums", ALONG, FOCUS_BINDINGS.split_at(7).0),
        kernel(Focus, "clean_pick", ALONG, &[(9, Write), (11, Write)]),
        kernel(Focus, "clean_fit", ALONG, CLEAN_FIT_BINDINGS),
        kernel(Focus, "clean_take_out", ALONG, &[(3, Write), (10, Read), (12, Write), (13, Write), (15, Read)]),
        kernel(Focus, "clean_put_back", ALONG, &[(6, Read), (9, Write), (12, Write), (14, Read)]),
        kernel(MaskedEnergy, "masked_energy", [128, 1, 1], &[(1, Read), (2, Read), (3, Read), (4, Read), (5, Write)]),
    ]
};

const fn kernel(
    stage: Stage,
    entry_point: &'static str,
    workgroup: [u32; 3],
    bindings: &'static [(u32, Access)],
) -> Kernel {
    Kernel { stage, entry_point, workgroup, bindings }
}

/// The kernel of that name.
#[must_use]
pub fn find(entry_point: &str) -> Option<&'static Kernel> {
    KERNELS.iter().find(|kernel| kernel.entry_point == entry_point)
}
