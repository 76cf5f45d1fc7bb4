//! What can be judged of raw pings by their bytes, numbers and stamps: repeated samples, gaps, duplicates and steps
//! backwards in the sequence, and the spread of a set's emission times.
//!
//! What was emitted before a ping that was used is not used any more, whatever its number. A driver that starts again counts from
//! another number, and all it delivers would look old for ever: five such pings in a row, each the next and each emitted
//! after everything that was ever used, are a new beginning; so are five whose numbers go on after one with a stamp from the future.
//!
//! Raw pings in, findings out; the consequences are the daemon's ([`super::daemon`]). What needs signal processing (direct
//! path, channel delays, dead channels) is found elsewhere. Allocates nothing.

use super::GOOD_IN_A_ROW;
use crate::signal::{PingSet, RawPing, SENSORS_MAX, Samples};

/// How a ping's sequence number follows the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SequenceStep {
    /// The first ping of this sensor, or exactly the next.
    Next,
    /// This many are missing in between.
    Gap(u64),
    /// Seen before: not to be used again.
    Duplicate,
    /// Older than one already used: not to be used.
    Backward,
}

impl SequenceStep {
    /// Whether the ping may be used.
    #[must_use]
    pub fn usable(self) -> bool {
        matches!(self, SequenceStep::Next | SequenceStep::Gap(_))
    }
}

/// How `sequence` follows `previous`. Numbers wrap: half the number line lies ahead, half behind.
#[must_use]
pub fn sequence_step(previous: Option<u64>, sequence: u64) -> SequenceStep {
    let Some(previous) = previous else { return SequenceStep::Next };
    match sequence.wrapping_sub(previous).cast_signed() {
        0 => SequenceStep::Duplicate,
        1 => SequenceStep::Next,
        ahead if ahead > 1 => SequenceStep::Gap(ahead.cast_unsigned() - 1),
        _ => SequenceStep::Backward,
    }
}

/// Checksum of a ping's samples; equal samples have equal checksums.
#[must_use]
pub fn samples_checksum(samples: &Samples) -> u32 {
    match samples {
        Samples::Pdm(words) => crc32fast::hash(bytemuck::cast_slice(words)),
        Samples::PcmI16(values) => crc32fast::hash(bytemuck::cast_slice(values)),
        Samples::PcmF32(values) => crc32fast::hash(bytemuck::cast_slice(values)),
    }
}

/// Spread of the pings that are present about their turns, `slot_ns` apart; zero with fewer than two.
#[must_use]
pub fn desync_ns(pings: &PingSet, slot_ns: u64) -> u64 {
    let stamps = || pings.iter_present().map(|ping| ping.trigger_ns(slot_ns));
    match (stamps().min(), stamps().max()) {
        (Some(first), Some(last)) => last - first,
        _ => 0,
    }
}

/// Takes the pings out of a set whose trigger was a period or more before the newest one's. Returns whether
/// there were any; the set's own stamp is then the oldest of those left.
pub fn drop_other_triggers(pings: &mut PingSet, period_ns: u64, slot_ns: u64) -> bool {
    let newest_ns = pings.iter_present().map(|ping| ping.trigger_ns(slot_ns)).max().unwrap_or(0);
    let mut dropped = false;
    for (ping, present) in pings.pings.iter().zip(&mut pings.present) {
        let other = *present && newest_ns - ping.trigger_ns(slot_ns) >= period_ns;
        *present &= !other;
        dropped |= other;
    }
    if dropped {
        let oldest = pings.iter_present().map(|ping| ping.emitted_at).min_by_key(|stamp| stamp.boottime_ns);
        pings.emitted_at = oldest.unwrap_or(pings.emitted_at);
    }
    dropped
}

/// What [`Plausibility::observe`] found of one ping.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PingObservation {
    /// How its number follows the one before.
    pub step: SequenceStep,
    /// Gaps in a row, this ping included.
    pub gaps_in_a_row: u32,
    /// The samples are those of the ping before.
    pub frozen: bool,
}

/// What must be remembered of earlier pings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Plausibility {
    sensors: [Memory; SENSORS_MAX],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Memory {
    sequence: Option<u64>,
    checksum: Option<u32>,
    gaps_in_a_row: u32,
    /// Latest emission of a ping used.
    emitted_ns: u64,
    again: Option<Again>,
}

/// Pings that look old in a row, each the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Again {
    sequence: u64,
    emitted_ns: u64,
    run: u32,
}

impl Memory {
    /// How a ping follows what was used before, by number and by stamp.
    fn step(&mut self, ping: &RawPing) -> SequenceStep {
        let emitted_ns = ping.emitted_at.boottime_ns;
        let step = sequence_step(self.sequence, ping.sequence);
        let earlier = emitted_ns < self.emitted_ns;
        if step.usable() && !earlier {
            return step;
        }
        let follows =
            |before: &Again| ping.sequence == before.sequence.wrapping_add(1) && emitted_ns > before.emitted_ns;
        let run = self.again.filter(follows).map_or(1, |before| before.run + 1);
        // Old by number and by stamp is a late delivery.
        let may_begin = step.usable() || emitted_ns > self.emitted_ns;
        self.again = may_begin.then_some(Again { sequence: ping.sequence, emitted_ns, run });
        if may_begin && run >= GOOD_IN_A_ROW {
            self.emitted_ns = 0;
            return SequenceStep::Next;
        }
        if step.usable() { SequenceStep::Backward } else { step }
    }
}

