//! The running simulator, watched: start-up, memory, rates, overload, real time.

use std::time::{Duration, Instant};

use ambf_app::ros::messages::ambf_msgs::{RigidBodyState, Timing, WorldState};
use ambf_core::comm::{PublishSchedule, Published, Rates};
use rosrust::RosMsg;

use super::live::{distinct, gaps, physics_rate, rate, read, Arrival, Live};
use super::observed;
use super::plot::{bars, Figure};
use super::report::{goal, Section};
use super::ros_common::RawSubscriber;
use super::scenes::{self, Scene};
use super::statistics::{percentile, short, Spread};

/// Makes every topic publish at 2 kHz.
const FAST: [&str; 4] = ["--override_min_comm_freq", "2000", "--override_max_comm_freq", "2000"];

/// Topics that are listened to.
const LISTENED: usize = 5;

/// Time from the start of the program to states, and its memory; with a figure.
pub fn start_up(repetitions: usize, quick: bool) -> (Section, Figure) {
    let original = scenes::original().into_iter().filter(|scene| !quick || scene.name.contains("kuka"));
    let own =
        scenes::own().into_iter().filter(|scene| !quick || ["pendulum", "boxes200"].contains(&scene.name.as_str()));
    let mut section = Section {
        title: "simulator/start",
        intro: "From the start of the program to the first State of the world and of the last body, headless, embedded ROS master; \
                peak memory (VmHWM) and threads 1 s later. C++ without a window: 0.23–0.41 s to the world's State, 0.6–1.1 s to a \
                body's State with 200 boxes; threads: communicating objects + 6.",
        header: &["scene", "world, s", "last body, s", "peak, MB", "without ROS, MB", "threads", "C++ MB (observed, other run)"],
        ..Section::default()
    };
    let mut figure = Vec::new();
    let mut worst = 0.0_f64;
    for scene in own.chain(original) {
        let starts: Vec<Start> = (0..repetitions).map(|_| start(&scene)).collect();
        let spread = |value: fn(&Start) -> f64| Spread::of(starts.iter().map(value)).expect("at least one start");
        let (memory, alone) = (spread(|start| start.memory).median, memory_without_ros(&scene));
        let theirs = observed::peak_memory_mb(&scene.name);
        if let Some(theirs) = theirs {
            worst = worst.max(memory / theirs);
        }
        let row = vec![
            scene.name.clone(),
            format!("{:.2}", spread(|start| start.world)),
            format!("{:.2}", spread(|start| start.body)),
            short(memory),
            short(alone),
            short(spread(|start| start.threads).median),
            observed::cell(theirs),
        ];
        eprintln!("simulator/start {}", row.join(" | "));
        section.rows.push(row);
        figure.push((scene.name, vec![memory, alone, theirs.unwrap_or(f64::NAN)]));
    }
    if worst > 0.0 {
        let found = format!("at worst {:.0} % of the C++ program's", worst * 100.0);
        section.remarks.push(goal("a third of the C++ program's memory", worst <= 1.0 / 3.0, &found));
    }
    section.remarks.push("![Peak memory of each scene](figures/memory.svg)".into());
    let series = ["with ROS", "without ROS", "C++ (other run)"];
    (section, bars("Peak memory", "MB", &series, &figure))
}

struct Start {
    world: f64,
    body: f64,
    memory: f64,
    threads: f64,
}

fn start(scene: &Scene) -> Start {
    let last = scene.last_body();
    let live = Live::start(scene, &[]);
    first_state(&mut live.subscribe("/ambf/env/World/State"), |state: &WorldState| state.sim_step);
    let world = live.begin.elapsed().as_secs_f64();
    let body = last.map(|name| {
        first_state(&mut live.subscribe(&format!("{name}/State")), |state: &RigidBodyState| state.sim_step);
        live.begin.elapsed().as_secs_f64()
    });
    std::thread::sleep(Duration::from_secs(1));
    Start { world, body: body.unwrap_or(f64::NAN), memory: live.peak_memory(), threads: live.threads() }
}

