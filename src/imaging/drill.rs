//! A GPU that fails when it is told to: another backend's images under a GPU's name, with faults at chosen ping sets.
//!
//! In: a backend that works, and a function that names the fault of every ping set. Out: what a device with that fault would give.
//! For tests and for `noctule soak`, which have to see a GPU fail where there is none; no configuration leads here.

use super::backend::{Backend, BackendError, BackendKind, BackendReport, Image, Stage, StageOutput, StageTimes};
use crate::signal::PingSet;
use std::time::Duration;

/// What a device does instead of imaging.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DeviceFault {
    /// Is lost.
    Lost,
    /// Is given up after so long, the result never comes.
    Late(Duration),
    /// Has no memory left.
    OutOfMemory,
    /// Refuses a command.
    Refused,
    /// Does nothing and says that it is done.
    Skipped,
    /// Gives the image of the ping set before, under this one's number.
    Stale,
    /// Gives zeros.
    Zeros,
    /// Gives one value that is not a number.
    NotANumber,
    /// Gives an image whose energies and sums are all this much too large: 0.01 is one in a hundred.
    TooLarge(f32),
}

/// Names the fault of a ping set, the first being 0.
pub type FaultPlan = Box<dyn FnMut(u64) -> Option<DeviceFault> + Send>;

/// A backend with faults.
pub struct Drill {
    inner: Box<dyn Backend>,
    plan: FaultPlan,
    count: u64,
    /// Image of the set before.
    before: Option<Image>,
    close_takes: Duration,
    report: BackendReport,
}

impl Drill {
    /// A device that images as `inner` does wherever `plan` names no fault.
    #[must_use]
    pub fn new(inner: Box<dyn Backend>, plan: FaultPlan) -> Self {
        let report = BackendReport {
            kind: BackendKind::Gpu,
            adapter: format!("drill on {}", inner.report().adapter),
            reason: "a GPU that fails when it is told to".to_owned(),
            threads: inner.report().threads,
        };
        Self { inner, plan, count: 0, before: None, close_takes: Duration::ZERO, report }
    }

    /// The same device, let go of no sooner than after `close_takes`.
    #[must_use]
    pub fn closing_in(mut self, close_takes: Duration) -> Self {
        self.close_takes = close_takes;
        self
    }
}

impl Backend for Drill {
    fn image(&mut self, pings: &PingSet, image: &mut Image) -> Result<(), BackendError> {
        let fault = (self.plan)(self.count);
        self.count += 1;
        match fault {
            Some(DeviceFault::Lost) => return Err(BackendError::Lost("a drill".to_owned())),
            Some(DeviceFault::Late(limit)) => {
                std::thread::sleep(limit);
                return Err(BackendError::Timeout { limit_ms: limit.as_millis() as u64 });
            }
            Some(DeviceFault::OutOfMemory) => return Err(BackendError::Invalid("out of memory".to_owned())),
            Some(DeviceFault::Refused) => return Err(BackendError::Invalid("validation error".to_owned())),
            Some(DeviceFault::Skipped) => return Ok(()),
            _ => self.inner.image(pings, image)?,
        }
        match fault {
            Some(DeviceFault::Stale) => {
                let fresh = image.clone();
                match &self.before {
                    Some(before) => copy(before, image),
                    // Without a set before there is only the state of a fresh buffer.
                    None => scale(image, 0.0),
                }
                self.before = Some(fresh);
            }
            Some(DeviceFault::Zeros) => scale(image, 0.0),
            Some(DeviceFault::NotANumber) => {
                if let Some(value) = image.energyscapes.first_mut().and_then(|scape| scape.values.last_mut()) {
                    *value = f32::NAN;
                }
            }
            Some(DeviceFault::TooLarge(part)) => scale(image, 1.0 + part),
            _ => match &mut self.before {
                Some(before) => copy(image, before),
                None => self.before = Some(image.clone()),
            },
        }
        image.stamp(pings, BackendKind::Gpu);
        Ok(())
    }

    fn image_up_to(
        &mut self,
        stage: Stage,
        pings: &PingSet,
        sensor_index: usize,
        image: &mut Image,
    ) -> Result<StageOutput, BackendError> {
        self.inner.image_up_to(stage, pings, sensor_index, image)
    }

    fn stage_times_ns(&self) -> StageTimes {
        self.inner.stage_times_ns()
    }

    fn report(&self) -> &BackendReport {
        &self.report
    }
}

impl Drop for Drill {
    fn drop(&mut self) {
        std::thread::sleep(self.close_takes);
    }
}

fn copy(from: &Image, to: &mut Image) {
    for (to, from) in to.energyscapes.iter_mut().zip(&from.energyscapes) {
        to.values.copy_from_slice(&from.values);
    }
    to.sums.copy_from_slice(&from.sums);
}

fn scale(image: &mut Image, factor: f32) {
    image.energyscapes.iter_mut().flat_map(|scape| &mut scape.values).for_each(|value| *value *= factor);
    for sums in &mut image.sums {
        for value in [&mut sums.energy, &mut sums.turn, &mut sums.flow, &mut sums.peak] {
            *value *= factor;
        }
    }
}
