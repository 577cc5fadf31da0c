//! The worker against the fake, step by step on a clock of its own: nothing here depends on how busy the computer is.

use ambf_device::DeviceForce;
use crossbeam_utils::atomic::AtomicCell;
use nalgebra::Vector3;
use triple_buffer::triple_buffer;

use super::*;
use crate::kinematics::{force, motor_torques, to_base};
use crate::transport::{Port, PACKET};
use fake_falcon::{Aim, Clock, FakeBus, FakeFalcon, Fault, Hand, Received, Script, Setup, Softness};

const MS: Duration = Duration::from_millis(1);

/// A bus of the fakes. They are built against this crate without its tests, whose traits are others to the compiler.
struct Fakes(FakeBus);

impl Bus for Fakes {
    fn list(&self) -> Result<Vec<String>, TransportError> {
        falcon::Bus::list(&self.0).map_err(same)
    }

    fn open(&self, identity: &str) -> Result<Box<dyn Port>, TransportError> {
        let port = falcon::Bus::open(&self.0, identity).map_err(same)?;
        Ok(Box::new(FakePort(port)))
    }

    fn now(&self) -> Instant {
        falcon::Bus::now(&self.0)
    }

    fn wait(&self, duration: Duration) {
        falcon::Bus::wait(&self.0, duration);
    }
}

struct FakePort(Box<dyn falcon::Port>);

impl Port for FakePort {
    fn control_out(&mut self, request: u8, value: u16) -> Result<(), TransportError> {
        self.0.control_out(request, value).map_err(same)
    }

    fn bulk_out(&mut self, bytes: &[u8], timeout: Duration) -> Result<(), TransportError> {
        self.0.bulk_out(bytes, timeout).map_err(same)
    }

    fn bulk_in(&mut self, packet: &mut [u8; PACKET], timeout: Duration) -> Result<usize, TransportError> {
        self.0.bulk_in(packet, timeout).map_err(same)
    }
}

fn same(error: falcon::TransportError) -> TransportError {
    match error {
        falcon::TransportError::TimedOut => TransportError::TimedOut,
        falcon::TransportError::Gone => TransportError::Gone,
        falcon::TransportError::Busy => TransportError::Busy,
        other => TransportError::Other(other.to_string()),
    }
}

/// Worker, fake and what the host holds of a device.
struct Bench {
    worker: Worker,
    fake: FakeFalcon,
    clock: Clock,
    wanted: Input<Wanted>,
    status: Output<Status>,
    sentences: Box<dyn Fn() -> Vec<String>>,
}

/// Every byte occurs, those of the protocol too.
fn image() -> Vec<u8> {
    (0..8492_u32).map(|n| (n * 7) as u8).collect()
}

fn firmware() -> Firmware {
    let path =
        std::env::temp_dir().join(format!("falcon-image-{}-{:?}", std::process::id(), std::thread::current().id()));
    std::fs::write(&path, image()).unwrap();
    let firmware = Firmware::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    firmware
}

/// Moves through the marks of all encoders in the first second, then rests at `position`.
fn homing_then(position: Vector3<f64>) -> Script {
    Arc::new(move |time: f64| {
        let home = Vector3::new(0.03 * (time * std::f64::consts::TAU).sin(), 0.0, 0.0);
        Aim { position: if time < 1.0 { home } else { position }, grip: 0x2 }
    })
}

impl Bench {
    fn new(setup: Setup, firmware: Option<Firmware>, event_character: bool) -> Self {
        let clock = Clock::stepped();
        let bus = FakeBus::new(clock.clone(), [setup]);
        let fake = bus.falcons()[0].clone();
        let (log, receiver) = DeviceLog::new();
        let (wanted, wanted_reader) = triple_buffer(&Wanted { force: Vector3::zeros(), since: clock.now() });
        let (published, status) = triple_buffer(&Status::none(clock.now()));
        let config = Config { firmware, z0: 0.125, event_character };
        let worker = Worker::new(
            Arc::new(Fakes(bus)),
            "fake-1",
            config,
            log,
            Arc::new(AtomicBool::new(false)),
            wanted_reader,
            published,
        );
        let sentences = Box::new(move || receiver.try_iter().collect());
        Self { worker, fake, clock, wanted, status, sentences }
    }

