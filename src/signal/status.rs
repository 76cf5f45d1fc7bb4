//! States of daemon and controller, and why they are in them: the nouns of the safe-state contract, as they travel on
//! the topics. Who changes them, and when, is told by [`crate::safety`]; nothing here decides anything.

/// Makes a field-less enum whose numbers are on the wire, with its table of names.
macro_rules! wire_enum {
    ($(#[$meta:meta])* $name:ident { $($(#[$variant_meta:meta])* $variant:ident = $number:literal $text:literal,)+ }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u8)]
        pub enum $name { $($(#[$variant_meta])* $variant = $number,)+ }

        impl $name {
            /// Every value, in the order of the numbers.
            pub const ALL: &'static [$name] = &[$($name::$variant,)+];
            /// Number on the wire and name of every value.
            pub const NAMES: &'static [(u32, &'static str)] = &[$(($number, $text),)+];

            /// The name as JSON, logs and displays write it.
            #[must_use]
            pub fn as_str(self) -> &'static str {
                match self { $($name::$variant => $text,)+ }
            }

            /// The number on the wire.
            #[must_use]
            pub fn number(self) -> u32 {
                u32::from(self as u8)
            }

            /// The value with this number on the wire, if there is one.
            #[must_use]
            pub fn from_number(number: u32) -> Option<Self> {
                match number { $($number => Some($name::$variant),)+ _ => None }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.as_str())
            }
        }
    };
}

wire_enum! {
    /// What the daemon is doing. Only ACTIVE and DEGRADED move the robot.
    DaemonState {
        /// Configuration, lock, topics and memory are being made ready.
        Boot = 0 "BOOT",
        /// Sensors and backend are being checked.
        SelfTest = 1 "SELFTEST",
        /// All is well; waits for an operator to arm.
        Ready = 2 "READY",
        /// Drives.
        Active = 3 "ACTIVE",
        /// Drives slowly and never backwards: something is lost.
        Degraded = 4 "DEGRADED",
        /// Stands still until what is wrong has gone.
        Stopped = 5 "STOPPED",
        /// Stands still until an operator resets.
        Fault = 6 "FAULT",
        /// Ends.
        Shutdown = 7 "SHUTDOWN",
    }
}

impl DaemonState {
    /// Whether a command made in this state may be anything but zero.
    #[must_use]
    pub fn allows_motion(self) -> bool {
        matches!(self, DaemonState::Active | DaemonState::Degraded)
    }
}

wire_enum! {
    /// What the controller process is doing. Only TRACK moves the robot.
    GateState {
        /// Not armed, or armed and waiting for five fresh commands.
        Wait = 0 "WAIT",
        /// Follows the commands, within its own limits.
        Track = 1 "TRACK",
        /// Stands still; follows again after five fresh commands of the same epoch.
        Hold = 2 "HOLD",
        /// Stands still until an operator arms again.
        Latched = 3 "LATCHED",
    }
}

