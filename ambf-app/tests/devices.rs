//! `ambf_simulator` with input devices, as a user runs it.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::process::{kill_process, Pid, Signal};
use tempfile::TempDir;

const DEVICES: &str = "input devices: [Left Hand, Right Hand, Gone, Faulty]\n\
    Left Hand: {hardware name: Mock, root link: BODY Link, haptic gain: {linear: 10, angular: 0}, enable on button: false, \
      button mapping: {next mode: 4}, driver settings: {rate: 250, buttons: '4@0.5-0.6'}}\n\
    Right Hand: {hardware name: Mock, simulated multibody: free.yaml, workspace scaling: 5}\n\
    Gone: {hardware name: Falcon, driver: none, root link: BODY Link}\n\
    Faulty: {hardware name: Mock, simulated multibody: free.yaml, driver settings: {faults: nan@0.5-0.6}}\n";

const FREE: &str = "bodies: [BODY Tool]\nnamespace: /t/\n\
    BODY Tool: {name: Tool, mass: 1, collision shape: Sphere, collision geometry: {radius: 0.1}}\n";

/// A folder with a launch file.
struct Folder(TempDir);

impl Folder {
    fn new(devices: Option<&str>) -> Self {
        let folder = TempDir::new().expect("a temporary folder");
        let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources").canonicalize().expect("resources");
        let resources = resources.display();
        let launch = format!(
            "world config: {resources}/world/world.yaml\ncolor config: {resources}/colors.yaml\n\
             input devices config: devices.yaml\nmultibody configs: [{resources}/models/pendulum.yaml]\n\
             device plugins: [{{name: gone, filename: libgone.so}}]\n"
        );
        std::fs::write(folder.path().join("launch.yaml"), launch).expect("written");
        std::fs::write(folder.path().join("free.yaml"), FREE).expect("written");
        if let Some(devices) = devices {
            std::fs::write(folder.path().join("devices.yaml"), devices).expect("written");
        }
        Self(folder)
    }

    /// Runs the simulator until it has printed all of `expected`, then ends it by SIGINT; all that it printed.
    fn run(&self, options: &[&str], expected: &[&str]) -> String {
        let mut child = Command::new(env!("CARGO_BIN_EXE_ambf_simulator"))
            .args(["--no_ros", "-g", "0", "-l", "0", "--launch_file"])
            .arg(self.0.path().join("launch.yaml"))
            .args(options)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the simulator starts");
        let text = Arc::new(Mutex::new(String::new()));
        let readers = [
            collect(child.stdout.take().expect("it is piped"), &text),
            collect(child.stderr.take().expect("it is piped"), &text),
        ];
        let printed = || text.lock().expect("no reader panics").clone();
        let begin = Instant::now();
        while let Some(missing) = expected.iter().find(|line| !printed().contains(**line)) {
            if begin.elapsed() > Duration::from_secs(60) {
                let _ = child.kill();
                panic!("`{missing}` is not in\n{}", printed());
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        // Twice, as a script and its terminal do.
        for _ in 0..2 {
            kill_process(Pid::from_raw(child.id() as i32).expect("a process"), Signal::INT).expect("it is there");
        }
        let status = child.wait().expect("it ends");
        readers.into_iter().for_each(|reader| reader.join().expect("no reader panics"));
        assert_eq!(status.code(), Some(0), "{}", printed());
        printed()
    }
}

fn collect(stream: impl Read + Send + 'static, text: &Arc<Mutex<String>>) -> JoinHandle<()> {
    let text = Arc::clone(text);
    std::thread::spawn(move || {
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            *text.lock().expect("no reader panics") += &(line + "\n");
        }
    })
}

#[test]
fn devices_run_and_their_rates_are_printed_at_the_end() {
    let folder = Folder::new(Some(DEVICES));
    let expected = [
        "device plugin gone (libgone.so) is left out: no such library",
        "there is no input device 9",
        "device `Gone` is left out: there is no driver `none`",
        "device Left Hand [Mock 0]",
        "device Right Hand [Mock 1]",
        "device Faulty [Mock 2]",
        "mode of the device buttons: GRIPPER_JAW_CONTROL",
        "not finite",
        "back after",
    ];
    let text = folder.run(&["-i", "0, 1,2,3,9", "-e", "1"], &expected);
    for name in ["Left Hand", "Right Hand", "Faulty"] {
        let is_last = |line: &&str| line.starts_with(&format!("{name} [Mock]: ")) && line.contains("(periods p50 ");
        let last = text.lines().rev().find(is_last).unwrap_or_else(|| panic!("no rates of {name} in\n{text}"));
        assert!(last.ends_with(" Hz"), "{last}");
    }
    assert_eq!(text.lines().last(), Some("stopped"));
}

#[test]
fn a_device_file_that_is_missing_is_said_and_asked_for_only_when_it_is_needed() {
    let folder = Folder::new(None);
    let text = folder.run(&["-n", "1"], &["devices.yaml", "the simulation runs without", "Ctrl+C ends"]);
    assert!(text.contains("stopped"), "{text}");
    let text = folder.run(&[], &["Ctrl+C ends"]);
    assert!(!text.contains("devices.yaml"), "{text}");
}
