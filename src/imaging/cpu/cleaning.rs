//! What a thread does in the phases of CLEAN, and their buffers.
//!
//! In and out: the buffers of [`Work`]. Loudest cells are looked for row by row, echoes fitted window by window, taken out of the
//! signals block by block of channels and put back row by row, each by whoever comes. The arithmetic is in [`super::clean`].

use super::clean::{Arrival, Cell, Channels, Echo, Fit, put_back, take_out};
use super::shares::Phase;
use super::work::{BLOCKS_MAX, Job, Work, reading, writing};
use crate::imaging::plan::clean::CleanPlan;
use crate::imaging::plan::{FocusPlan, ImagingPlan};
use nalgebra::Complex;
use std::sync::RwLock;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

/// Buffers of CLEAN; empty where it is off.
pub(super) struct Cleaning {
    /// Which round it is.
    round: AtomicUsize,
    /// `[sensor][window]`: the loudest cell, see [`rank`].
    picks: Vec<AtomicU64>,
    /// `[sensor][window]`.
    windows: Vec<RwLock<Window>>,
}

/// The echoes of a window.
struct Window {
    /// `[round]`.
    echoes: Vec<Echo>,
    /// `[channel]`, of this round.
    arrivals: Vec<Arrival>,
    /// `[channel]`: scratch of the fit.
    values: Vec<Complex<f32>>,
}

/// No cell.
const NONE: u64 = 0;

/// Ranks cells by what they read, of equals the first, as a number: no sign is set, so bits compare as values do.
fn rank(value: f32, cell: usize) -> u64 {
    u64::from(value.to_bits()) << 32 | u64::from(!(cell as u32))
}

impl Cleaning {
    pub(super) fn new(plan: &ImagingPlan) -> Self {
        let clean = plan.focus.as_ref().and_then(|focus| focus.clean.as_ref());
        let (rounds, window_count) = clean.map_or((0, 0), |clean| (clean.rounds, clean.window_count));
        let channels = plan.sensors.iter().flat_map(|sensor| std::iter::repeat_n(sensor.channel_count, window_count));
        let window = |channels| {
            let (arrivals, values) = (vec![Arrival::default(); channels], vec![Complex::default(); channels]);
            RwLock::new(Window { echoes: vec![Echo::default(); rounds], arrivals, values })
        };
        let windows: Vec<_> = channels.map(window).collect();
        Self { round: AtomicUsize::new(0), picks: windows.iter().map(|_| AtomicU64::new(NONE)).collect(), windows }
    }

    /// Begins a round.
    pub(super) fn begin(&self, round: usize) {
        self.round.store(round, Ordering::Release);
        self.picks.iter().for_each(|pick| pick.store(NONE, Ordering::Release));
    }
}

impl Work {
    /// A thread's share of a phase of CLEAN.
    pub(super) fn clean_share(&self, job: &Job, phase: Phase) {
        let Some(focus) = &self.plan.focus else { return };
        let Some(clean) = &focus.clean else { return };
        let (sensors, directions) = (self.plan.sensors.len(), self.plan.grid.direction_count());
        let each = |count: usize, task: &dyn Fn(usize, usize)| {
            self.take_tasks(sensors * count, |index| {
                if job.active[index / count] {
                    task(index / count, index % count);
                }
            });
        };
        match phase {
            Phase::Pick => each(directions, &|sensor, direction| self.pick(clean, sensor, direction)),
            Phase::Fit => each(clean.window_count, &|sensor, window| self.fit(job, focus, clean, sensor, window)),
            Phase::TakeOut => self.take_tasks(self.signals.len(), |index| self.take_out(job, focus, clean, index)),
            _ => each(directions, &|sensor, direction| self.put_back(focus, clean, sensor, direction)),
        }
    }

    /// Enters the loudest cell of every window of a row.
    fn pick(&self, clean: &CleanPlan, sensor: usize, direction: usize) {
        let Some(row) = self.drafts[sensor].row(direction) else {
            self.conflict.store(true, Ordering::Release);
            return;
        };
        let picks = &self.cleaning.picks[sensor * clean.window_count..][..clean.window_count];
        for (window, pick) in picks.iter().enumerate() {
            let ranges = clean.window(window, row.len());
            let cells = row[ranges.clone()].iter().zip(ranges);
            let (value, range) =
                cells.fold((0.0, 0), |best, (value, range)| if *value > best.0 { (*value, range) } else { best });
            if value > 0.0 {
                pick.fetch_max(rank(value, self.plan.grid.cell(direction, range)), Ordering::AcqRel);
            }
        }
    }