    /// A device at rest at `position` after homing, with its ramp at the end.
    fn ready(position: Vector3<f64>) -> Self {
        let setup = Setup { hand: Hand::firm(homing_then(position)), ..Setup::new("fake-1") };
        let mut bench = Self::new(setup, None, false);
        bench.worker.begin().unwrap();
        bench.run(Duration::from_millis(2500));
        assert_eq!(bench.status.read().state, State::Ready);
        bench
    }

    fn step(&mut self) {
        self.worker.step().unwrap();
    }

    fn run(&mut self, duration: Duration) {
        let end = self.clock.now() + duration;
        while self.clock.now() < end {
            self.step();
        }
    }

    fn push(&mut self, force: Vector3<f64>) {
        self.wanted.write(Wanted { force, since: self.clock.now() });
    }

    /// Exchanges for `duration` while the host asks for `force` at each step.
    fn push_for(&mut self, force: Vector3<f64>, duration: Duration) {
        let end = self.clock.now() + duration;
        while self.clock.now() < end {
            self.push(force);
            self.step();
        }
    }

    fn last_command(&self) -> Received {
        *self.fake.commands().last().unwrap()
    }
}

#[test]
fn the_device_homes_and_says_where_it_is() {
    let position = Vector3::new(0.01, -0.02, 0.015);
    let setup = Setup { hand: Hand::firm(homing_then(position)), ..Setup::new("fake-1") };
    let mut bench = Bench::new(setup, None, false);
    bench.worker.begin().unwrap();
    let mut homed = None;
    for _ in 0..2000 {
        bench.push(Vector3::x());
        bench.step();
        let status = *bench.status.read();
        let command = bench.last_command();
        assert_eq!(command.control & 1, 1, "homing stays on in every packet");
        if status.homed == [true; 3] && homed.is_none() {
            homed = Some(status.exchanges);
            assert!(!status.sample.valid, "the coordinates jump with this reply");
        }
        if homed.is_none() {
            assert!(!status.sample.valid && command.motors == [0; 3] && command.control == 1 | 8);
        }
    }
    let status = *bench.status.read();
    assert!(status.sample.valid && status.state == State::Ready);
    assert!((status.sample.position - position).norm() < 5e-5, "{}", status.sample.position);
    assert_eq!(status.sample.buttons, 1 << 2);
    assert_eq!(bench.last_command().control, 1 | 2, "green");
    let sentences = (bench.sentences)();
    assert!(sentences[0].contains("pull the grip all the way out"), "{sentences:?}");
    assert!(sentences[1].contains("is ready") && sentences.len() == 2, "{sentences:?}");
}

#[test]
fn a_thousand_exchanges_a_second_are_made() {
    let mut bench = Bench::ready(Vector3::zeros());
    let before = (bench.clock.now(), bench.status.read().exchanges, bench.fake.count());
    bench.run(Duration::from_secs(10));
    let seconds = (bench.clock.now() - before.0).as_secs_f64();
    let rate = (bench.status.read().exchanges - before.1) as f64 / seconds;
    assert!((980.0..1001.0).contains(&rate), "{rate} Hz");
    assert_eq!(bench.fake.count() - before.2, bench.status.read().exchanges - before.1, "one question, one answer");
}

#[test]
fn the_event_character_makes_it_faster() {
    for (event_character, known) in [(true, true), (true, false)] {
        let setup = Setup { event_character: known, ..Setup::new("fake-1") };
        let mut bench = Bench::new(setup, None, event_character);
        bench.worker.begin().unwrap();
        bench.run(Duration::from_secs(2));
        assert!(bench.fake.requests().contains(&(6, 0x013E)));
        let rate = bench.status.read().exchanges / 2;
        // A chip that does not know it is as fast as without.
        assert!(if known { rate > 3000 } else { (980..1001).contains(&rate) }, "{rate} Hz");
    }
}

#[test]
fn the_chip_is_set_up_as_the_device_wants() {
    let mut bench = Bench::new(Setup::new("fake-1"), None, false);
    bench.worker.begin().unwrap();
    let expected = [(0, 1), (0, 2), (9, 1), (3, 2), (0, 1), (0, 2)];
    assert_eq!(bench.fake.requests(), expected);
}