wire_enum! {
    /// Why a state is what it is.
    Reason {
        /// Nothing to report.
        None = 0 "none",
        /// The process is starting.
        Starting = 1 "starting",
        /// Good ping sets are being counted.
        SelfTesting = 2 "self_testing",
        /// Nobody armed.
        NotArmed = 3 "not_armed",
        /// An operator armed.
        Armed = 4 "armed",
        /// An operator asked to stop.
        OperatorStop = 5 "operator_stop",
        /// An operator asked to reset.
        OperatorReset = 6 "operator_reset",
        /// What was wrong has gone.
        Recovered = 7 "recovered",
        /// A signal asked the process to end.
        Terminated = 8 "terminated",
        /// A sensor does not deliver.
        SensorLost = 16 "sensor_lost",
        /// The way cannot be seen without a lost sensor.
        ViewMissing = 17 "view_missing",
        /// 3 to 8 channels of a sensor are left out.
        ChannelsLost = 18 "channels_lost",
        /// A ping could not be used.
        PingRejected = 19 "ping_rejected",
        /// Channels clipped after the direct path: something is very near.
        Clipped = 20 "clipped",
        /// The newest ping set is older than MAX_AGE.
        PingTooOld = 21 "ping_too_old",
        /// A ping set is stamped in the future.
        PingFromFuture = 22 "ping_from_future",
        /// A ping set was not ready in time, twice in a row.
        DeadlineMissed = 23 "deadline_missed",
        /// The GPU failed; the CPU is in time.
        BackendFallback = 24 "backend_fallback",
        /// The sensors' emissions drift apart.
        DesyncWarning = 25 "desync_warning",
        /// Sequence numbers are missing, three sets in a row.
        SequenceGaps = 26 "sequence_gaps",
        /// A sensor does not hear its own emission.
        NoDirectPath = 32 "no_direct_path",
        /// A sensor repeats the same samples.
        FrozenPing = 33 "frozen_ping",
        /// Microphones are not where the array's geometry says.
        ChannelMap = 34 "channel_map",
        /// The sensors do not emit together.
        Desync = 35 "desync",
        /// GPU and CPU disagree.
        BackendMismatch = 36 "backend_mismatch",
        /// Too many channels were lost for too long.
        ChannelsDead = 37 "channels_dead",
        /// A fault of the program itself.
        InternalError = 38 "internal_error",
        /// Five stops within a minute.
        TooManyStops = 39 "too_many_stops",
        /// The self-test did not end within ten seconds of the start.
        StartTimeout = 40 "start_timeout",
        /// No command arrives.
        NoCommand = 64 "no_command",
        /// The command was made from too old a capture, or its validity ended.
        CommandTooOld = 65 "command_too_old",
        /// The command was made from a capture in the future.
        CommandFromFuture = 66 "command_from_future",
        /// The daemon's own state forbids motion.
        DaemonNotActive = 67 "daemon_not_active",
        /// Sequence numbers do not increase.
        SequenceStalled = 68 "sequence_stalled",
        /// The commands come from another start of the daemon.
        EpochChanged = 69 "epoch_changed",
        /// The commands come from another publisher.
        PublisherChanged = 70 "publisher_changed",
        /// The checksum is wrong.
        BadChecksum = 71 "bad_checksum",
        /// The layout is that of another build.
        BadSchema = 72 "bad_schema",
        /// A value is NaN or infinite.
        NotFinite = 73 "not_finite",
        /// A value exceeds the platform's limits by more than a tenth.
        LimitExceeded = 74 "limit_exceeded",
        /// HOLD lasted too long.
        HoldTooLong = 75 "hold_too_long",
        /// An arm request was too old, from the future, or older than the last stop.
        ArmOutdated = 76 "arm_outdated",
        /// An arm request names another start of the daemon.
        ArmWrongEpoch = 77 "arm_wrong_epoch",
        /// An arm request came in a state that cannot be armed.
        ArmNotReady = 78 "arm_not_ready",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_leads_back_to_its_value_and_others_to_none() {
        for &state in DaemonState::ALL {
            assert_eq!(DaemonState::from_number(state.number()), Some(state));
        }
        for &state in GateState::ALL {
            assert_eq!(GateState::from_number(state.number()), Some(state));
        }
        for &reason in Reason::ALL {
            assert_eq!(Reason::from_number(reason.number()), Some(reason));
        }
        assert_eq!(DaemonState::from_number(8), None);
        assert_eq!(GateState::from_number(4), None);
        assert_eq!(Reason::from_number(u32::MAX), None);
    }

    #[test]
    fn two_states_of_the_daemon_move_the_robot() {
        let moving: Vec<_> = DaemonState::ALL.iter().filter(|state| state.allows_motion()).collect();
        assert_eq!(moving, [&DaemonState::Active, &DaemonState::Degraded]);
    }
}
