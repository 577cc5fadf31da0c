//! `fake_dvrk`: a ROS node that behaves like that of a da Vinci Research Kit, without a robot.

use std::io::Write;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_model::files::{print, Output};
use ambf_model::text::lines;
use clap::Parser;
use fake_dvrk::cli::{options, Arguments};
use fake_dvrk::{Fake, FakeOptions};

fn main() -> ExitCode {
    let ended = match Arguments::try_parse() {
        Err(error) if error.use_stderr() => error.exit(),
        // A help that is read by nobody any more is not worth a word.
        Err(help) => {
            print(&help.to_string()).or_else(|error| if error.is_unread() { Ok(()) } else { Err(error.to_string()) })
        }
        Ok(arguments) => run(&arguments),
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("fake_dvrk: {}", lines(&error));
            ExitCode::FAILURE
        }
    }
}

/// The file of wrenches is there when the fake ends.
fn run(arguments: &Arguments) -> Result<(), String> {
    let options = options(arguments)?;
    let mut file = arguments.wrenches.as_deref().map(Output::create).transpose().map_err(|error| error.to_string())?;
    let outcome = serve(arguments, options, file.as_mut());
    let written = file.map_or(Ok(()), Output::finish).map_err(|error| error.to_string());
    outcome.and(written)
}

fn serve(arguments: &Arguments, options: FakeOptions, mut file: Option<&mut Output>) -> Result<(), String> {
    if let Some(file) = &mut file {
        let heading = "time_s,arm,fx_N,fy_N,fz_N,tx_Nm,ty_Nm,tz_Nm";
        file.add(|file| writeln!(file, "{heading}")).map_err(|error| error.to_string())?;
    }
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&interrupted);
    ctrlc::set_handler(move || flag.store(true, Ordering::Release)).map_err(|error| error.to_string())?;

    let begin = Instant::now();
    let late = Duration::from_secs_f64(arguments.start_after);
    let fake = Fake::start(options).map_err(|error| error.to_string())?;
    let mut present = arguments.start_after <= 0.0;
    let (mut said, mut published) = (begin, 0);
    let mut counts = vec![0; arguments.arms.len()];
    let over = |fake: &Fake| {
        interrupted.load(Ordering::Acquire)
            || fake.has_ended()
            || arguments.duration.is_some_and(|most| begin.elapsed().as_secs_f64() >= most)
    };
    loop {
        let last = over(&fake);
        if !present && begin.elapsed() >= late {
            present = true;
            fake.start_node();
        }
        if let Some(file) = &mut file {
            let rows = |file: &mut Output| {
                for arm in &arguments.arms {
                    for shown in fake.fresh_wrenches(arm) {
                        let t = shown.at.saturating_duration_since(begin).as_secs_f64();
                        let (f, m) = (shown.wrench.force, shown.wrench.torque);
                        let row = [f.x, f.y, f.z, m.x, m.y, m.z].map(|x| x.to_string()).join(",");
                        writeln!(file, "{t:.6},{arm},{row}")?;
                    }
                }
                Ok(())
            };
            file.add(rows).map_err(|error| error.to_string())?;
        }
        let elapsed = said.elapsed().as_secs_f64();
        if !arguments.quiet && elapsed >= 1.0 {
            said = Instant::now();
            let samples = fake.published();
            let mut line = format!(
                "{:6.1} s  {:4.0} samples/s",
                begin.elapsed().as_secs_f64(),
                (samples - published) as f64 / elapsed
            );
            published = samples;
            for (arm, count) in arguments.arms.iter().zip(&mut counts) {
                let new = fake.wrench_count(arm);
                let force = fake.last_wrench(arm).map_or(0.0, |shown| shown.wrench.force.norm());
                line += &format!("  {arm}: {:4.0} wrenches/s, {force:.2} N", (new - *count) as f64 / elapsed);
                *count = new;
            }
            match print(&format!("{line}\n")) {
                // Nobody need read.
                Err(error) if !error.is_unread() => return Err(error.to_string()),
                _ => (),
            }
        }
        if last {
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}
