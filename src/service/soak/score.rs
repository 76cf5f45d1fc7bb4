//! How a soak is scored: time to stop, hold, resume, false stops, and what must never be.
//!
//! Goes in: what the controller commanded, tick by tick, and when each trouble began and ended. Comes out: a [`Summary`] with a finding
//! for every bar that was missed. Knows nothing of how anything was decided.

use super::footprint::Footprint;
use super::troubles::{Case, Demand};
use crate::safety::daemon::DEGRADED_SPEED_M_S;
use crate::signal::{DaemonState, GateState, Velocity};
use serde::Serialize;
use std::collections::BTreeMap;

/// Longest time from the last good capture to zero: Z2 of the safe-state contract.
pub const STOP_MAX_S: f64 = 0.35;
/// Least share of the time in which the robot stands while it must.
pub const HOLD_MIN: f64 = 0.99;
/// Longest time from the first good capture to TRACK, for what clears by itself.
pub const RESUME_MAX_S: f64 = 0.6;
/// Largest share of the time without any trouble in which the robot is stopped nevertheless.
pub const FALSE_STOP_MAX: f64 = 0.01;
/// Largest growth of the memory in use.
pub const GROWTH_MAX_KIB: u64 = 4096;
/// Longest time from the end of a trouble until the robot drives again, operator included.
pub const RETURN_MAX_S: f64 = 10.0;
/// A robot that drove at full speed needs this much longer to be slow than to be told so.
const SLOWING_NS: u64 = 300_000_000;

/// One tick of the controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// When.
    pub now_ns: u64,
    /// What the platform was told.
    pub velocity: Velocity,
    /// State of the controller.
    pub gate: GateState,
    /// State of the daemon.
    pub daemon: DaemonState,
    /// Whether the robot touches anything.
    pub contact: bool,
}

/// A trouble under way or being recovered from.
#[derive(Debug, Clone)]
struct Episode {
    case: Case,
    last_good_ns: u64,
    /// First good capture after it.
    cleared_ns: Option<u64>,
    /// When an operator allowed motion again.
    armed_ns: Option<u64>,
    moved_until_ns: u64,
    faulted: bool,
    found: bool,
}

/// Of all troubles of a name.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct OfOne {
    /// How often.
    pub count: u64,
    /// Longest time from the last good capture to the last motion.
    pub stop_s: f64,
    /// Longest time from the first good capture to TRACK, or from an operator's arming.
    pub resume_s: f64,
}

/// How a soak went.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Simulated time.
    pub minutes: f64,
    /// Seed.
    pub seed: u64,
    /// Ping sets.
    pub ping_sets: u64,
    /// Troubles.
    pub troubles: u64,
    /// By name.
    pub of_one: BTreeMap<String, OfOne>,
    /// Longest time to stop, of those that must be found at once.
    pub stop_s: f64,
    /// Longest time to stop, of those that may take 5 s to find.
    pub stop_slowly_found_s: f64,
    /// Share of the time in which the robot stood while it had to.
    pub hold: f64,
    /// Longest time to resume, of those that clear by themselves.
    pub resume_s: f64,
    /// Share of the trouble-free time in which the robot was stopped.
    pub false_stop: f64,
    /// Ticks in which it moved although it had to stand.
    pub unsafe_ticks: u64,
    /// Ticks in which it was too fast, or went backwards, while something was lost.
    pub too_fast_ticks: u64,
    /// Contacts of a robot that was told to move.
    pub contacts: u64,
    /// Contacts of a robot that stood: somebody walked into it.
    pub touched: u64,
    /// Way driven.
    pub distance_m: f64,
    /// After a tenth of the time.
    pub footprint_early: Option<Footprint>,
    /// At the end.
    pub footprint_late: Option<Footprint>,
    /// Of everything that was commanded and driven: equal runs have equal ones.
    pub digest: String,
    /// What was not as it has to be; empty when all was.
    pub findings: Vec<String>,
}