#[test]
fn a_force_pushes_in_its_direction() {
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let mut bench = Bench::ready(Vector3::new(0.005, 0.01, -0.01));
            let wanted = Vector3::ith(axis, 2.0 * sign);
            bench.push_for(wanted, 10 * MS);
            // What the fake's hand feels, by the inverse way.
            let base = to_base(&bench.fake.grip().0) + Vector3::new(0.0, 0.0, 0.125);
            let torques = motor_torques(bench.fake.motors());
            let felt = force(&base, &torques).unwrap();
            assert!((Vector3::new(felt.z, felt.x, felt.y) - wanted).norm() < 0.02, "{wanted} became {felt}");
        }
    }
}

#[test]
fn forces_that_nobody_renews_end_after_50_ms() {
    let mut bench = Bench::ready(Vector3::zeros());
    bench.push_for(Vector3::new(3.0, 0.0, 0.0), 20 * MS);
    assert_ne!(bench.fake.motors(), [0; 3]);
    bench.run(45 * MS);
    assert_ne!(bench.fake.motors(), [0; 3]);
    bench.run(10 * MS);
    assert_eq!(bench.fake.motors(), [0; 3]);
    assert_eq!(bench.last_command().control, 1 | 4, "blue");
}

#[test]
fn replies_that_are_split_late_or_merged_are_read() {
    let delays = [Fault::Split, Fault::Slow(8 * MS), Fault::Merge];
    for fault in delays {
        let mut bench = Bench::ready(Vector3::zeros());
        let before = *bench.status.read();
        bench.fake.inject(fault, 5);
        bench.run(200 * MS);
        let status = *bench.status.read();
        assert!(status.sample.valid && status.state == State::Ready, "{fault:?}");
        assert!(status.exchanges > before.exchanges + 20, "{fault:?}");
        assert_eq!(bench.worker.link.as_ref().map(|_| ()), Some(()), "{fault:?}: no reason to open it again");
    }
}

#[test]
fn damaged_replies_cost_little_and_show_nothing_wrong() {
    let position = Vector3::new(0.0, 0.01, 0.0);
    let damages = (0..16)
        .map(Fault::LoseByte)
        .chain((0..16).flat_map(|place| [b'<', b'>', b'P', b'A', 0, 0xFF].map(|byte| Fault::ChangeByte(place, byte))));
    for damage in damages {
        let mut bench = Bench::ready(position);
        bench.push_for(Vector3::x(), 10 * MS);
        bench.fake.inject(damage, 1);
        let before = bench.status.read().exchanges;
        let end = bench.clock.now() + 100 * MS;
        while bench.clock.now() < end {
            bench.push(Vector3::x());
            bench.step();
            let sample = bench.status.read().sample;
            assert!(!sample.valid || (sample.position - position).norm() < 2e-3, "{damage:?}: {}", sample.position);
        }
        assert!(bench.status.read().sample.valid, "{damage:?}");
        // What is seen to be damaged is asked again at once; an end that is missing takes as long as silence.
        let no_end = matches!(damage, Fault::LoseByte(0 | 15) | Fault::ChangeByte(0 | 15, _));
        let exchanges = bench.status.read().exchanges - before;
        assert!(exchanges >= if no_end { 75 } else { 97 }, "{damage:?}: {exchanges}");
    }
}

#[test]
fn commands_that_are_lost_are_sent_again_without_force() {
    for fault in
        [Fault::LoseSentByte(0), Fault::LoseSentByte(7), Fault::LoseSentByte(15), Fault::Refuse, Fault::Silence]
    {
        let mut bench = Bench::ready(Vector3::zeros());
        bench.push_for(Vector3::new(3.0, 0.0, 0.0), 10 * MS);
        bench.fake.inject(fault, 1);
        let before = bench.status.read().exchanges;
        // The fault costs one exchange of 20 ms; the next command is at rest, and the ramp begins again.
        bench.push_for(Vector3::new(3.0, 0.0, 0.0), 25 * MS);
        assert!(bench.fake.motors().iter().all(|motor| motor.abs() < 20), "{fault:?}: {:?}", bench.fake.motors());
        bench.push_for(Vector3::new(3.0, 0.0, 0.0), 1100 * MS);
        assert!(bench.fake.motors().iter().all(|motor| motor.abs() > 700), "{fault:?}: {:?}", bench.fake.motors());
        assert!(bench.status.read().exchanges - before > 1050, "{fault:?}");
    }
}

