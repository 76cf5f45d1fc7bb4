//! Health of the microphone channels of a raw ping, judged on the CPU by bits before any backend sees the data:
//! NaN, infinities, dead, stuck and clipped channels (specification, section 3, "Accuracy").

/// What was found of one sensor's channels, and the gain that each channel therefore gets.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelReport {
    /// Weight of each channel over the sum of the weights of all used channels; zero for a channel left out, all zeros
    /// when none is left. The matched filter multiplies with it, so an image is normalised whatever is left out.
    pub gains: Vec<f32>,
    /// Finding of each channel.
    pub findings: Vec<ChannelFinding>,
}

/// What is wrong with a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ChannelFinding {
    /// Nothing.
    #[default]
    Good,
    /// Switched off in the configuration.
    Disabled,
    /// Holds a NaN or an infinity.
    NotFinite,
    /// All samples equal: dead or stuck.
    Stuck,
    /// At full scale later than the end of the emission + 2 ms.
    Clipped,
}

impl ChannelReport {
    /// A report with equal gains and nothing found.
    #[must_use]
    pub fn new(channel_count: usize) -> Self {
        Self {
            gains: vec![1.0 / channel_count as f32; channel_count],
            findings: vec![ChannelFinding::Good; channel_count],
        }
    }
}
