//! Whether the GPU is trusted: a pure state machine `(quarantine, event, now) -> (quarantine, step)`.
//!
//! Three failed ping sets in a row or one loss quarantine the GPU. It is opened anew after 1, 2, 4 .. 60 s, and before it is trusted its
//! first image must equal the CPU's. Five losses without a good image between them, and the CPU images for good. Never touches a
//! device and reads no clock: `guard.rs` does what the steps say.
//!
//! | state | leaves it by | to |
//! |---|---|---|
//! | TRUSTED | 3 failures in a row, a loss, a wrong image | RESTING (5th loss: GIVEN UP) |
//! | RESTING | the rest is over | OPENING |
//! | OPENING | opened; no adapter; lost | ON PROBATION; RESTING; RESTING (5th loss: GIVEN UP) |
//! | ON PROBATION | image equals the CPU's; anything else | TRUSTED; RESTING (5th loss: GIVEN UP) |
//! | GIVEN UP | nothing | |

/// Ping sets in a row that a trusted GPU may fail.
pub const FAILURES_MAX: u32 = 3;
/// Losses without a good image between them after which no new try is made.
pub const LOSSES_MAX: u32 = 5;
/// First rest after a loss; every further one is twice as long.
pub const REST_FIRST_NS: u64 = 1_000_000_000;
/// Longest rest.
pub const REST_MAX_NS: u64 = 60_000_000_000;

/// How far the GPU is trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trust {
    /// Ping sets go to the GPU first.
    Trusted,
    /// It failed; nothing is tried before `until_ns`.
    Resting {
        /// CLOCK_BOOTTIME.
        until_ns: u64,
    },
    /// A new device is being opened.
    Opening,
    /// A new device is open; what it images is compared, not used.
    OnProbation,
    /// The CPU images for good.
    GivenUp,
}

/// What happens to the GPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GpuEvent {
    /// Time passed.
    Tick,
    /// It imaged a ping set; on probation: and the image equals the CPU's.
    Good,
    /// It failed a ping set, in time.
    Failed,
    /// The device is lost, or got lost while it was opened.
    Lost,
    /// Its image is not the CPU's.
    Wrong,
    /// The new device is open.
    Opened,
    /// There is no adapter to open.
    Absent,
}

/// What is to be done after an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Nothing.
    Stay,
    /// Let go of the device and rest.
    Rest,
    /// Open a new device, in the background.
    Open,
    /// Trust it again.
    Trust,
    /// Let go of the device; the CPU images for good.
    GiveUp,
}

/// The GPU's past, as far as it counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quarantine {
    trust: Trust,
    failures_in_a_row: u32,
    losses_in_a_row: u32,
    /// Length of the next rest.
    rest_ns: u64,
    trusted_since_ns: u64,
    /// Whether a device may be opened anew at all.
    renewable: bool,
}

impl Quarantine {
    /// A GPU that was just opened and is trusted. Unless it is `renewable`, its first loss is for good.
    #[must_use]
    pub fn new(renewable: bool, now_ns: u64) -> Self {
        Self {
            trust: Trust::Trusted,
            failures_in_a_row: 0,
            losses_in_a_row: 0,
            rest_ns: REST_FIRST_NS,
            trusted_since_ns: now_ns,
            renewable,
        }
    }

    /// How far the GPU is trusted.
    #[must_use]
    pub fn trust(&self) -> Trust {
        self.trust
    }

    /// Losses since the last good image of a trusted GPU.
    #[must_use]
    pub fn losses_in_a_row(&self) -> u32 {
        self.losses_in_a_row
    }

