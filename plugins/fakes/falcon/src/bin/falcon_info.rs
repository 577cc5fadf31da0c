//! Lists Falcons, brings one to life and shows what it senses: the first thing to try with the hardware.

use std::collections::BTreeMap;
use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::thread::sleep;
use std::time::{Duration, Instant};

use ambf_device::files::{close_output, print, WriteError};
use ambf_device::text::lines;
use ambf_device::{DeviceError, DeviceForce, DeviceLog, Driver, InputDevice, Setting, Settings};
use falcon::{State, Status, MODEL};
use nalgebra::Vector3;
use thiserror::Error;

const HELP: &str = "\
falcon_info: shows Novint Falcons

  falcon_info                     list them
  falcon_info --watch [options]   open one and show what it senses, until Ctrl-C

  --port P              which one, as listed; else the first
  --firmware FILE       firmware to send if it does not run yet (nvent_firmware.bin)
  --event-character     ask for replies as soon as they are complete
  --z0 M                distance of the origin from the base, m (0.125)
  --push X,Y,Z          force to push with once it is homed, N, at most 3: x to you, y right, z up
  --seconds S           end after so long
  --fake                a Falcon in software instead of USB
";

/// Largest force of `--push`, N: enough to feel its direction, too little to hurt.
const GENTLE: f64 = 3.0;

#[derive(Default)]
struct Options {
    watch: bool,
    settings: BTreeMap<String, Setting>,
    push: Vector3<f64>,
    seconds: Option<f64>,
}

impl Options {
    fn set(&mut self, key: &str, option: &str, value: &str) {
        self.settings.insert(key.to_owned(), Setting { value: value.to_owned(), place: option.to_owned() });
    }

    fn parse(mut arguments: impl Iterator<Item = String>) -> Result<Self, String> {
        let mut options = Self::default();
        while let Some(option) = arguments.next() {
            let mut value = || arguments.next().ok_or(format!("{option} needs a value"));
            match option.as_str() {
                "--watch" => options.watch = true,
                "--fake" => options.set("transport", &option, "fake"),
                "--event-character" => options.set("event character", &option, "true"),
                "--port" | "--firmware" | "--z0" => {
                    let value = value()?;
                    options.set(&option[2..], &option, &value);
                }
                "--push" => options.push = push(&value()?)?,
                "--seconds" => {
                    let seconds: Option<f64> = value()?.parse().ok().filter(|seconds| *seconds >= 0.0);
                    options.seconds = Some(seconds.ok_or("--seconds needs a number that is not negative")?);
                }
                "--help" | "-h" => return Err(String::from(HELP)),
                _ => return Err(format!("{option} is unknown\n\n{HELP}")),
            }
        }
        Ok(options)
    }
}

fn push(text: &str) -> Result<Vector3<f64>, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) if Vector3::new(x, y, z).norm() <= GENTLE => Ok(Vector3::new(x, y, z)),
        _ => Err(format!("--push is `{text}`, expected three numbers as 0,0,1 of a length of at most {GENTLE}")),
    }
}

fn main() {
    let options = Options::parse(std::env::args().skip(1)).unwrap_or_else(|text| {
        eprintln!("{}", lines(text.trim_end()));
        exit(2);
    });
    match show(&options) {
        // Who has seen enough ends this, with the motors at rest.
        Err(InfoError::Print(error)) if error.is_unread() => (),
        Err(error) => {
            eprintln!("{}", lines(&error.to_string()));
            exit(1);
        }
        Ok(()) => (),
    }
}

/// Why nothing more is shown.
#[derive(Debug, Error)]
enum InfoError {
    /// Error when the device does not work.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// Error when what is shown does not arrive.
    #[error(transparent)]
    Print(#[from] WriteError),
}

fn show(options: &Options) -> Result<(), InfoError> {
    let settings = Settings::new(options.settings.clone(), std::path::PathBuf::new());
    let driver = fake_falcon::driver();
    let found = driver.find(MODEL, &settings)?;
    for info in &found {
        print(&format!("{} {}\n", info.model, info.identity))?;
    }
    let Some(info) = found.first() else {
        return Ok(print("No Falcon. Is it plugged in and switched on? `lsusb -d 0403:cb48` should show it.\n")?);
    };
    if !options.watch {
        return Ok(());
    }
    let stop = Arc::new(AtomicBool::new(false));
    let stopping = Arc::clone(&stop);
    // A program that is killed would leave the last force on the motors.
    ctrlc::set_handler(move || stopping.store(true, Ordering::Relaxed))
        .map_err(|error| DeviceError::Unavailable(format!("signals can't be caught: {error}")))?;
    let (log, sentences) = DeviceLog::new();
    let mut device = driver.open_falcon(info, &settings, &log)?;
    let force = DeviceForce { force: options.push, ..DeviceForce::zero() };
    let begin = Instant::now();
    let mut last = (begin, 0);
    while !stop.load(Ordering::Relaxed) && options.seconds.is_none_or(|end| begin.elapsed().as_secs_f64() < end) {
        for sentence in sentences.try_iter() {
            print(&format!("{sentence}\n"))?;
        }
        if options.push != Vector3::zeros() {
            device.write(&force)?;
        }
        device.read()?;
        if last.0.elapsed() > Duration::from_millis(200) {
            let status = device.status();
            let rate = (status.exchanges - last.1) as f64 / last.0.elapsed().as_secs_f64();
            print(&format!("{}\n", line(&status, rate)))?;
            last = (Instant::now(), status.exchanges);
        }
        sleep(Duration::from_millis(10));
    }
    device.close();
    Ok(close_output()?)
}

fn line(status: &Status, rate: f64) -> String {
    let state = match status.state {
        State::Away => "away",
        State::Loading => "loading",
        State::Homing => "homing",
        _ => "ready",
    };
    let marks: String = status.homed.iter().map(|homed| if *homed { 'x' } else { '-' }).collect();
    let position = match status.sample.valid {
        true => status.sample.position.iter().map(|x| format!("{:7.2}", x * 1e3)).collect(),
        false => String::from("      -      -      -"),
    };
    let [top, right, left] = status.encoders;
    format!(
        "{state:8} marks {marks}  encoders {top:6} {right:6} {left:6}  position {position} mm  buttons {:04b}  {rate:5.0} Hz",
        status.sample.buttons
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Options, String> {
        Options::parse(text.split_whitespace().map(String::from))
    }

    #[test]
    fn options_become_settings() {
        let options = parse("--watch --fake --firmware a.bin --push 0,0,-1.5 --seconds 2").unwrap();
        assert!(options.watch && options.push == Vector3::new(0.0, 0.0, -1.5) && options.seconds == Some(2.0));
        let settings = Settings::new(options.settings, "dir".into());
        assert_eq!(settings.text("transport"), Some("fake"));
        assert_eq!(settings.path("firmware"), Some("dir/a.bin".into()));
    }

    #[test]
    fn wrong_options_are_named() {
        assert!(parse("--port").err().unwrap().contains("--port needs a value"));
        assert!(parse("--wath").err().unwrap().contains("--wath is unknown"));
        for push in ["1,2", "a,b,c", "3,3,3", "NaN,0,0"] {
            assert!(parse(&format!("--push {push}")).err().unwrap().contains("three numbers"), "{push}");
        }
    }
}
