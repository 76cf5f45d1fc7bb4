//! What a thread does in the phases of CLEAN, and their buffers.
//!
//! In and out: the buffers of [`Work`]. Loudest cells are looked for row by row, echoes fitted window by window, taken out of the
//! signals block by block of channels and put back row by row, each by whoever comes. The arithmetic is in [`super::clean`].

use super::clean::{Arrival, Channels, Echo, Fit, Loudest, loudest_of_row, put_back, take_out};
use super::shares::Phase;
use super::work::{BLOCKS_MAX, Job, Work, locked, reading, writing};
use crate::imaging::plan::clean::CleanPlan;
use crate::imaging::plan::{FocusPlan, ImagingPlan};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, RwLock};

/// Buffers of CLEAN; empty where it is off.
pub(super) struct Cleaning {
    /// Which round it is.
    pub round: AtomicUsize,
    /// `[sensor][direction]` of `[window]`.
    picks: Vec<RwLock<Vec<Loudest>>>,
    /// `[sensor][window]`.
    windows: Vec<RwLock<Window>>,
    /// `[sensor][window]`: a value a channel.
    values: Vec<Mutex<Vec<[f32; 2]>>>,
}

/// The echoes of a window.
struct Window {
    /// `[round]`.
    echoes: Vec<Echo>,
    /// `[channel]`, of this round.
    arrivals: Vec<Arrival>,
}

impl Cleaning {
    pub(super) fn new(plan: &ImagingPlan) -> Self {
        let clean = plan.focus.as_ref().and_then(|focus| focus.clean.as_ref());
        let (rounds, window_count) = clean.map_or((0, 0), |clean| (clean.rounds, clean.window_count));
        let rows = if clean.is_some() { plan.sensors.len() * plan.grid.direction_count() } else { 0 };
        let channels =
            || plan.sensors.iter().flat_map(|sensor| std::iter::repeat_n(sensor.channel_count, window_count));
        let window = |channels| {
            let arrivals = vec![Arrival::default(); channels];
            RwLock::new(Window { echoes: vec![Echo::default(); rounds], arrivals })
        };
        Self {
            round: AtomicUsize::new(0),
            picks: (0..rows).map(|_| RwLock::new(vec![Loudest::default(); window_count])).collect(),
            windows: channels().map(window).collect(),
            values: channels().map(|channels| Mutex::new(vec![[0.0; 2]; channels])).collect(),
        }
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

    fn pick(&self, clean: &CleanPlan, sensor: usize, direction: usize) {
        let picks = &self.cleaning.picks[sensor * self.plan.grid.direction_count() + direction];
        match self.drafts[sensor].row(direction) {
            Some(row) => loudest_of_row(clean, direction, &row, &mut writing(picks)),
            None => self.conflict.store(true, Ordering::Release),
        }
    }

    /// The loudest cell of a window.
    fn loudest(&self, sensor: usize, window: usize) -> Loudest {
        let directions = self.plan.grid.direction_count();
        let picks = self.cleaning.picks[sensor * directions..][..directions].iter();
        picks.fold(Loudest::default(), |best, picks| best.or(reading(picks)[window]))
    }

    /// The cell of a window whose echo is to be taken out: louder than what the neighbouring windows have, and no flank of something
    /// beyond the image.
    fn candidate(&self, clean: &CleanPlan, sensor: usize, window: usize) -> Option<Loudest> {
        let found = self.loudest(sensor, window);
        let inside = found.range > 0 && found.range + 1 < self.plan.grid.range_count();
        let above = window == 0 || found.value > self.loudest(sensor, window - 1).value;
        let below = window + 1 == clean.window_count || found.value >= self.loudest(sensor, window + 1).value;
        (found.value > 0.0 && found.value.is_finite() && inside && above && below).then_some(found)
    }

    fn fit(&self, job: &Job, focus: &FocusPlan, clean: &CleanPlan, sensor: usize, window: usize) {
        let round = self.cleaning.round.load(Ordering::Acquire);
        let index = sensor * clean.window_count + window;
        let mut kept = writing(&self.cleaning.windows[index]);
        let Window { echoes, arrivals } = &mut *kept;
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
        echoes[round] = Fit { clean, sensor, channels }.fit(cell, arrivals, &mut locked(&self.cleaning.values[index]));
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