/// Waits for a State that follows a step.
fn first_state<M: RosMsg>(subscriber: &mut RawSubscriber, step: impl Fn(&M) -> u32) {
    loop {
        let block = subscriber.read_block().expect("the stream goes on");
        if step(&M::decode(&block[..]).expect("a message of that type")) > 0 {
            return;
        }
    }
}

fn memory_without_ros(scene: &Scene) -> f64 {
    let live = Live::start(scene, &["--no_ros"]);
    // Loading the largest scenes takes a few seconds on a busy machine; memory no longer grows once it is done.
    let mut before = 0.0;
    loop {
        std::thread::sleep(Duration::from_secs(1));
        let memory = live.peak_memory();
        if memory == before {
            return memory;
        }
        before = memory;
    }
}

/// 5 of 200 topics, each at 2 kHz.
pub fn rates(time: Duration) -> Section {
    let mut section = Section {
        title: "ros/rate",
        intro: "200 boxes, every topic at 2 kHz, 5 of them subscribed by raw TCPROS readers on this machine, `-p 1000`. Gaps are those \
                between arrivals. *Bare timer*: what the same schedule reached meanwhile in a thread that does nothing else, which \
                tells how busy the machine was.",
        header: &[
            "scene", "published, Hz (lowest–highest)", "gap p50, ms", "gap p99, ms", "physics, Hz", "CPU of the simulator",
            "bare timer, Hz",
            "C++ Hz (observed, other run)",
        ],
        ..Section::default()
    };
    for (n, scene, theirs) in [
        (200, scenes::floating(200), "1270–1315, physics 970"),
        (200, scenes::boxes(200), "1140–1230, physics 22"),
        (50, scenes::boxes(50), "1970–1983, physics 950"),
    ] {
        let live = Live::start(&scene, &FAST);
        let topics: Vec<String> = (0..LISTENED).map(|i| format!("/ambf/env/Box{}/State", i * n / LISTENED)).collect();
        let subscribers: Vec<RawSubscriber> = topics.iter().map(|topic| live.subscribe(topic)).collect();
        let mut world = live.subscribe("/ambf/env/World/Timing");
        let cpu = live.cpu();
        let timing = std::thread::spawn(move || read::<Timing>(&mut world, time));
        let readers: Vec<_> = subscribers
            .into_iter()
            .map(|mut subscriber| std::thread::spawn(move || read::<RigidBodyState>(&mut subscriber, time)))
            .collect();
        let bare = std::thread::spawn(move || bare_timer(time));
        let streams: Vec<_> = readers.into_iter().map(|reader| reader.join().expect("a reader ends well")).collect();
        // `read` drops half a second first.
        let cpu = (live.cpu() - cpu) / (time.as_secs_f64() + 0.5) * 100.0;
        let timing = timing.join().expect("a reader ends well");
        let found: Vec<f64> = streams.iter().map(|stream| rate(stream)).collect();
        let (low, high) = found.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), &f| (l.min(f), h.max(f)));
        let gaps: Vec<Vec<f64>> = streams.iter().map(|stream| gaps(stream)).collect();
        let gap =
            |share: f64| Spread::of(gaps.iter().map(|gaps| percentile(gaps, share))).expect("there are streams").median;
        section.rows.push(vec![
            scene.name.clone(),
            format!("{low:.0}–{high:.0}"),
            format!("{:.3}", gap(0.5)),
            format!("{:.3}", gap(0.99)),
            format!("{:.0}", physics_rate(&timing)),
            format!("{cpu:.0} %"),
            format!("{:.0}", bare.join().expect("a timer ends well")),
            theirs.into(),
        ]);
        let met = low >= 1980.0 && high <= 2020.0;
        let found = format!("{low:.1}–{high:.1} Hz");
        section.remarks.push(goal(&format!("{}: 2 kHz ± 1 % on each topic", scene.name), met, &found));
    }
    section
}

