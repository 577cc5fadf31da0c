//! Devices in their threads: none holds up another, and none pushes when it must not.

mod device_common;

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use ambf_core::control::Profile;
use ambf_core::device::host::{DeviceEvent, DeviceHost, DeviceState, HostOptions};
use ambf_core::sim::{Runner, RunnerOptions};
use device_common::{coupled, puppets, until, Folder, Opening, Trouble, BOTH, BOXES};

fn open(entries: &str, drivers: &ambf_core::device::Drivers) -> (DeviceHost, Vec<String>) {
    let entries = Folder::new().entries(entries);
    DeviceHost::open(&entries.iter().collect::<Vec<_>>(), drivers, &HostOptions::default())
}

#[test]
fn equal_devices_are_claimed_one_by_one_and_the_others_never_opened() {
    let (puppets, drivers) = puppets(&["one", "two", "three"]);
    let (host, problems) = open(BOTH, &drivers);
    assert!(problems.is_empty(), "{problems:?}");
    let identities: Vec<_> = host.status().into_iter().map(|status| status.identity).collect();
    assert_eq!(identities, ["one", "two"]);
    host.stop();
    let opened: Vec<_> = puppets.iter().map(|puppet| (puppet.opened(), puppet.closed())).collect();
    assert_eq!(opened, [(1, 1), (1, 1), (0, 0)]);
}

#[test]
fn an_identity_chooses_the_unit() {
    let (puppets, drivers) = puppets(&["one", "two"]);
    let text = "input devices: [A, B, C]\nA: {hardware name: Puppet, identity: two, root link: x}\n\
                B: {hardware name: Puppet, root link: x}\nC: {hardware name: Puppet, identity: nine, root link: x}\n";
    let (host, problems) = open(text, &drivers);
    let identities: Vec<_> = host.status().into_iter().map(|status| status.identity).collect();
    assert_eq!(identities, ["two", "one"]);
    assert!(problems.len() == 1 && problems[0].contains("`C`") && problems[0].contains("nine"), "{problems:?}");
    drop(host);
    assert!(puppets.iter().all(|puppet| puppet.closed() == 1));
}

#[test]
fn what_is_missing_is_said_once_and_the_others_go_on() {
    let (puppets, drivers) = puppets(&["one", "two"]);
    puppets[0].set_opening(Opening::Unavailable);
    let text = "input devices: [A, B, C, D, E]\nA: {hardware name: Puppet, root link: BODY left}\n\
                B: {hardware name: Falcon, root link: BODY left}\nC: {hardware name: Puppet, root link: BODY right}\n\
                D: {hardware name: Puppet, root link: x}\nE: {hardware name: Puppet, driver: none, root link: x}\n";
    let (folder, (mut host, problems)) = (Folder::new(), open(text, &drivers));
    let reasons = ["no driver serves `Falcon`", "all 2 `Puppet` are taken", "no driver `none`", "no library"];
    assert_eq!(problems.len(), 4, "{problems:?}");
    for (problem, reason) in problems.iter().zip(reasons) {
        assert!(problem.contains(reason) && problem.contains("left out"), "{problem}");
    }
    let mut simulation = folder.simulation(&[BOXES], Profile::Legacy);
    assert!(simulation.add_devices(&mut host).is_empty());
    until("the good one runs", || puppets[1].reads() > 10);
    assert_eq!(puppets[0].opened(), 0);
}

#[test]
fn a_device_without_an_end_effector_is_closed() {
    let (puppets, drivers) = puppets(&["one"]);
    let (mut host, problems) = open("input devices: [A]\nA: {hardware name: Puppet, root link: nowhere}\n", &drivers);
    assert!(problems.is_empty(), "{problems:?}");
    let mut simulation = Folder::new().simulation(&[BOXES], Profile::Legacy);
    let said = simulation.add_devices(&mut host);
    assert!(said.len() == 1 && said[0].contains("nowhere") && said[0].contains("left out"), "{said:?}");
    until("it is closed", || puppets[0].closed() == 1);
    until("its thread has ended", || host.status()[0].state == DeviceState::Closed);
}