/// Counts.
#[derive(Debug, Default)]
pub struct Scorer {
    episode: Option<Episode>,
    of_one: BTreeMap<String, OfOne>,
    troubles: u64,
    stop_s: f64,
    stop_slowly_found_s: f64,
    resume_s: f64,
    hold_ticks: u64,
    unsafe_ticks: u64,
    too_fast_ticks: u64,
    fine_ticks: u64,
    false_ticks: u64,
    contacts: u64,
    touched: u64,
    touching: bool,
    findings: Vec<String>,
}

const TICK_NS: u64 = super::super::drive::TICK_NS;

impl Scorer {
    /// A trouble begins; `last_good_ns` is when the last capture before it was made.
    pub fn begin(&mut self, case: &Case, last_good_ns: u64) {
        self.troubles += 1;
        self.of_one.entry(case.name.clone()).or_default().count += 1;
        self.episode = Some(Episode {
            case: case.clone(),
            last_good_ns,
            cleared_ns: None,
            armed_ns: None,
            moved_until_ns: last_good_ns,
            faulted: false,
            found: false,
        });
    }

    /// The trouble is over; `first_good_ns` is when the first good capture is made.
    pub fn clear(&mut self, first_good_ns: u64) {
        let Some(episode) = &mut self.episode else { return };
        episode.cleared_ns = Some(first_good_ns);
        let must_stop = matches!(episode.case.demand, Demand::Stop | Demand::Latch { .. });
        if must_stop && !episode.found {
            let text = format!("{}: the robot was never stopped for it", episode.case.name);
            self.findings.push(text);
        }
        let stop_s = (episode.moved_until_ns - episode.last_good_ns) as f64 * 1e-9;
        match episode.case.demand {
            Demand::Stop | Demand::Latch { found_in_ns: 0 } => self.stop_s = self.stop_s.max(stop_s),
            Demand::Latch { .. } => self.stop_slowly_found_s = self.stop_slowly_found_s.max(stop_s),
            Demand::GoOn | Demand::Slow => return,
        }
        let of_one = self.of_one.entry(episode.case.name.clone()).or_default();
        of_one.stop_s = of_one.stop_s.max(stop_s);
    }

    /// An operator armed.
    pub fn armed(&mut self, now_ns: u64) {
        if let Some(episode) = &mut self.episode {
            episode.armed_ns = Some(now_ns);
        }
    }