/// Rate that a thread reaches which only follows the schedule of a 2 kHz topic, Hz.
fn bare_timer(time: Duration) -> f64 {
    let rates = Rates::new(2000, 2000).expect("a proper pair");
    let begin = Instant::now();
    let mut schedule = PublishSchedule::new(rates, Duration::ZERO);
    let mut count = 0;
    while begin.elapsed() < time {
        let now = begin.elapsed();
        // As if states came without end.
        count += u32::from(schedule.poll(now, Published { at: now, interval: Duration::ZERO }));
        std::thread::park_timeout(schedule.next_due().saturating_sub(begin.elapsed()));
    }
    f64::from(count) / begin.elapsed().as_secs_f64()
}

/// Boxes in contact at `-p 1000`, more than the machine can step in time.
pub fn overload(time: Duration) -> Section {
    let mut section = Section {
        title: "simulator/overload",
        intro: "Boxes in contact at `-p 1000`, simulated time following the clock, one body's State subscribed at 2 kHz. *Integrated* is the \
                time that a body in free fall beside the boxes has really moved for; it has to equal simulated time less the lost time \
                that `World/Timing` reports; 0.5 ms of the difference is that reported poses are a sub-step old.",
        header: &[
            "boxes", "iterations/s", "distinct states/s", "sub-steps due, at most", "lost", "simulated − lost − integrated, ms", "longest gap, ms",
            "C++ (observed, other run)",
        ],
        ..Section::default()
    };
    let mut worst = 0.0_f64;
    for (n, theirs) in [(200, "22 iterations/s, 18 states/s"), (400, "–")] {
        let scene = scenes::clocked_boxes(n);
        let live = Live::start(&scene, &FAST);
        let (mut clock, mut world) =
            (live.subscribe("/ambf/env/Clock/State"), live.subscribe("/ambf/env/World/Timing"));
        let timing = std::thread::spawn(move || read::<Timing>(&mut world, time));
        let states = read::<RigidBodyState>(&mut clock, time);
        let timing = timing.join().expect("a reader ends well");
        let (first, last) = (&timing[0].1, &timing[timing.len() - 1].1);
        let lost = (last.lost_time - first.lost_time) / (last.sim_time - first.sim_time) * 100.0;
        let fresh = distinct(&states);
        let longest = longest_still(&states);
        let apart = unaccounted(&timing, &states);
        section.rows.push(vec![
            n.to_string(),
            format!("{:.0}", physics_rate(&timing)),
            format!("{fresh:.0}"),
            last.sub_steps_cap.to_string(),
            format!("{lost:.0} %"),
            format!("{apart:.1}"),
            short(longest),
            theirs.into(),
        ]);
        worst = worst.max((apart - 0.5).abs());
        if n == 200 {
            let found = format!("{fresh:.0}");
            section.remarks.push(goal("at 200 boxes at least 300 distinct states a second", fresh >= 300.0, &found));
        }
    }
    let words = "reported lost time right within one sub-step of 1 ms";
    section.remarks.push(goal(words, worst <= 1.0, &format!("{worst:.2} ms off")));
    section
}

/// Longest time without a new state, ms.
fn longest_still(states: &[Arrival<RigidBodyState>]) -> f64 {
    let changes: Vec<Duration> =
        states.windows(2).filter(|pair| pair[0].1.sim_step != pair[1].1.sim_step).map(|pair| pair[1].0).collect();
    changes.windows(2).map(|pair| (pair[1] - pair[0]).as_secs_f64() * 1e3).fold(0.0, f64::max)
}

