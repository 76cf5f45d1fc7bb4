//! From whoever decides to the writer: prepared slots for ping sets, small notes beside them, in one order.
//!
//! Both queues are made at the start and bounded; neither side waits for the other, and sending allocates nothing. The writer
//! never sleeps on the queue, it looks: so the sender finds nobody to wake and takes no lock.

use super::RecordSubject;
use super::writer::Shared;
use crate::io::ros::PipelineStep;
use crate::io::wire::detections::{Objects, Obstacle, Scan};
use crate::io::wire::message::{EnergyscapeHeader, Odometry, OperatorRequest, VelocityCommand, VelocityInput};
use crate::io::wire::motion::EgoMotion;
use crate::io::wire::points::PointCloud3;
use crate::io::wire::telemetry::{Cues, Health, PlatformVelocity};
use crate::signal::{Energyscape, PingSet, SENSORS_MAX, Samples};
use crate::time::Stamp;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError};
use std::time::Duration;

/// Notes that may wait: ten seconds of everything small.
pub(super) const NOTES_MAX: usize = 2048;
/// Pause of a patient sender.
const PATIENCE: Duration = Duration::from_millis(1);

/// Something small.
#[derive(Debug, Clone)]
pub enum Note {
    /// What the pipeline was told.
    Step(PipelineStep),
    /// A command, as published.
    Command(VelocityCommand),
    /// The sums behind it.
    Cues(Cues),
    /// A wanted velocity, as it arrived.
    Input(VelocityInput),
    /// An operator's request, as it arrived.
    Operator(OperatorRequest),
    /// Pose and twist, as they arrived.
    Odometry(Odometry),
    /// What the controller commanded.
    Platform(PlatformVelocity),
    /// How the daemon is.
    Health(Health),
    /// A scan of the whole robot. Boxed, as what follows: too large to keep room for in every note, and from a thread that may allocate.
    Scan(Box<Scan>),
    /// What stands on the planned way.
    Obstacle(Box<Obstacle>),
    /// Objects and map.
    Objects(Box<Objects>),
    /// How the robot and what is around it move.
    EgoMotion(Box<EgoMotion>),
    /// Points in space.
    Points(Box<PointCloud3>),
}

/// A ping set with what was made of it; whatever is absent is not written.
#[derive(Debug)]
pub struct Slot {
    /// The raw pings, copied.
    pub pings: PingSet,
    /// The images, copied.
    pub images: Vec<Energyscape>,
    /// Their headers.
    pub headers: Vec<EnergyscapeHeader>,
    /// Which images there are.
    pub imaged: [bool; SENSORS_MAX],
    /// What the pipeline was told.
    pub step: Option<PipelineStep>,
}

impl Slot {
    pub(super) fn new(subject: &RecordSubject) -> Self {
        let images = (0..subject.sensors.len()).map(|index| Energyscape::zeros(Arc::clone(&subject.grid), index));
        let mut pings = subject.pings.clone();
        // A clone shares the samples; each slot has its own.
        pings.pings.iter_mut().for_each(|ping| ping.samples = Arc::new((*ping.samples).clone()));
        Self {
            pings,
            images: images.collect(),
            headers: vec![EnergyscapeHeader::blank(); subject.sensors.len()],
            imaged: [false; SENSORS_MAX],
            step: None,
        }
    }

    /// Empties it, without letting go of its memory.
    pub fn clear(&mut self) {
        self.pings.present = [false; SENSORS_MAX];
        self.imaged = [false; SENSORS_MAX];
        self.step = None;
    }

    /// Copies the pings that are `present`.
    pub fn copy_pings(&mut self, from: &PingSet, present: [bool; SENSORS_MAX]) {
        self.pings.sequence = from.sequence;
        self.pings.emitted_at = from.emitted_at;
        for (index, (into, ping)) in self.pings.pings.iter_mut().zip(&from.pings).enumerate() {
            into.sensor_index = ping.sensor_index;
            into.sequence = ping.sequence;
            into.emitted_at = ping.emitted_at;
            self.pings.present[index] = present[index] && copy_samples(&ping.samples, into.samples_mut());
        }
    }

    /// Copies an image.
    pub fn copy_image(&mut self, header: &EnergyscapeHeader, values: &[f32]) {
        let index = header.sensor_index as usize;
        let Some(image) = self.images.get_mut(index).filter(|image| image.values.len() == values.len()) else { return };
        image.values.copy_from_slice(values);
        image.sequence = header.sequence;
        image.emitted_at = Stamp { boottime_ns: header.t_monotonic_ns, wall_ns: header.t_wall_ns };
        self.headers[index] = *header;
        self.imaged[index] = true;
    }
}