#[test]
fn a_device_that_does_not_answer_at_first_comes_later() {
    for opening in [Opening::Lost, Opening::Panic] {
        let (puppets, drivers) = puppets(&["one"]);
        puppets[0].set_opening(opening);
        let text = "input devices: [A]\nA: {hardware name: Puppet, root link: BODY left}\n";
        let (mut host, problems) = open(text, &drivers);
        assert!(problems.len() == 1 && problems[0].contains("waiting for it"), "{problems:?}");
        let mut simulation = Folder::new().simulation(&[BOXES], Profile::Legacy);
        assert!(simulation.add_devices(&mut host).is_empty());
        puppets[0].set_opening(Opening::Good);
        until("it runs", || puppets[0].reads() > 10);
        let mut news = host.news();
        until("it is said", || {
            news.extend(host.news());
            news.iter().any(|news| matches!(news.event, DeviceEvent::Back { .. }))
        });
        assert!(news.iter().any(|news| news.event == DeviceEvent::Said("open".into())), "{news:?}");
    }
}

/// Both boxes with devices, running.
struct Running {
    puppets: Vec<std::sync::Arc<device_common::Puppet>>,
    host: DeviceHost,
    runner: Runner,
}

const CLOCK: RunnerOptions = RunnerOptions { frequency: 1000.0, fixed_step: false, speed_factor: 1.0 };

impl Running {
    fn start() -> Self {
        let (puppets, drivers) = puppets(&["one", "two"]);
        let folder = Folder::new();
        let entries = folder.entries(BOTH);
        let mut simulation = folder.simulation(&[BOXES], Profile::Legacy);
        let host = coupled(&entries, &drivers, true, &mut simulation);
        let running = Self { puppets, host, runner: Runner::start(simulation, CLOCK) };
        until("both run", || running.puppets.iter().all(|puppet| puppet.reads() > 100));
        running
    }

    /// Moves the hands away from their end-effectors again and again, so that there is a force.
    fn pull(&self, device: usize) {
        static COUNT: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
        let n = COUNT.fetch_add(1, Ordering::Relaxed);
        self.puppets[device].set(|pose| pose.position.z = if (n / 100) & 1 == 0 { 0.5 } else { -0.5 });
    }

    fn until_force(&self, device: usize) {
        until("a force", || {
            self.pull(device);
            self.puppets[device].force() > 0.1
        });
    }
}

#[test]
fn trouble_of_one_device_does_not_reach_the_other_and_passes() {
    let mut running = Running::start();
    let troubles =
        [(Trouble::Block(Duration::from_secs(1)), 1), (Trouble::Panic, 2), (Trouble::NotFinite, 3), (Trouble::Lost, 4)];
    for (trouble, opened) in troubles {
        let [a, b] = [0, 1].map(|i| std::sync::Arc::clone(&running.puppets[i]));
        running.until_force(0);
        running.host.news();
        let before = b.reads();
        a.make(trouble);
        let expected = if opened == 1 { DeviceState::Stalled } else { DeviceState::Lost };
        until("the trouble is seen", || running.host.status()[0].state == expected);
        let reads = a.reads();
        until("the other goes on", || b.reads() > before + 100);
        assert_eq!(a.reads(), reads, "{trouble:?}: the other waited for it");
        assert_eq!(running.host.status()[1].state, DeviceState::Running);
        let news = running.host.news();
        let stalled = news.iter().any(|news| news.event == DeviceEvent::Stalled);
        let lost = news.iter().any(|news| matches!(news.event, DeviceEvent::Lost { .. }));
        assert_eq!((stalled, lost), (opened == 1, opened != 1), "{news:?}");
        assert!(opened == 1 || a.left() == 0.0, "{trouble:?}: closed with {} N", a.left());

        until("it comes back", || a.reads() > reads + 10);
        assert_eq!((a.opened(), a.closed()), (opened, opened - 1), "{trouble:?}");
        assert!(a.force() < 1.0, "{trouble:?}: the force comes back slowly, not with {} N", a.force());
    }
    let lines: Vec<String> = running.host.stop();
    assert!(lines.len() == 2 && lines.iter().all(|line| line.contains("[Puppet]") && line.contains("Hz")), "{lines:?}");
    assert!(running.runner.stop().is_some());
}