    /// Whether a trouble is under way or not yet recovered from.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.episode.is_some()
    }

    /// Counts a tick.
    pub fn tick(&mut self, tick: &Tick) {
        if tick.contact && !self.touching {
            let moved = tick.velocity != Velocity::ZERO;
            self.contacts += u64::from(moved);
            self.touched += u64::from(!moved);
        }
        self.touching = tick.contact;
        let Some(episode) = &mut self.episode else {
            self.fine_ticks += 1;
            self.false_ticks += u64::from(tick.gate != GateState::Track);
            return;
        };
        episode.faulted |= tick.daemon == DaemonState::Fault;
        let moves = tick.velocity != Velocity::ZERO;
        episode.found |= !tick.daemon.allows_motion() || tick.gate != GateState::Track;
        let stop_max_ns = (STOP_MAX_S * 1e9) as u64;
        match episode.case.demand {
            Demand::Stop | Demand::Latch { .. } => {
                let found_in_ns = match episode.case.demand {
                    Demand::Latch { found_in_ns } => found_in_ns,
                    _ => 0,
                };
                let latched = matches!(episode.case.demand, Demand::Latch { .. });
                let must_stand = if latched { episode.armed_ns.is_none() } else { episode.cleared_ns.is_none() };
                if must_stand && moves && episode.cleared_ns.is_none() {
                    episode.moved_until_ns = tick.now_ns + TICK_NS;
                }
                if must_stand && tick.now_ns >= episode.last_good_ns + found_in_ns + stop_max_ns {
                    self.hold_ticks += 1;
                    self.unsafe_ticks += u64::from(moves);
                }
            }
            Demand::Slow => {
                let slow = (0.0..=DEGRADED_SPEED_M_S + 1e-9).contains(&tick.velocity.linear_m_s);
                let late = tick.now_ns >= episode.last_good_ns + stop_max_ns + SLOWING_NS;
                self.too_fast_ticks += u64::from(late && !slow && episode.cleared_ns.is_none());
            }
            Demand::GoOn => {
                self.fine_ticks += 1;
                self.false_ticks += u64::from(tick.gate != GateState::Track);
            }
        }
        self.end_if_back(tick);
    }

    /// Ends the episode when the robot may drive again.
    fn end_if_back(&mut self, tick: &Tick) {
        let Some(episode) = &self.episode else { return };
        let Some(cleared_ns) = episode.cleared_ns else { return };
        let since_s = |from_ns: u64| tick.now_ns.saturating_sub(from_ns) as f64 * 1e-9;
        let drives = tick.gate == GateState::Track && tick.daemon.allows_motion();
        if drives && tick.now_ns >= cleared_ns {
            let by_itself = !episode.faulted && episode.armed_ns.is_none();
            let resume_s = since_s(episode.armed_ns.unwrap_or(cleared_ns));
            if by_itself && episode.case.demand == Demand::Stop {
                self.resume_s = self.resume_s.max(resume_s);
            }
            let of_one = self.of_one.entry(episode.case.name.clone()).or_default();
            of_one.resume_s = of_one.resume_s.max(resume_s);
            self.episode = None;
        } else if since_s(cleared_ns) > RETURN_MAX_S {
            self.findings.push(format!("{}: the robot did not drive again in {RETURN_MAX_S} s", episode.case.name));
            self.episode = None;
        }
    }

    /// The summary, with a finding for every bar missed. The fields that the scorer cannot know are the caller's to fill.
    #[must_use]
    pub fn summary(self) -> Summary {
        let share = |part: u64, all: u64| if all == 0 { 0.0 } else { part as f64 / all as f64 };
        let mut summary = Summary {
            minutes: 0.0,
            seed: 0,
            ping_sets: 0,
            troubles: self.troubles,
            of_one: self.of_one,
            stop_s: self.stop_s,
            stop_slowly_found_s: self.stop_slowly_found_s,
            hold: 1.0 - share(self.unsafe_ticks, self.hold_ticks),
            resume_s: self.resume_s,
            false_stop: share(self.false_ticks, self.fine_ticks),
            unsafe_ticks: self.unsafe_ticks,
            too_fast_ticks: self.too_fast_ticks,
            contacts: self.contacts,
            touched: self.touched,
            distance_m: 0.0,
            footprint_early: None,
            footprint_late: None,
            digest: String::new(),
            findings: self.findings,
        };
        let bars = [
            (summary.contacts > 0, format!("{} contacts", summary.contacts)),
            (summary.unsafe_ticks > 0, format!("{} ticks of motion where the robot must stand", summary.unsafe_ticks)),
            (summary.too_fast_ticks > 0, format!("{} ticks too fast or backwards", summary.too_fast_ticks)),
            (!(summary.stop_s <= STOP_MAX_S), format!("{:.3} s to stop", summary.stop_s)),
            (
                !(summary.stop_slowly_found_s <= 5.0 + STOP_MAX_S),
                format!("{:.3} s to find", summary.stop_slowly_found_s),
            ),
            (!(summary.hold >= HOLD_MIN), format!("hold {:.4}", summary.hold)),
            (!(summary.resume_s <= RESUME_MAX_S), format!("{:.3} s to resume", summary.resume_s)),
            (!(summary.false_stop <= FALSE_STOP_MAX), format!("false stops {:.4}", summary.false_stop)),
        ];
        summary.findings.extend(bars.into_iter().filter(|(missed, _)| *missed).map(|(_, text)| text));
        summary
    }
}

impl Summary {
    /// Compares what the process holds now with what it held early on.
    pub fn judge_footprint(&mut self, early: Option<Footprint>, late: Option<Footprint>) {
        (self.footprint_early, self.footprint_late) = (early, late);
        let (Some(early), Some(late)) = (early, late) else { return };
        if late.rss_kib > early.rss_kib + GROWTH_MAX_KIB {
            self.findings.push(format!("memory grew from {} to {} KiB", early.rss_kib, late.rss_kib));
        }
        for (what, before, after) in [
            ("descriptors", early.descriptors, late.descriptors),
            ("threads", early.threads, late.threads),
            ("shared memory files", early.shared_files, late.shared_files),
        ] {
            if after > before {
                self.findings.push(format!("{what} grew from {before} to {after}"));
            }
        }
    }
}