    /// The GPU's standing after `event`, and what is to be done.
    #[must_use]
    pub fn step(mut self, event: GpuEvent, now_ns: u64) -> (Self, Step) {
        let step = match (self.trust, event) {
            (Trust::Trusted, GpuEvent::Good) => {
                self.failures_in_a_row = 0;
                self.losses_in_a_row = 0;
                // Who has worked for longer than the last rest starts with a clean slate.
                if now_ns.saturating_sub(self.trusted_since_ns) > self.rest_ns {
                    self.rest_ns = REST_FIRST_NS;
                }
                Step::Stay
            }
            (Trust::Trusted, GpuEvent::Failed) => {
                self.failures_in_a_row += 1;
                if self.failures_in_a_row >= FAILURES_MAX { self.lose(now_ns) } else { Step::Stay }
            }
            (Trust::Trusted, GpuEvent::Lost | GpuEvent::Wrong)
            | (Trust::Opening, GpuEvent::Lost | GpuEvent::Failed)
            | (Trust::OnProbation, GpuEvent::Failed | GpuEvent::Lost | GpuEvent::Wrong) => self.lose(now_ns),
            (Trust::Resting { until_ns }, GpuEvent::Tick) if now_ns >= until_ns => {
                self.trust = Trust::Opening;
                Step::Open
            }
            (Trust::Opening, GpuEvent::Opened) => {
                self.trust = Trust::OnProbation;
                Step::Stay
            }
            // A driver that is being reset shows no adapter for a while: no loss, but ever longer rests.
            (Trust::Opening, GpuEvent::Absent) => self.rest(now_ns),
            (Trust::OnProbation, GpuEvent::Good) => {
                self.trust = Trust::Trusted;
                self.failures_in_a_row = 0;
                self.trusted_since_ns = now_ns;
                Step::Trust
            }
            _ => Step::Stay,
        };
        (self, step)
    }

    fn lose(&mut self, now_ns: u64) -> Step {
        self.losses_in_a_row += 1;
        if self.losses_in_a_row >= LOSSES_MAX || !self.renewable {
            self.trust = Trust::GivenUp;
            return Step::GiveUp;
        }
        self.rest(now_ns)
    }

    fn rest(&mut self, now_ns: u64) -> Step {
        self.failures_in_a_row = 0;
        self.trust = Trust::Resting { until_ns: now_ns.saturating_add(self.rest_ns) };
        self.rest_ns = (2 * self.rest_ns).min(REST_MAX_NS);
        Step::Rest
    }
}

#[cfg(test)]
mod tests {
    use super::GpuEvent::{Absent, Failed, Good, Lost, Opened, Tick, Wrong};
    use super::*;

    const SECOND: u64 = 1_000_000_000;
    const EVENTS: [GpuEvent; 7] = [Tick, Good, Failed, Lost, Wrong, Opened, Absent];

    fn after(events: &[(GpuEvent, u64)]) -> (Quarantine, Step) {
        let start = (Quarantine::new(true, 0), Step::Stay);
        events.iter().fold(start, |(quarantine, _), (event, at_ns)| quarantine.step(*event, *at_ns))
    }