fn copy_samples(from: &Samples, into: &mut Samples) -> bool {
    match (from, into) {
        (Samples::Pdm(from), Samples::Pdm(into)) if from.len() == into.len() => into.copy_from_slice(from),
        (Samples::PcmI16(from), Samples::PcmI16(into)) if from.len() == into.len() => into.copy_from_slice(from),
        (Samples::PcmF32(from), Samples::PcmF32(into)) if from.len() == into.len() => into.copy_from_slice(from),
        _ => return false,
    }
    true
}

/// What travels to the writer. A slot goes round, so nothing is made or freed on the way.
#[allow(clippy::large_enum_variant, reason = "a boxed note would be an allocation on the path of a command")]
pub(super) enum Item {
    /// Something small, and when it was noted.
    Note(Stamp, Note),
    /// A slot, and when it was filled.
    Set(Stamp, Box<Slot>),
}

/// A second way in, for notes of another thread.
#[derive(Clone)]
pub struct NoteTap {
    items: SyncSender<Item>,
    shared: Arc<Shared>,
}

impl NoteTap {
    /// Notes something small. Where the queue is full it is lost, and counted.
    pub fn note(&self, now: Stamp, note: Note) {
        if self.items.try_send(Item::Note(now, note)).is_err() {
            self.shared.dropped_notes.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The side of whoever decides.
pub struct Tap {
    pub(super) items: SyncSender<Item>,
    pub(super) free: Receiver<Box<Slot>>,
    pub(super) spare: Option<Box<Slot>>,
    pub(super) shared: Arc<Shared>,
    pub(super) raw: bool,
    pub(super) patient: bool,
    pub(super) step_count: u64,
}

impl Tap {
    /// Notes something small. Where the queue is full it is lost, and counted.
    pub fn note(&mut self, now: Stamp, note: Note) {
        let note = match note {
            Note::Step(step) => Note::Step(self.numbered(step)),
            other => other,
        };
        self.send(Item::Note(now, note));
    }

    /// Has `fill` copy a ping set into a slot. Where none is free only its step is noted, the set counts as dropped, and `fill` is
    /// not called.
    pub fn ping_set(&mut self, now: Stamp, step: Option<PipelineStep>, fill: impl FnOnce(&mut Slot, bool)) {
        let step = step.map(|step| self.numbered(step));
        match self.free_slot() {
            Some(mut slot) => {
                slot.clear();
                fill(&mut slot, self.raw);
                slot.step = step.map(|step| PipelineStep { has_pings: u32::from(self.raw), ..step });
                self.send(Item::Set(now, slot));
            }
            None => {
                self.shared.dropped_sets.fetch_add(1, Ordering::Relaxed);
                if let Some(step) = step {
                    self.send(Item::Note(now, Note::Step(PipelineStep { has_pings: 0, ..step })));
                }
            }
        }
    }

    /// How the recording is.
    #[must_use]
    pub fn tally(&self) -> super::Tally {
        self.shared.tally()
    }

    /// A second way in. The recording ends when the last of them and this one are dropped.
    #[must_use]
    pub fn notes(&self) -> NoteTap {
        NoteTap { items: self.items.clone(), shared: Arc::clone(&self.shared) }
    }

    fn numbered(&mut self, step: PipelineStep) -> PipelineStep {
        self.step_count += 1;
        PipelineStep { sequence: self.step_count, ..step }
    }

    fn free_slot(&mut self) -> Option<Box<Slot>> {
        loop {
            match self.spare.take().or_else(|| self.free.try_recv().ok()) {
                None if self.patient && !self.shared.is_over() => std::thread::sleep(PATIENCE),
                found => return found,
            }
        }
    }

    fn send(&mut self, item: Item) {
        let mut item = item;
        loop {
            match self.items.try_send(item) {
                Ok(()) => return,
                Err(TrySendError::Full(back)) if self.patient && !self.shared.is_over() => {
                    item = back;
                    std::thread::sleep(PATIENCE);
                }
                Err(TrySendError::Full(back) | TrySendError::Disconnected(back)) => {
                    match back {
                        Item::Set(_, slot) => {
                            self.shared.dropped_sets.fetch_add(1, Ordering::Relaxed);
                            self.spare = Some(slot);
                        }
                        Item::Note(..) => drop(self.shared.dropped_notes.fetch_add(1, Ordering::Relaxed)),
                    }
                    return;
                }
            }
        }
    }
}