#[test]
fn no_force_while_paused() {
    // What the status says about the first device, N.
    let said = |running: &Running| running.host.status()[0].force.force.norm();
    let running = Running::start();
    until("the status says the force", || {
        running.pull(0);
        said(&running) > 0.1
    });
    running.runner.control().set_paused(true);
    until("no force", || {
        running.pull(0);
        running.puppets[0].force() == 0.0 && said(&running) == 0.0
    });
    let writes = running.puppets[0].writes.load(Ordering::Relaxed);
    until("it is still served", || {
        running.pull(0);
        assert_eq!(running.puppets[0].force(), 0.0);
        running.puppets[0].writes.load(Ordering::Relaxed) > writes + 50
    });
    running.runner.control().set_paused(false);
    running.until_force(0);
}

#[test]
fn no_force_when_physics_stalls_or_ends() {
    let (puppets, drivers) = puppets(&["one", "two"]);
    let folder = Folder::new();
    let mut simulation = folder.simulation(&[BOXES], Profile::Legacy);
    let host = coupled(&folder.entries(BOTH), &drivers, true, &mut simulation);
    let mut n = 0;
    until("a force", || {
        n += 1;
        puppets[0].set(|pose| pose.position.z = if (n / 100) & 1 == 0 { 0.5 } else { -0.5 });
        simulation.update(0.001).expect("finite");
        puppets[0].force() > 0.1
    });
    until("no force without new states", || puppets[0].force() == 0.0);
    drop(simulation);
    drop(host);
    assert_eq!(puppets[0].force(), 0.0);
}

#[test]
fn the_last_force_is_none_and_a_device_is_closed_once() {
    let running = Running::start();
    running.until_force(0);
    running.until_force(1);
    // With physics still running.
    let Running { puppets, host, runner } = running;
    assert_eq!(host.stop().len(), 2);
    for puppet in &puppets {
        assert_eq!((puppet.force(), puppet.closed(), puppet.opened()), (0.0, 1, 1));
        assert_eq!(puppet.writes_when_closed.load(Ordering::Relaxed), 0);
    }
    assert!(runner.stop().is_some());
}

#[test]
fn a_driver_that_never_returns_is_abandoned() {
    let running = Running::start();
    running.puppets[0].make(Trouble::Block(Duration::from_secs(20)));
    until("it stalls", || running.host.status()[0].state == DeviceState::Stalled);
    let begin = Instant::now();
    let lines = running.host.stop();
    assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
    assert!(lines[0].contains("abandoned") && !lines[1].contains("abandoned"), "{lines:?}");
    assert_eq!((running.puppets[0].closed(), running.puppets[1].closed()), (0, 1));
}

#[test]
fn an_opening_that_hangs_does_not_hold_up_the_others() {
    let (puppets, drivers) = puppets(&["one", "two"]);
    puppets[0].set_opening(Opening::Hang(Duration::from_secs(60)));
    let begin = Instant::now();
    let (mut host, problems) = open(BOTH, &drivers);
    assert!(begin.elapsed() < Duration::from_secs(20));
    assert!(problems.len() == 1 && problems[0].contains("waiting for it"), "{problems:?}");
    let mut simulation = Folder::new().simulation(&[BOXES], Profile::Legacy);
    assert!(simulation.add_devices(&mut host).is_empty());
    until("the other runs", || puppets[1].reads() > 10);
    assert_eq!(host.status()[0].state, DeviceState::Opening);
    assert!(host.stop()[0].contains("abandoned"));
}
