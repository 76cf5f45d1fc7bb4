//! noctule turns the raw ultrasound of one to three microphone arrays into energyscapes (sonar images) and safe
//! velocity commands for a mobile robot.
//!
//! # The line that data follows
//!
//! ```text
//! Source ─ PingSet ─► demodulate ─► matched_filter ─► delay_and_sum ─► envelope ─► masked_energy ─ Energyscapes + RowSums
//!                     └───────────────────── imaging::Backend (cpu | gpu) ──────────────────────┘             │
//!           ┌─────────────────────────────────────────────────────────────────────────────────────────────────┘
//!           ▼
//!    flow::MaskSet::fuse ─ Cues ─► control::Controller::step ─ Decision ─► safety::daemon ─► topics
//! ═══════════════════════════ process boundary: iceoryx2 shared memory ═══════════════════════════
//!    noctule-controller:  VelocityCommand ─► safety::gate ─► PlatformVelocity ─► the robot
//! ```
//!
//! Read the files in that order: `main.rs`, [`service`] (`pipeline.rs` is one ping through everything), [`imaging`] and its
//! five stages, [`flow`], [`control`], [`safety`], [`io`].
//!
//! # Code map
//!
//! | room | what it holds | may not |
//! |---|---|---|
//! | [`signal`] | the nouns: pings, energyscapes, masks, cues, velocities | compute anything |
//! | [`sensor`] | facts of the hardware: array, emission, mount, dead zones | see data |
//! | [`imaging`] | raw pings to energyscapes, on the CPU or a GPU | know regions' meaning |
//! | [`calibration`] | what the direct path tells of air and sensors; its file, its alarms | stop a robot |
//! | [`flow`] | how echoes move, regions, masks, cues | know how images are made |
//! | [`control`] | cues to decisions, four layers | do I/O, read a clock, be random |
//! | [`safety`] | state machines of daemon and controller process | do anything but decide |
//! | [`sim`] | a world that makes microphone signals, a robot and guidance in it, a score | import what it tests |
//! | [`io`] | shared memory, files, pictures | decide |
//! | [`config`] | one TOML file to parameters | hold a default of its own where a module has one |
//! | [`life`] | signals, panics, the service manager, the log: how a process of the robot lives and ends | know of sonar |
//! | [`service`] | the daemon: wiring, threads, health; the proving ground: many daemons in simulation | hold science |
//! | `view` | the live page, metrics, Foxglove: a process that only looks | publish, command |
//!
//! Inside [`sim`], `echo/` makes the signals, a file for each piece of physics, which is where to look what is simulated and how
//! well: `path` (mirror images, corners, multipath), `edge`, `cylinder`, `directivity`, `air`, `sight` (what hides what),
//! `motion`, `waveform` (exact delays), `noise`, `jammer`, `pdm`; `world` reads world files, `guidance` makes the wanted velocity,
//! `score` judges.
//!
//! Inside [`control`], beside a file for each layer: [`control::default_regions`] (the rule of regions, thresholds and gains),
//! `detour` (places that are being passed), `approach` (who walks up), `progress` (stuck), `limits`.
//!
//! The proving ground, from the bottom: [`service::trial`] drives one robot through one world on simulated clocks, with the
//! pipeline and the gate of the daemon and the controller process; [`service::proving`] drives many on a few threads; [`service::sweep`] draws sensor
//! layouts and ranks them; [`service::plots`] turns all of these into what [`io::plot`] draws (the figures of paper 000);
//! [`io::plot_layouts`] draws the ranking; `cli::simulate` is the command.
//! [`service::soak`] drives one robot for hours while something goes wrong every minute, and scores how it stops and goes on.
//!
//! `tests/architecture.rs` holds the import table. Compared with the first sketch of this house two leaves were added,
//! [`parameter`] (a refused value) and [`document`] (TOML errors that point at the line), `sensor` may name `signal`'s sample
//! format, and `control` keeps its regions as [`geometry::shape::Shape`]s.
//!
//! # Conventions
//!
//! SI units and radians inside, degrees in names that end in `_deg` only. Robot frame x forward, y left; sensor frame
//! x boresight, y left, z up; angles counter-clockwise, bearings positive to the left. *Ping* is one delivery of one sensor,
//! *ping set* those of one emission, *frame* a coordinate frame. A ping is stamped with its emission on
//! CLOCK_BOOTTIME and the stamp travels unchanged to every product.
//!
//! # Invariants
//!
//! `signal` computes nothing · `imaging` and `flow` do not know each other · `control` can be run with a pencil ·
//! `sim` never imports what it tests · one place turns a range and a bearing into an index ([`signal::PolarGrid`]) · one place
//! names each topic ([`io::topics`]) · nothing allocates per ping after start · a comparison that meets NaN sees an
//! obstacle · every number published can be traced to a ping and a layer.
#![warn(missing_docs)]

pub mod calibration;
pub mod cli;
pub mod cli_controller;
pub mod config;
pub mod control;
pub mod controller_process;
pub mod detect;
pub mod document;
pub mod flow;
pub mod geometry;
pub mod imaging;
pub mod io;
pub mod life;
pub mod parameter;
pub mod safety;
pub mod sensor;
pub mod service;
pub mod signal;
pub mod sim;
pub mod time;
#[cfg(feature = "view")]
pub mod view;

pub use config::Config;
