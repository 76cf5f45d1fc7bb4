//! Contract (check 12): when the controller is killed or stopped, the base stands by its own watchdog; the supervisor starts another
//! within a second, which says zero until an operator arms it.

mod checks;
mod ipc_rig;
mod judge;
mod life_rig;

use checks::{figure, trials};
use ipc_rig::{FakeDaemon, MS, Metronome, Place};
use judge::{Heard, Judge, TRACK, WAIT, now_ns};
use life_rig::{SOON, controller_command, in_ms};
use noctule::io::OperatorClient;
use noctule::io::wire::message::Request;
use noctule::service::supervisor::{CONTROLLER_TERMS, Supervised, Watched};
use rustix::process::{Pid, Signal};
use std::time::{Duration, Instant};

const EPOCH: u64 = 12;

#[test]
fn judge_process() {
    judge::serve_if_asked();
}

/// A daemon that never stops speaking, a supervised controller, and the judge.
struct Supervision {
    controller: Supervised,
    daemon: FakeDaemon,
    metronome: Metronome,
    operator: OperatorClient,
    judge: Judge,
    beaten_ns: u64,
    _place: Place,
}

impl Supervision {
    fn new() -> Self {
        let place = Place::new();
        let mut arguments = Vec::new();
        let command = controller_command(&place);
        arguments.extend(command.get_args().map(std::ffi::OsStr::to_owned));
        let program = command.get_program().to_owned();
        let controller = Supervised::start("controller", CONTROLLER_TERMS, move |_| {
            let mut command = std::process::Command::new(&program);
            command.args(&arguments).stderr(std::process::Stdio::null());
            command
        });
        let judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
        Self {
            controller: controller.expect("started"),
            daemon: FakeDaemon::new(&place.root(), &place.params.prefix, EPOCH),
            metronome: Metronome::new(Duration::from_millis(100)),
            operator: OperatorClient::open(&place.ipc).expect("operator"),
            judge,
            beaten_ns: 0,
            _place: place,
        }
    }

    /// What demo does every 10 ms: looks, hands beats on, watches.
    fn turn(&mut self) {
        if self.metronome.due() {
            self.daemon.send(|_| {});
        }
        self.judge.look();
        let heard_ns = self.judge.newest().map_or(0, |heard| heard.sent_ns);
        if heard_ns != self.beaten_ns {
            self.beaten_ns = heard_ns;
            self.controller.beat();
        }
        assert_eq!(self.controller.watch().expect("watched"), Watched::Alive);
        std::thread::sleep(Duration::from_millis(2));
    }

    fn until(&mut self, what: &str, condition: impl Fn(&Heard) -> bool) -> Heard {
        let deadline = Instant::now() + SOON;
        loop {
            self.turn();
            if let Some(newest) = self.judge.newest().filter(|newest| condition(newest)) {
                return newest;
            }
            assert!(Instant::now() < deadline, "{what}");
        }
    }

    fn turn_for(&mut self, duration: Duration) {
        let deadline = Instant::now() + duration;
        while Instant::now() < deadline {
            self.turn();
        }
    }

    fn arm(&mut self) {
        self.operator.send(Request::Arm, EPOCH).expect("asked");
        self.until("motion", |heard| heard.state == TRACK && heard.moves());
    }
}

#[test]
fn the_base_stands_by_itself_and_the_next_controller_is_there_in_a_second_and_needs_arming() {
    let count = trials(100, 4);
    let (mut worst_stand_ns, mut worst_back_ns, mut worst_back_stopped_ns, mut unarmed) = (0, 0, 0, 0);
    for trial in 0..count {
        let stops = trial % 2 == 1;
        let mut supervision = Supervision::new();
        supervision.until("controller", |_| true);
        supervision.arm();
        supervision.turn_for(Duration::from_millis((trial * 13 % 40) as u64));
        let id = Pid::from_raw(supervision.controller.process_id().expect("runs").cast_signed()).expect("number");
        let struck_ns = now_ns();
        rustix::process::kill_process(id, if stops { Signal::STOP } else { Signal::KILL }).expect("struck");
        let back = supervision.until("the next controller", |heard| heard.at_ns > struck_ns + 100 * MS);
        assert!(back.state == WAIT && !back.moves(), "it starts with zero: {back:?}");
        let record = &supervision.judge.record;
        let stand_ns = record.motors_stand_at(struck_ns).expect("the base stands") - struck_ns;
        assert!(record.since(struck_ns + 100 * MS).all(|heard| !heard.moves()));
        worst_stand_ns = worst_stand_ns.max(stand_ns);
        let back_ns = back.at_ns - struck_ns;
        let worst = if stops { &mut worst_back_stopped_ns } else { &mut worst_back_ns };
        *worst = back_ns.max(*worst);
        // The daemon is armed and active all the time: only the controller's own arming keeps the robot still.
        supervision.turn_for(Duration::from_millis(700));
        unarmed += usize::from(supervision.judge.record.motion_after(back.at_ns).is_some());
        supervision.arm();
    }
    figure(
        12,
        "controller killed or stopped to standing motors, the base's watchdog",
        in_ms(worst_stand_ns),
        "<= 300 ms",
        count,
    );
    figure(12, "controller killed to the next one's first zero", in_ms(worst_back_ns), "<= 1 s", count.div_ceil(2));
    figure(12, "controller stopped to the next one's first zero", in_ms(worst_back_stopped_ns), "<= 2 s", count / 2);
    figure(12, "motion of the next controller before arming", unarmed, "0", count);
    assert!(worst_stand_ns <= 300 * MS);
    assert!(worst_back_ns <= 1_000 * MS && worst_back_stopped_ns <= 2_000 * MS);
    assert_eq!(unarmed, 0);
}
