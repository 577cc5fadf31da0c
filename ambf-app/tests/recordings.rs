//! `ambf_batch --record` and `--replay`: what a replay writes, and what becomes of a recording when something fails.

mod batch_common;

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use batch_common::{resources, Folder, Ran};

const MODEL: &str = "bodies: [BODY Free]\nBODY Free: {name: Free, mass: 2, inertia: {ix: 0.1, iy: 0.2, iz: 0.4}, \
    location: {position: {x: 0, y: 0, z: 3}}}\n";

/// A body that is pushed about, in the shipped world.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("m.yaml", MODEL);
    folder.write("c.txt", "0|1400|WR|Free|0.3 0.1 0 0 0 0.01\n");
    folder
}

fn scene() -> String {
    format!("-a m.yaml --world {} --commands c.txt", resources().join("world/world.yaml").display())
}

fn read(folder: &Folder, name: &str) -> String {
    std::fs::read_to_string(folder.path().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn refused(ran: &Ran, status: i32, part: &str) {
    assert!(ran.status == status && ran.stderr.contains(part), "{part}: {ran:?}");
}

#[test]
fn a_replay_writes_the_same_traces() {
    for profile in ["legacy", "accurate"] {
        let folder = folder();
        let outputs = |name: &str| format!("--trace {name} --energy {name}.csv --every 7");
        folder.succeed(&format!("{} --profile {profile} --steps 1500 {} --record a.mcap", scene(), outputs("a")));
        let replayed = folder.succeed(&format!("--replay a.mcap --json {}", outputs("b")));
        assert!(replayed.stdout.contains("\"steps\":1500"), "{}", replayed.stdout);
        assert!(!replayed.stderr.contains("is not whole"), "{replayed:?}");
        assert_eq!(read(&folder, "a_bodies.csv"), read(&folder, "b_bodies.csv"));
        assert_eq!(read(&folder, "a.csv"), read(&folder, "b.csv"));
        refused(&folder.run(&format!("{} --steps 1 --record a.mcap", scene())), 2, "not overwritten");
    }
}

#[test]
fn the_user_takes_over_where_it_is_said() {
    let folder = folder();
    folder.succeed(&format!("{} --steps 2000 --trace a --record a.mcap", scene()));
    // The same commands from step 500 on.
    folder.write("c.txt", "0|900|WR|Free|0.3 0.1 0 0 0 0.01\n");
    let arguments = "--replay a.mcap --continue-at 0.4995 --steps 1500 --commands c.txt --trace b --record b.mcap";
    folder.succeed(arguments);
    assert_eq!(read(&folder, "a_bodies.csv"), read(&folder, "b_bodies.csv"));
    // The last state is there also where it is no multiple of `--every`.
    let last = |name: &str| read(&folder, name).lines().next_back().map(str::to_owned);
    folder.succeed(&arguments.replace("--trace b --record b.mcap", "--trace d --every 700"));
    assert_eq!(last("d_bodies.csv"), last("a_bodies.csv"));
    folder.succeed("--replay a.mcap --continue-at 1.2345 --steps 0 --trace d --every 700");
    let left = last("d_bodies.csv").expect("a state");
    assert!(left.starts_with("1235,") && read(&folder, "a_bodies.csv").lines().any(|line| line == left), "{left}");
    // And the recording of both is a recording.
    folder.succeed("--replay b.mcap --trace c");
    assert_eq!(read(&folder, "a_bodies.csv"), read(&folder, "c_bodies.csv"));
}

#[test]
fn changed_files_are_named_and_another_motion_too() {
    let folder = folder();
    folder.succeed(&format!("{} --steps 2500 --record a.mcap", scene()));
    folder.write("m.yaml", &MODEL.replace("mass: 2", "mass: 3"));
    refused(&folder.run("--replay a.mcap"), 2, "m.yaml: has changed since the recording");
    refused(&folder.run("--replay a.mcap --changed-files"), 4, "after iteration 1000 (");
    refused(&folder.run("--replay m.yaml"), 2, "is no recording of AMBF");
    refused(&folder.run("--replay none.mcap"), 2, "none.mcap: No such file");
}

#[test]
fn a_run_that_does_not_begin_leaves_no_recording() {
    let folder = folder();
    folder.write("c.txt", "0|900|WR|Nobody|0 0 0 0 0 0\n");
    let arguments = format!("{} --steps 10 --record a.mcap", scene());
    refused(&folder.run(&arguments), 2, "Nobody");
    assert!(!folder.path().join("a.mcap").exists());
    folder.write("c.txt", "0|900|WR|Free|0 0 0 0 0 0\n");
    folder.succeed(&arguments);
    assert!(folder.path().join("a.mcap").exists());
}

#[test]
fn a_full_disk_ends_the_recording_and_not_the_run() {
    let folder = folder();
    // Files may have 64 kB at most, as on a disk on which there is no more room. Wrenches that differ cannot be made much smaller.
    let lines = (0..6000).map(|step: u32| {
        let x = f64::from(step).sin();
        format!("{step}|{step}|WR|Free|{x} {} {} 0 0 0\n", x.cos(), x.tan().atan())
    });
    folder.write("c.txt", &lines.collect::<String>());
    let limit = "trap '' XFSZ; ulimit -f 64; exec \"$0\" \"$@\"";
    let ran = folder.run_in_shell(limit, &format!("{} --steps 6000 --json --record a.mcap", scene()));
    refused(&ran, 2, "File too large");
    assert!(ran.stderr.contains("the simulation goes on"), "{ran:?}");
    let replayed = folder.run("--replay a.mcap --json");
    assert_eq!(replayed.status, 0, "what was written is readable: {replayed:?}");
    assert!(replayed.stderr.contains("is not whole"), "{replayed:?}");
}

#[test]
fn a_killed_program_leaves_a_readable_file() {
    let folder = folder();
    let mut child = Command::new(env!("CARGO_BIN_EXE_ambf_batch"))
        .args(format!("{} --steps 1000000000 --record a.mcap", scene()).split_whitespace())
        .current_dir(folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("ambf_batch runs");
    // Until what has been written holds enough.
    let (file, copy, begin) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"), Instant::now());
    loop {
        assert!(begin.elapsed() < Duration::from_secs(60), "nothing is written");
        std::thread::sleep(Duration::from_millis(200));
        let is_copied = std::fs::copy(&file, &copy).is_ok();
        if is_copied && folder.run("--replay b.mcap --steps 100 --json").stdout.contains("\"steps\":100") {
            break;
        }
    }
    child.kill().expect("it runs");
    child.wait().expect("it ends");
    let replayed = folder.succeed("--replay a.mcap --steps 100 --json");
    assert!(replayed.stdout.contains("\"steps\":100"), "{}", replayed.stdout);
    assert!(replayed.stderr.contains("is not whole: its program was killed"), "{replayed:?}");
}

/// `ambf_simulator` without ROS and windows, in a folder.
struct Live {
    child: std::process::Child,
    said: std::sync::mpsc::Receiver<String>,
    all: Vec<String>,
}

impl Live {
    fn start(folder: &Folder, arguments: &str) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_ambf_simulator"))
            .args(["--no_ros", "-g", "0"])
            .args(arguments.split_whitespace())
            .current_dir(folder.path())
            .env("AMBF_RESOURCES", resources())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("ambf_simulator runs");
        let (sender, said) = std::sync::mpsc::channel();
        let streams: [Box<dyn std::io::Read + Send>; 2] =
            [Box::new(child.stdout.take().expect("piped")), Box::new(child.stderr.take().expect("piped"))];
        for stream in streams {
            let (sender, lines) = (sender.clone(), std::io::BufRead::lines(std::io::BufReader::new(stream)));
            std::thread::spawn(move || lines.map_while(Result::ok).try_for_each(|line| sender.send(line)));
        }
        Self { child, said, all: Vec::new() }
    }

    /// Waits for a line that holds `part`.
    fn until(&mut self, part: &str) -> String {
        loop {
            match self.said.recv_timeout(Duration::from_secs(60)) {
                Ok(line) => {
                    self.all.push(line.clone());
                    if line.contains(part) {
                        return line;
                    }
                }
                Err(error) => panic!("{part}: {error}: {:#?}", self.all),
            }
        }
    }

    /// Ctrl+C; the exit status.
    fn interrupt(mut self) -> Option<i32> {
        let id = self.child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &id]).status().expect("kill runs").success());
        self.child.wait().expect("it ends").code()
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The hash of the last state of a recording, and how many updates it has.
fn last_state(folder: &Folder, name: &str) -> (String, u64) {
    let mut replay = ambf_recording::Replay::open(&folder.path().join(name)).expect("a recording");
    let (mut simulation, _) = replay.load(false).expect("its scene");
    while replay.step(&mut simulation).expect("the same") != ambf_recording::Step::End {}
    (format!("{:016x}", simulation.state_hash()), replay.updates())
}

#[test]
fn the_simulator_replays_to_the_same_state_bit_for_bit() {
    for profile in ["legacy", "accurate"] {
        let folder = folder();
        folder.succeed(&format!("{} --profile {profile} --steps 2500 --trace a --record a.mcap", scene()));
        let (hash, updates) = last_state(&folder, "a.mcap");
        assert_eq!(updates, 2500);
        let begin = Instant::now();
        let mut live = Live::start(&folder, "--replay a.mcap -s 5 --record b.mcap");
        assert!(live.until("replaying a.mcap").contains("2500 updates"));
        let line = live.until("a.mcap is over");
        assert!(begin.elapsed() > Duration::from_millis(450), "five times as fast as it was, not more");
        assert!(line.contains(&hash) && line.contains("2500 updates") && line.contains("is paused"), "{line}: {hash}");
        assert_eq!(live.interrupt(), Some(0));
        // What was recorded of the replay is the same recording.
        folder.succeed("--replay b.mcap --trace b");
        assert_eq!(read(&folder, "a_bodies.csv"), read(&folder, "b_bodies.csv"));
    }
}

#[test]
fn the_simulator_goes_on_where_it_is_said() {
    let folder = folder();
    folder.succeed(&format!("{} --steps 2500 --record a.mcap", scene()));
    let mut live = Live::start(&folder, "--replay a.mcap --continue-at 1.9995 -t 1 --record b.mcap");
    let line = live.until("a.mcap is left");
    assert!(line.contains("2000 updates") && line.contains("takes commands"), "{line}");
    std::thread::sleep(Duration::from_millis(1000));
    assert_eq!(live.interrupt(), Some(0));
    // The recording of both is a recording.
    let (_, updates) = last_state(&folder, "b.mcap");
    assert!(updates > 2100, "{updates}");
}

#[test]
fn the_simulator_names_another_motion_as_batch_runs_do() {
    let folder = folder();
    folder.succeed(&format!("{} --steps 2500 --record a.mcap", scene()));
    folder.write("m.yaml", &MODEL.replace("mass: 2", "mass: 3"));
    let mut live = Live::start(&folder, "--replay a.mcap -s 100");
    live.until("m.yaml: has changed since the recording");
    assert_eq!(live.child.wait().expect("it ends").code(), Some(2));
    let mut live = Live::start(&folder, "--replay a.mcap -s 100 --changed-files");
    let line = live.until("the replay differs from the recording: after iteration 1000 (");
    assert!(line.contains("is paused"), "{line}");
    assert_eq!(live.interrupt(), Some(4));
}

#[test]
fn a_recording_that_is_cut_off_is_replayed_as_far_as_it_goes() {
    let folder = folder();
    folder.succeed(&format!("{} --steps 20000 --record a.mcap", scene()));
    let whole = std::fs::read(folder.path().join("a.mcap")).expect("written");
    std::fs::write(folder.path().join("b.mcap"), &whole[..whole.len() * 2 / 3]).expect("written");
    let mut live = Live::start(&folder, "--replay b.mcap -s 1000");
    live.until("is not whole");
    live.until("is over");
    assert_eq!(live.interrupt(), Some(0));
    std::fs::write(folder.path().join("c.mcap"), &whole[..40]).expect("written");
    let mut live = Live::start(&folder, "--replay c.mcap");
    live.until("is no recording of AMBF");
    assert_eq!(live.child.wait().expect("it ends").code(), Some(2));
}

#[test]
fn a_recording_that_waits_for_a_reset_in_vain_leaves_no_file() {
    let folder = folder();
    let mut live = Live::start(&folder, "-a m.yaml --record a.mcap --record-from-reset");
    live.until("loaded");
    let id = live.child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().expect("kill runs").success());
    live.until("a.mcap is not written");
    assert_eq!(live.child.wait().expect("it ends").code(), Some(0));
    assert!(!folder.exists("a.mcap"));
}