#[test]
fn a_silent_device_is_told_to_rest_then_opened_again() {
    let mut bench = Bench::ready(Vector3::zeros());
    bench.push_for(Vector3::new(3.0, 0.0, 0.0), 10 * MS);
    let begin = bench.clock.now();
    bench.fake.inject(Fault::Silence, 11);
    let requests = bench.fake.requests().len();
    bench.push_for(Vector3::new(3.0, 0.0, 0.0), 150 * MS);
    assert!(!bench.status.read().sample.valid);
    let later: Vec<Received> =
        bench.fake.commands().into_iter().filter(|command| command.time > begin + 25 * MS).collect();
    assert!(later.len() >= 5 && later.iter().all(|command| command.motors == [0; 3]), "{later:?}");
    assert_eq!(bench.fake.requests().len(), requests, "not opened again before 200 ms");
    bench.push_for(Vector3::new(3.0, 0.0, 0.0), 200 * MS);
    assert!(bench.fake.requests().len() > requests);
    assert!(bench.status.read().sample.valid, "it comes back by itself");
    let sentences = (bench.sentences)();
    assert!(sentences.iter().any(|sentence| sentence.contains("is lost: it does not answer")), "{sentences:?}");
}

#[test]
fn three_zeros_are_sent_on_close_and_on_errors() {
    let at_rest = |commands: &[Received]| commands.iter().rev().take_while(|c| c.motors == [0; 3]).count();
    let mut bench = Bench::ready(Vector3::zeros());
    bench.push_for(Vector3::x(), 10 * MS);
    assert_eq!(at_rest(&bench.fake.commands()), 0);
    bench.worker.end();
    let commands = bench.fake.commands();
    assert_eq!(at_rest(&commands), 3);
    assert_eq!(commands.last().unwrap().control, 1, "dark");
    assert!(!bench.fake.is_open());
    assert!(!bench.status.read().sample.valid);

    let mut bench = Bench::ready(Vector3::zeros());
    bench.push_for(Vector3::x(), 10 * MS);
    bench.fake.inject(Fault::Fail, 1);
    bench.step();
    assert_eq!(at_rest(&bench.fake.commands()), 3);
    assert!(!bench.fake.is_open());
}

#[test]
fn an_unplugged_device_is_found_again_every_second() {
    let mut bench = Bench::ready(Vector3::zeros());
    bench.push_for(Vector3::x(), 10 * MS);
    bench.fake.inject(Fault::Unplug, 1);
    bench.step();
    let status = *bench.status.read();
    assert!(!status.sample.valid && status.state == State::Away && status.homed == [false; 3]);
    let sequence = status.sample.sequence;
    bench.run(Duration::from_millis(3500));
    assert_eq!(bench.status.read().sample.sequence, sequence);
    assert_eq!(bench.fake.attempts(), 1 + 3);
    bench.fake.plug();
    let end = bench.clock.now() + Duration::from_millis(1200);
    while !bench.status.read().sample.valid {
        assert!(bench.clock.now() < end, "it kept its power, so it is still homed");
        bench.step();
    }
    bench.push_for(Vector3::x(), 100 * MS);
    assert!(
        bench.fake.motors().iter().all(|motor| motor.abs() < 80),
        "forces begin from zero: {:?}",
        bench.fake.motors()
    );
    let sentences = (bench.sentences)();
    let count = |text: &str| sentences.iter().filter(|sentence| sentence.contains(text)).count();
    assert_eq!([count("is lost"), count("can't be used"), count("is ready")], [1, 1, 2], "{sentences:?}");
}

#[test]
fn a_device_that_was_switched_off_gets_its_firmware_again() {
    let setup = Setup { hand: Hand::firm(homing_then(Vector3::zeros())), ..Setup::new("fake-1") };
    let mut bench = Bench::new(setup, Some(firmware()), false);
    bench.worker.begin().unwrap();
    bench.run(1500 * MS);
    bench.fake.power_cycle();
    assert!(!bench.fake.is_running());
    bench.run(Duration::from_secs(10));
    assert!(bench.fake.is_running());
    // The hand rests and passes no marks any more.
    assert_eq!(bench.status.read().state, State::Homing);
    assert_eq!(bench.last_command().control, 1 | 8);
}