/// Largest difference between the time that was simulated and not lost, and the time that the clock body fell for, ms.
fn unaccounted(timing: &[Arrival<Timing>], states: &[Arrival<RigidBodyState>]) -> f64 {
    let same_step = timing.iter().filter_map(|(_, timing)| {
        let place = states.binary_search_by_key(&timing.sim_step, |(_, state)| u64::from(state.sim_step)).ok()?;
        let fallen = scenes::CLOCK_START - states[place].1.pose.position.z;
        // Semi-implicit Euler: after k steps of h the distance is g h² k (k + 1) / 2, so that t = k h is within h / 2
        // of this.
        let integrated = (2.0 * fallen / scenes::CLOCK_GRAVITY).sqrt();
        Some((timing.sim_time - timing.lost_time - integrated) * 1e3)
    });
    same_step.fold(0.0, |worst: f64, found| if found.abs() > worst.abs() { found } else { worst })
}

/// How well simulated time follows the clock, and at what cost.
pub fn real_time(time: Duration, quick: bool) -> Section {
    let mut section = Section {
        title: "simulator/real-time",
        intro: "`-p 1000`, simulated time following the clock; `World/Timing` subscribed at 50 Hz. *Behind* is wall time less simulated time \
                in the same state; *drift* compares simulated time with the reader's own clock over the whole run. CPU is that of \
                the whole process.",
        header: &["scene", "run, s", "physics, Hz", "behind: p50, ms", "behind: most, ms", "drift, ms", "CPU", "CPU without ROS"],
        ..Section::default()
    };
    let own = scenes::own();
    let named = |name: &str| own.iter().find(|scene| scene.name == name).expect("a shipped scene").clone();
    let shorter = Duration::from_secs(if quick { 3 } else { 10 });
    for (scene, time) in [(named("arm7"), time), (named("chain"), shorter), (scenes::boxes(50), shorter)] {
        let live = Live::start(&scene, &[]);
        let mut world = live.subscribe("/ambf/env/World/Timing");
        let cpu = live.cpu();
        let timing = read::<Timing>(&mut world, time);
        let spent = time.as_secs_f64() + 0.5;
        let cpu = (live.cpu() - cpu) / spent * 100.0;
        drop(live);
        let mut behind: Vec<f64> =
            timing.iter().map(|(_, timing)| (timing.wall_time - timing.sim_time) * 1e3).collect();
        behind.sort_by(f64::total_cmp);
        let most = percentile(&behind, 1.0);
        let (first, last) = (&timing[0], &timing[timing.len() - 1]);
        let drift = ((last.1.sim_time - first.1.sim_time) - (last.0 - first.0).as_secs_f64()) * 1e3;
        let frequency = physics_rate(&timing);
        section.rows.push(vec![
            scene.name.clone(),
            format!("{:.0}", time.as_secs_f64()),
            format!("{frequency:.1}"),
            format!("{:.2}", percentile(&behind, 0.5)),
            format!("{most:.2}"),
            format!("{drift:.2}"),
            format!("{cpu:.0} %"),
            format!("{:.0} %", cpu_without_ros(&scene)),
        ]);
        if section.rows.len() == 1 {
            let found = format!("{frequency:.1} Hz");
            section.remarks.push(goal(
                "1000 Hz within 1 % (C++: about 950)",
                (frequency - 1000.0).abs() <= 10.0,
                &found,
            ));
            let found = format!("at most {most:.2} ms behind, drift {drift:.2} ms");
            section.remarks.push(goal(
                "simulated time within 2 ms of the clock",
                most <= 2.0 && drift.abs() <= 2.0,
                &found,
            ));
            section.remarks.push(goal("well below one spinning core (C++: 100 %)", cpu < 50.0, &format!("{cpu:.0} %")));
        }
    }
    section
}

fn cpu_without_ros(scene: &Scene) -> f64 {
    let live = Live::start(scene, &["--no_ros"]);
    std::thread::sleep(Duration::from_secs(1));
    let (begin, cpu) = (Instant::now(), live.cpu());
    std::thread::sleep(Duration::from_secs(3));
    (live.cpu() - cpu) / begin.elapsed().as_secs_f64() * 100.0
}