#[test]
fn times_are_those_of_a_recording_that_begins_late() {
    let folder = folder();
    folder.succeed(&format!("{} --steps 2000 --record a.mcap", scene()));
    let mut replay = ambf_recording::Replay::open(&folder.path().join("a.mcap")).expect("a recording");
    let (mut simulation, _) = replay.load(false).expect("its scene");
    while replay.step(&mut simulation).expect("the same") != ambf_recording::Step::End {}
    // A reset keeps the clock.
    simulation.reset_world();
    let late = folder.path().join("late.mcap");
    let writer = ambf_recording::Writer::start(&late, &mut simulation, "test", true).expect("after a reset");
    (0..500).for_each(|_| simulation.iterate(0.001).expect("sound"));
    simulation.stop_recording();
    assert_eq!(writer.finish().problem, None);
    let replay = ambf_recording::Replay::open(&late).expect("a recording");
    assert!((replay.start_time() - 2.0).abs() < 1e-9 && (replay.end_time() - 2.5).abs() < 1e-9);
    refused(
        &folder.run("--replay late.mcap --continue-at 1 --steps 1"),
        1,
        "--continue-at 1: late.mcap goes from 2.000",
    );
    let ran = folder.succeed("--replay late.mcap --continue-at 2.2495 --steps 0 --json");
    assert!(ran.stdout.contains("\"steps\":250"), "{}", ran.stdout);
    for option in ["--continue-at", "--replay-from"] {
        let mut live = Live::start(&folder, &format!("--replay late.mcap {option} 1"));
        live.until(&format!("{option} 1: late.mcap goes from 2"));
        assert_eq!(live.child.wait().expect("it ends").code(), Some(2));
    }
    let mut live = Live::start(&folder, "--replay late.mcap --replay-from 2.4");
    live.until("500 updates from 2.000 to 2.500 s");
    live.until("late.mcap is over");
}

