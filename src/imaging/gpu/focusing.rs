//! The dispatches of focusing and of CLEAN: `shaders/focus.wgsl`, `shaders/clean.wgsl`.
//!
//! In: the blueprint's plan and tables. Out: entries of the list of dispatches, and sizes of the buffers of CLEAN. Never touches a device.

use super::params::channel_stride;
use super::resource::Resource;
use super::schedule::{Blueprint, List};
use crate::imaging::backend::BackendError;
use crate::imaging::plan::FocusPlan;
use crate::imaging::plan::clean::CleanPlan;

impl Blueprint<'_> {
    /// Adds what focuses the near ranges, or all of them.
    pub(super) fn focus(&self, list: &mut List) -> Result<(), BackendError> {
        let Some(focus) = &self.plan.focus else { return Ok(()) };
        self.signals(list, focus)?;
        self.cells(list, focus)?;
        focus.clean.as_ref().map_or(Ok(()), |clean| self.clean(list, focus, clean))
    }

    /// Spectra of the channels to their signals.
    fn signals(&self, list: &mut List, focus: &FocusPlan) -> Result<(), BackendError> {
        use Resource::{Signals, Spectra, WorkA, WorkB};
        let sensors = self.banks[list.bank].sensors.len() as u32;
        let sub_bands = focus.combine.sub_bands as u32;
        let oversampling = [("OVERSAMPLING", focus.oversampling as f64), ("SUB_BANDS", f64::from(sub_bands))];
        let (mut from, mut to) = (Spectra, WorkA);
        for (index, pass) in self.to_signal.iter().enumerate() {
            let constants = [&pass.constants(focus.signal_len)[..], &oversampling].concat();
            let rows = sub_bands * sensors * channel_stride(self.plan) as u32;
            let threads = [focus.signal_len as u32 / pass.radix(), rows, 1];
            if index + 1 == self.to_signal.len() {
                list.push("signal_last", &constants, &[from, Signals], threads)?;
            } else {
                let name = if index == 0 { "signal_first" } else { "signal_pass" };
                list.push(name, &constants, &[from, to], threads)?;
                (from, to) = (to, if to == WorkA { WorkB } else { WorkA });
            }
        }
        Ok(())
    }

    /// Signals to focused cells.
    fn cells(&self, list: &mut List, focus: &FocusPlan) -> Result<(), BackendError> {
        use Resource::{Along, Emitters, FocusRanges, Gains, Image, Interpolator, Signals, Squares};
        let sensors = self.banks[list.bank].sensors.len() as u32;
        let oversampling = [("OVERSAMPLING", focus.oversampling as f64), ("SUB_BANDS", focus.combine.sub_bands as f64)];
        let bindings = [Signals, Along, Squares, Emitters, FocusRanges, Interpolator, Image, Gains];
        let threads = [focus.range_count as u32, self.plan.grid.direction_count() as u32, sensors];
        // Four ranges a thread need blocks that begin and end at fours; the last may end with the image.
        let fours = focus.blocks.iter().all(|block| block.first % 4 == 0);
        if focus.combine.is_sum() && fours {
            let threads = [threads[0].div_ceil(4), threads[1], threads[2]];
            return list.push("focus_sums", &oversampling, &bindings[..7], threads);
        }
        let combine = [("ORDER", focus.combine.order as f64), ("COHERENCE", f64::from(focus.combine.coherence as u8))];
        list.push("focus", &[&oversampling[..], &combine].concat(), &bindings, threads)
    }

    /// Rounds of taking echoes out and imaging what is left, and what puts them back.
    fn clean(&self, list: &mut List, focus: &FocusPlan, clean: &CleanPlan) -> Result<(), BackendError> {
        use Resource::{Arrivals, CleanTable, Echoes, Emitters, Gains, Image, Interpolator, Picks, Pulse, Signals};
        let sensors = self.banks[list.bank].sensors.len() as u32;
        let grid = &self.plan.grid;
        let constants = |round: usize| {
            [
                ("OVERSAMPLING", focus.oversampling as f64),
                ("ROUND", round as f64),
                ("ROUNDS", clean.rounds as f64),
                ("WINDOWS", clean.window_count as f64),
                ("WINDOW_LEN", clean.window_len as f64),
                ("PULSE_REACH", clean.pulse_reach as f64),
                ("RADIUS_M", f64::from(clean.radius_m)),
                ("RANGE_FIRST_M", f64::from(clean.range_first_m)),
                ("RANGE_STEP_M", f64::from(clean.range_step_m)),
            ]
        };
        // A workgroup of 64 each.
        let windows = [64 * clean.window_count as u32, sensors, 1];
        let samples = [(focus.oversampling * focus.row_len) as u32, channel_stride(self.plan) as u32, sensors];
        let fitted = [Signals, Interpolator, Gains, Picks, Echoes, Arrivals, CleanTable, Pulse];
        for round in 0..clean.rounds {
            list.push("clean_pick", &constants(0), &[Image, Picks], windows)?;
            list.push("clean_fit", &constants(round), &fitted, windows)?;
            list.push("clean_take_out", &constants(round), &[Signals, Gains, Echoes, Arrivals, Pulse], samples)?;
            self.cells(list, focus)?;
        }
        let cells = [grid.range_count() as u32, grid.direction_count() as u32, sensors];
        list.push("clean_put_back", &constants(0), &[Emitters, Image, Echoes, CleanTable], cells)
    }

    /// Bytes of the buffers that hold picks, echoes and arrivals: four values each.
    pub(super) fn clean_bytes(&self, resource: Resource) -> usize {
        let Some(clean) = self.plan.focus.as_ref().and_then(|focus| focus.clean.as_ref()) else { return 4 };
        let entries = match resource {
            Resource::Echoes => 3 * clean.rounds * self.bank_sensors(),
            Resource::Arrivals => self.channel_rows(),
            _ => self.bank_sensors(),
        };
        16 * entries * clean.window_count
    }
}