impl Plausibility {
    /// Judges a ping and remembers it. A ping that must not be used (see [`SequenceStep::usable`]) is not remembered and
    /// says nothing of frozen samples: a second delivery of one ping is no frozen sensor.
    pub fn observe(&mut self, ping: &RawPing) -> PingObservation {
        let Some(memory) = self.sensors.get_mut(ping.sensor_index) else {
            return PingObservation { step: SequenceStep::Next, gaps_in_a_row: 0, frozen: false };
        };
        let step = memory.step(ping);
        if !step.usable() {
            return PingObservation { step, gaps_in_a_row: memory.gaps_in_a_row, frozen: false };
        }
        let checksum = samples_checksum(&ping.samples);
        let frozen = memory.checksum == Some(checksum);
        memory.gaps_in_a_row =
            if matches!(step, SequenceStep::Gap(_)) { memory.gaps_in_a_row.saturating_add(1) } else { 0 };
        memory.sequence = Some(ping.sequence);
        memory.checksum = Some(checksum);
        memory.emitted_ns = memory.emitted_ns.max(ping.emitted_at.boottime_ns);
        memory.again = None;
        PingObservation { step, gaps_in_a_row: memory.gaps_in_a_row, frozen }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::SampleFormat;
    use crate::time::Stamp;

    fn ping(sequence: u64, value: f32) -> RawPing {
        RawPing {
            sensor_index: 1,
            sequence,
            emitted_at: Stamp::default(),
            samples: std::sync::Arc::new(Samples::PcmF32(vec![0.0, value, 1.0])),
        }
    }

    #[test]
    fn numbers_are_judged_across_the_wrap() {
        assert_eq!(sequence_step(None, 7), SequenceStep::Next);
        assert_eq!(sequence_step(Some(7), 8), SequenceStep::Next);
        assert_eq!(sequence_step(Some(7), 10), SequenceStep::Gap(2));
        assert_eq!(sequence_step(Some(7), 7), SequenceStep::Duplicate);
        assert_eq!(sequence_step(Some(7), 6), SequenceStep::Backward);
        assert_eq!(sequence_step(Some(u64::MAX), 0), SequenceStep::Next);
        assert_eq!(sequence_step(Some(0), u64::MAX), SequenceStep::Backward);
    }

    #[test]
    fn the_second_copy_is_found_frozen_and_one_changed_bit_is_not() {
        let mut memory = Plausibility::default();
        assert!(!memory.observe(&ping(1, 0.5)).frozen);
        assert!(memory.observe(&ping(2, 0.5)).frozen);
        assert!(!memory.observe(&ping(3, f32::from_bits(0.5_f32.to_bits() + 1))).frozen);
    }

    #[test]
    fn a_repeated_delivery_is_not_used_and_not_called_frozen() {
        let mut memory = Plausibility::default();
        memory.observe(&ping(5, 0.5));
        let again = memory.observe(&ping(5, 0.5));
        assert_eq!((again.step, again.frozen), (SequenceStep::Duplicate, false));
        let older = memory.observe(&ping(4, 0.1));
        assert_eq!((older.step, older.step.usable()), (SequenceStep::Backward, false));
        assert_eq!(memory.observe(&ping(6, 0.7)).step, SequenceStep::Next);
    }

    #[test]
    fn a_driver_that_starts_again_is_believed_at_its_fifth_ping_and_late_deliveries_never_are() {
        let at = |sequence: u64, emitted_ns: u64| {
            let mut ping = ping(sequence, emitted_ns as f32);
            ping.emitted_at.boottime_ns = emitted_ns;
            ping
        };
        let mut memory = Plausibility::default();
        (90..100).for_each(|number| assert!(memory.observe(&at(number, number * 100)).step.usable()));
        let usable: Vec<bool> =
            (0..7).map(|number| memory.observe(&at(number, 10_000 + number * 100)).step.usable()).collect();
        assert_eq!(usable, [false, false, false, false, true, true, true]);
        // Old pings in their old order, and one that is repeated: none of them is a beginning.
        let mut memory = Plausibility::default();
        (90..100).for_each(|number| assert!(memory.observe(&at(number, number * 100)).step.usable()));
        (80..99).for_each(|number| assert!(!memory.observe(&at(number, number * 100)).step.usable()));
        (0..9).for_each(|time| assert!(!memory.observe(&at(7, 20_000 + time)).step.usable()));
    }

    #[test]
    fn gaps_in_a_row_are_counted_and_forgotten_at_the_next_good_number() {
        let mut memory = Plausibility::default();
        let counts: Vec<u32> = [1, 3, 5, 7, 8]
            .iter()
            .enumerate()
            .map(|(index, &sequence)| memory.observe(&ping(sequence, index as f32)).gaps_in_a_row)
            .collect();
        assert_eq!(counts, [0, 1, 2, 3, 0]);
    }

    #[test]
    fn desync_is_the_spread_of_those_present() {
        let mut pings = PingSet::empty(3, SampleFormat::PcmF32, &[1, 1, 1]);
        for (index, stamp_ns) in [1_000, 1_400, 900_000].into_iter().enumerate() {
            pings.pings[index].emitted_at.boottime_ns = stamp_ns;
        }
        assert_eq!(desync_ns(&pings, 0), 0);
        pings.present = [true, true, false];
        assert_eq!(desync_ns(&pings, 0), 400);
        pings.present = [true; 3];
        assert_eq!(desync_ns(&pings, 0), 899_000);
    }

    #[test]
    fn a_sensor_out_of_range_is_judged_harmless_not_a_panic() {
        let mut memory = Plausibility::default();
        let stray = RawPing { sensor_index: 99, ..ping(1, 0.0) };
        assert_eq!(memory.observe(&stray).step, SequenceStep::Next);
    }
}