/// What moves a gripper by a hand's Falcon, which feels it.
const FALCON: &str = "input devices: [Right Hand]\n\
    Right Hand: {hardware name: Falcon, driver settings: {transport: fake}, simulated multibody: tool.yaml, \
      workspace scaling: 5, controller gain: {linear: {P: 200, I: 0, D: 25}}, \
      haptic gain: {linear: 100, angular: 0}, button mapping: {a1: 1, g1: 0}, pair cameras: [main_camera]}\n";

const TOOL: &str = "bodies: [BODY Tool]\nnamespace: /t/\n\
    BODY Tool: {name: Tool, mass: 0.2, collision shape: Sphere, collision geometry: {radius: 0.1}}\n";

#[test]
fn what_a_device_did_is_replayed_without_it() {
    for profile in ["legacy", "accurate"] {
        let folder = folder();
        folder.write("devices.yaml", FALCON);
        folder.write("tool.yaml", TOOL);
        folder.write(
            "launch.yaml",
            &format!(
                "world config: {0}/world/world.yaml\ncolor config: {0}/colors.yaml\n\
                 input devices config: devices.yaml\nmultibody configs: [m.yaml]\n",
                resources().canonicalize().expect("resources").display()
            ),
        );
        let arguments = "--launch_file launch.yaml -l 0 -i 0 -e 1 --record a.mcap";
        let mut live = Live::start(&folder, &format!("{arguments} --profile {profile}"));
        live.until("device Right Hand [Falcon");
        // It is homed within two seconds, then the hand moves in circles and presses buttons.
        std::thread::sleep(Duration::from_millis(5000));
        assert_eq!(live.interrupt(), Some(0));

        // Without any device: the hash of each thousandth state is compared, or the replay ends with status 4.
        let replayed = folder.succeed("--replay a.mcap --json");
        assert!(!replayed.stderr.contains("is not whole"), "{replayed:?}");
        let mut replay = ambf_recording::Replay::open(&folder.path().join("a.mcap")).expect("a recording");
        let (mut simulation, _) = replay.load(false).expect("its scene");
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        while replay.step(&mut simulation).expect("the same") != ambf_recording::Step::End {
            // The end-effector comes last.
            let tool = simulation.snapshot().bodies.iter().last().expect("it is there").origin;
            (low, high) = (low.min(tool[1]), high.max(tool[1]));
        }
        let updates = replay.updates();
        assert!(replayed.stdout.contains(&format!("\"steps\":{updates}")) && updates > 2000, "{}", replayed.stdout);
        assert!(high - low > 0.05, "the hand moved it: {low} to {high} m");
        let hash = format!("{:016x}", simulation.state_hash());

        // In real time, with the state of the end.
        let mut live = Live::start(&folder, "--replay a.mcap -s 20");
        let line = live.until("a.mcap is over");
        assert!(line.contains(&hash), "{line}: {hash}");
    }
}