#[test]
fn a_device_that_was_switched_off_and_has_no_firmware_is_given_up() {
    let mut bench = Bench::ready(Vector3::zeros());
    bench.fake.power_cycle();
    let problem = (0..100).find_map(|_| bench.worker.step().err());
    assert_eq!(problem, Some(Problem::NeedsFirmware));
}

fn uploads(leading_zero: bool, fault: Option<(Fault, u64)>) -> (Bench, Result<(), Problem>) {
    let setup = Setup { firmware_runs: false, leading_zero, ..Setup::new("fake-1") };
    let mut bench = Bench::new(setup, Some(firmware()), false);
    bench.worker.begin().unwrap();
    if let Some((fault, count)) = fault {
        bench.fake.inject(fault, count);
    }
    for _ in 0..10_000 {
        if let Err(problem) = bench.worker.step() {
            return (bench, Err(problem));
        }
        if bench.fake.is_running() {
            break;
        }
    }
    (bench, Ok(()))
}

#[test]
fn firmware_is_uploaded() {
    for leading_zero in [false, true] {
        let (mut bench, result) = uploads(leading_zero, None);
        assert_eq!(result, Ok(()));
        assert!(bench.fake.is_running());
        let sentences = (bench.sentences)();
        assert!(sentences[0].contains("gets its firmware, 8492 bytes"), "{sentences:?}");
        bench.run(100 * MS);
        assert_eq!(bench.status.read().state, State::Homing);
        let requests = bench.fake.requests();
        let upload = [(9, 16), (3, 0x4138), (4, 8), (2, 0), (1, 0x0200), (1, 0x0100), (1, 0x0101)];
        assert!(requests.windows(upload.len()).any(|window| window == upload), "{requests:?}");
    }
}

#[test]
fn firmware_is_uploaded_whatever_goes_wrong_at_first() {
    // How many answers are hit: the first after a wake-up, an echo in the middle, and several in a row.
    let counts = [1, 2, 7];
    let faults = [
        Fault::Split,
        Fault::Merge,
        Fault::LoseByte(0),
        Fault::LoseByte(30),
        Fault::ChangeByte(0, b'x'),
        Fault::ChangeByte(61, 0),
        Fault::Silence,
        Fault::Slow(15 * MS),
        Fault::Slow(600 * MS),
        Fault::LoseSentByte(1),
        Fault::ChangeSentByte(1, 0),
        Fault::Refuse,
        Fault::Fail,
    ];
    for fault in faults {
        for count in counts {
            let (bench, result) = uploads(false, Some((fault, count)));
            assert_eq!(result, Ok(()), "{fault:?}, {count} times: {:?}", (bench.sentences)());
            assert!(bench.fake.is_running(), "{fault:?}, {count} times");
            assert!(bench.fake.image() == image(), "{fault:?}, {count} times");
        }
    }
}

#[test]
fn an_echo_that_is_wrong_begins_the_upload_again() {
    for fault in [Fault::ChangeSentByte(30, 0), Fault::LoseSentByte(30), Fault::ChangeByte(30, 0), Fault::LoseByte(30)]
    {
        let setup = Setup { firmware_runs: false, ..Setup::new("fake-1") };
        let mut bench = Bench::new(setup, Some(firmware()), false);
        bench.worker.begin().unwrap();
        let mut link = Link::open(&bench.worker.bus, "fake-1", false).unwrap();
        let sent = std::cell::Cell::new(0);
        // Asked before each block: in the middle of the image something goes wrong.
        let stopped = || {
            sent.set(sent.get() + 1);
            if sent.get() == 70 {
                bench.fake.inject(fault, 1);
            }
            false
        };
        let result = firmware().upload(&*bench.worker.bus, &mut link, &stopped);
        assert!(matches!(result, Err(FirmwareError::Loader(_))), "{fault:?}: {result:?}");
        assert!((62 * 60..62 * 71).contains(&bench.fake.image().len()), "{fault:?}");
        drop(link);
        bench.run(Duration::from_secs(6));
        assert!(bench.fake.is_running() && bench.fake.image() == image(), "{fault:?}");
    }
}

#[test]
fn a_device_that_is_unplugged_while_it_is_loaded_is_loaded_when_it_is_back() {
    let setup = Setup { firmware_runs: false, ..Setup::new("fake-1") };
    let mut bench = Bench::new(setup, Some(firmware()), false);
    bench.worker.begin().unwrap();
    bench.fake.inject(Fault::Merge, 1);
    bench.fake.inject(Fault::Unplug, 1);
    for _ in 0..3 {
        bench.step();
    }
    assert!(!bench.fake.is_running());
    bench.fake.plug();
    bench.run(Duration::from_secs(20));
    assert!(bench.fake.is_running());
}