    /// The cell of a window whose echo is to be taken out: louder than what the neighbouring windows have, and no flank of something
    /// beyond the image.
    fn candidate(&self, clean: &CleanPlan, sensor: usize, window: usize) -> Option<Cell> {
        let loudest = |window: usize| self.cleaning.picks[sensor * clean.window_count + window].load(Ordering::Acquire);
        let value = |rank: u64| f32::from_bits((rank >> 32) as u32);
        let found = loudest(window);
        let (direction, range) = self.plan.grid.direction_and_range(!(found as u32) as usize);
        let inside = range > 0 && range + 1 < self.plan.grid.range_count();
        let above = window == 0 || value(found) > value(loudest(window - 1));
        let below = window + 1 == clean.window_count || value(found) >= value(loudest(window + 1));
        (found != NONE && value(found).is_finite() && inside && above && below).then(|| Cell {
            value: value(found),
            direction,
            range,
        })
    }

    fn fit(&self, job: &Job, focus: &FocusPlan, clean: &CleanPlan, sensor: usize, window: usize) {
        let round = self.cleaning.round.load(Ordering::Acquire);
        let index = sensor * clean.window_count + window;
        let mut kept = writing(&self.cleaning.windows[index]);
        let Window { echoes, arrivals, values } = &mut *kept;
        echoes[round] = Echo::default();
        let Some(cell) = self.candidate(clean, sensor, window) else { return };
        let channel_count = self.plan.sensors[sensor].channel_count;
        let mut guards = [const { None }; BLOCKS_MAX];
        let mut blocks: [&[f32]; BLOCKS_MAX] = [&[]; BLOCKS_MAX];
        let block_count = channel_count.div_ceil(self.lanes);
        for (block, guard) in guards[..block_count].iter_mut().enumerate() {
            *guard = self.signals_of(sensor, block).map(|index| reading(&self.signals[index]));
        }
        for (block, guard) in blocks.iter_mut().zip(&guards) {
            *block = guard.as_ref().map_or(&[], |guard| &guard[..]);
        }
        let gains = &job.gains[sensor][..channel_count];
        let channels = Channels { focus, blocks: &blocks[..block_count], lanes: self.lanes, gains };
        echoes[round] = Fit { clean, sensor, channels }.fit(cell, arrivals, values);
    }

    fn take_out(&self, job: &Job, focus: &FocusPlan, clean: &CleanPlan, index: usize) {
        let piece = &self.transformed[index];
        if !job.active[piece.sensor] {
            return;
        }
        let round = self.cleaning.round.load(Ordering::Acquire);
        let first_channel = piece.block * self.lanes;
        let channel_count = self.plan.sensors[piece.sensor].channel_count;
        let pulse = &clean.sensors[piece.sensor].pulse;
        let mut signals = writing(&self.signals[index]);
        let row_len = 2 * focus.oversampling * focus.row_len;
        let windows = &self.cleaning.windows[piece.sensor * clean.window_count..][..clean.window_count];
        for window in windows {
            let window = reading(window);
            let echo = &window.echoes[round];
            if echo.cell.value > 0.0 {
                for (channel, signals) in (first_channel..channel_count).zip(signals.chunks_exact_mut(row_len)) {
                    let (arrival, gain) = (&window.arrivals[channel], job.gains[piece.sensor][channel]);
                    take_out(focus, clean, pulse, echo, arrival, gain, signals);
                }
            }
        }
    }

    fn put_back(&self, focus: &FocusPlan, clean: &CleanPlan, sensor: usize, direction: usize) {
        if self.plan.sensors[sensor].hidden[direction] {
            return;
        }
        let Some(mut row) = self.drafts[sensor].row(direction) else {
            self.conflict.store(true, Ordering::Release);
            return;
        };
        for window in &self.cleaning.windows[sensor * clean.window_count..][..clean.window_count] {
            for echo in reading(window).echoes.iter().filter(|echo| echo.cell.value > 0.0) {
                put_back(focus, clean, sensor, echo, direction, &mut row);
            }
        }
    }
}