    /// One of each state, at time 10 s; the resting one rests until 11 s.
    fn states() -> [(Quarantine, &'static str); 5] {
        let lost = [(Lost, 10 * SECOND)];
        let opening = [lost[0], (Tick, 11 * SECOND)];
        let probation = [opening[0], opening[1], (Opened, 11 * SECOND)];
        [
            (after(&[]).0, "trusted"),
            (after(&lost).0, "resting"),
            (after(&opening).0, "opening"),
            (after(&probation).0, "probation"),
            (Quarantine::new(false, 0).step(Lost, 10 * SECOND).0, "given up"),
        ]
    }

    #[test]
    fn every_pair_of_state_and_event_does_what_the_table_says() {
        use Step::{Open, Rest, Stay, Trust};
        // Columns as in EVENTS: tick (the rest is over), good, failed, lost, wrong, opened, absent.
        let table = [
            ("trusted", [Stay, Stay, Stay, Rest, Rest, Stay, Stay]),
            ("resting", [Open, Stay, Stay, Stay, Stay, Stay, Stay]),
            ("opening", [Stay, Stay, Rest, Rest, Stay, Stay, Rest]),
            ("probation", [Stay, Trust, Rest, Rest, Rest, Stay, Stay]),
            ("given up", [Stay; 7]),
        ];
        for ((quarantine, name), (row, steps)) in states().into_iter().zip(table) {
            assert_eq!(name, row);
            for (event, wanted) in EVENTS.into_iter().zip(steps) {
                let (next, step) = quarantine.step(event, 11 * SECOND);
                assert_eq!(step, wanted, "{name}, {event:?}");
                let moved = step != Stay || (name == "opening" && event == Opened);
                assert_eq!(next.trust() != quarantine.trust(), moved, "{name}, {event:?}");
            }
        }
    }

    #[test]
    fn the_third_failure_in_a_row_is_a_loss_and_a_good_image_between_starts_the_count_anew() {
        assert_eq!(after(&[(Failed, 1), (Failed, 2)]).1, Step::Stay);
        assert_eq!(after(&[(Failed, 1), (Failed, 2), (Failed, 3)]).1, Step::Rest);
        assert_eq!(after(&[(Failed, 1), (Failed, 2), (Good, 3), (Failed, 4), (Failed, 5)]).1, Step::Stay);
    }

    #[test]
    fn a_rest_lasts_to_the_nanosecond() {
        let (resting, _) = after(&[(Lost, 10)]);
        assert_eq!(resting.trust(), Trust::Resting { until_ns: SECOND + 10 });
        assert_eq!(resting.step(Tick, SECOND + 9).1, Step::Stay);
        assert_eq!(resting.step(Tick, SECOND + 10).1, Step::Open);
    }

    /// Rests, in seconds, of a GPU that each time is opened, meets `event` and, if it is trusted then, is lost.
    fn rests(events: &[GpuEvent], count: usize) -> Vec<u64> {
        let (mut quarantine, mut now_ns, mut rests) = (after(&[(Lost, 0)]).0, 0, Vec::new());
        while let (Trust::Resting { until_ns }, true) = (quarantine.trust(), rests.len() < count) {
            rests.push((until_ns - now_ns) / SECOND);
            now_ns = until_ns;
            quarantine = quarantine.step(Tick, now_ns).0;
            for event in events {
                quarantine = quarantine.step(*event, now_ns).0;
            }
        }
        rests
    }

    #[test]
    fn a_missing_adapter_is_looked_for_ever_more_rarely_and_for_ever() {
        assert_eq!(rests(&[Absent], 9), [1, 2, 4, 8, 16, 32, 60, 60, 60]);
    }

    #[test]
    fn five_losses_without_a_good_image_end_it_wherever_they_happen() {
        for events in
            [&[Lost][..], &[Failed], &[Opened, Lost], &[Opened, Wrong], &[Opened, Failed], &[Opened, Good, Lost]]
        {
            assert_eq!(rests(events, 99), [1, 2, 4, 8], "{events:?}");
        }
    }

    #[test]
    fn a_good_image_between_losses_keeps_it_alive_at_ever_longer_rests() {
        assert_eq!(rests(&[Opened, Good, Good, Lost], 8), [1, 2, 4, 8, 16, 32, 60, 60]);
    }

    #[test]
    fn the_image_on_probation_is_not_the_good_one_that_forgives_losses() {
        let (mut quarantine, _) = after(&[(Lost, 0), (Tick, SECOND), (Opened, SECOND), (Good, SECOND)]);
        assert_eq!((quarantine.trust(), quarantine.losses_in_a_row()), (Trust::Trusted, 1));
        quarantine = quarantine.step(Good, SECOND + 1).0;
        assert_eq!(quarantine.losses_in_a_row(), 0);
    }

    #[test]
    fn who_worked_for_longer_than_the_last_rest_rests_for_one_second_again() {
        let mut events = vec![(Lost, 0), (Tick, SECOND), (Opened, SECOND), (Good, SECOND), (Good, SECOND + 1)];
        events.extend([(Good, 4 * SECOND), (Lost, 4 * SECOND)]);
        assert_eq!(after(&events).0.trust(), Trust::Resting { until_ns: 5 * SECOND });
    }

    #[test]
    fn what_cannot_be_opened_anew_is_given_up_at_the_first_loss() {
        let quarantine = Quarantine::new(false, 0);
        assert_eq!(quarantine.step(Lost, 1).1, Step::GiveUp);
        let failed = quarantine.step(Failed, 1).0.step(Failed, 2).0.step(Failed, 3);
        assert_eq!((failed.0.trust(), failed.1), (Trust::GivenUp, Step::GiveUp));
    }
}