#[test]
fn attempts_to_upload_come_to_an_end() {
    let (_, result) = uploads(false, Some((Fault::ChangeByte(0, b'x'), u64::MAX)));
    let problem = result.unwrap_err();
    assert!(matches!(problem, Problem::Upload(FirmwareError::Loader(_))), "{problem}");
    assert!(problem.to_string().starts_with("10 attempts"), "{problem}");
}

#[test]
fn without_firmware_the_user_is_told_what_to_do() {
    let setup = Setup { firmware_runs: false, ..Setup::new("fake-1") };
    let mut bench = Bench::new(setup, None, false);
    let problem = bench.worker.begin().unwrap_err();
    assert_eq!(problem, Problem::NeedsFirmware);
    assert!(problem.to_string().contains("firmware: nvent_firmware.bin"));
    assert!(!bench.fake.is_open());
}

/// A soft hand pushes 1 cm behind a wall at x = 0 of `stiffness`, rendered through the driver with `delay` more steps
/// of the host. The largest energy of hand and wall after it let go, as a share of the first, and the depth at the end,
/// m.
fn push_wall(stiffness: f64, delay: usize) -> (f64, f64) {
    let softness = Softness { mass: 0.1, stiffness: 100.0, damping: 3.0 };
    let target = Vector3::new(-0.01, 0.0, 0.0);
    let aim = Arc::new(AtomicCell::new(0.03));
    let script = {
        let aim = Arc::clone(&aim);
        move |time: f64| match time {
            time if time < 1.0 => homing_then(Vector3::zeros())(time),
            _ => Aim { position: Vector3::new(aim.load(), 0.0, 0.0), grip: 0 },
        }
    };
    let setup = Setup { hand: Hand::soft(Arc::new(script), softness), ..Setup::new("fake-1") };
    let mut bench = Bench::new(setup, None, false);
    bench.worker.begin().unwrap();
    bench.run(Duration::from_secs(4));
    assert!((bench.fake.grip().0.x - 0.03).abs() < 1e-4);

    // The hand lets go of 3 cm before the wall, and wants to be 1 cm behind it.
    aim.store(target.x);
    let energy = |(position, velocity): (Vector3<f64>, Vector3<f64>)| {
        let depth = (-position.x).max(0.0);
        0.5 * (softness.mass * velocity.norm_squared()
            + softness.stiffness * (position - target).norm_squared()
            + stiffness * depth * depth)
    };
    let first = energy(bench.fake.grip());
    let (mut largest, mut depths) = (0.0_f64, vec![0.0; delay]);
    for _ in 0..5000 {
        depths.push((-bench.status.read().sample.position.x).max(0.0));
        let depth = depths[depths.len() - 1 - delay];
        bench.push(Vector3::new(stiffness * depth, 0.0, 0.0));
        bench.step();
        largest = largest.max(energy(bench.fake.grip()));
    }
    (largest / first, -bench.fake.grip().0.x)
}

#[test]
fn a_virtual_wall_is_passive() {
    let (largest, depth) = push_wall(1000.0, 0);
    assert!(largest <= 1.0 + 1e-3, "energy grew to {largest} of the first");
    // Spring of the hand against spring of the wall.
    assert!((depth - 0.01 * 100.0 / 1100.0).abs() < 1e-4, "{depth} m");
}

#[test]
fn a_wall_that_is_felt_late_is_not_passive() {
    let (largest, _) = push_wall(1000.0, 30);
    assert!(largest > 1.2, "the measure of energy sees nothing: {largest}");
}

#[test]
fn forces_of_the_host_reach_the_device_within_two_exchanges() {
    let mut bench = Bench::ready(Vector3::zeros());
    let force = DeviceForce { force: Vector3::new(4.0, 0.0, 0.0), ..DeviceForce::zero() };
    bench.push(force.force);
    let asked = bench.clock.now();
    bench.step();
    let first = bench.fake.commands().into_iter().find(|c| c.motors != [0; 3]).unwrap();
    assert!(first.time - asked < 2 * MS);
}
