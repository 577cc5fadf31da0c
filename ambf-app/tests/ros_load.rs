//! Many topics at a high rate of which few are listened to.

use std::time::{Duration, Instant};

use ambf_core::comm::{Middleware, Rates};
use ambf_test_support::ros::*;

const TOPICS: usize = 200;
const LISTENED: usize = 5;
const RATE: u32 = 2000;

/// CPU time of this process, s.
fn cpu_time() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) / 100.0
}

#[test]
fn few_of_many_topics_at_2_khz() {
    let master = use_own_master();
    let begin = Instant::now();
    let mut simulator = Simulator::start(objects("/ambf/env/", TOPICS, Rates::new(RATE, RATE).unwrap()));
    until("the last topic", || system_state_mentions(&master, "/ambf/env/light/Command"));
    println!("{TOPICS} bodies announced after {} ms", begin.elapsed().as_millis());
    let node = publisher_of(&master, "/ambf/env/Box0/State");
    let idle = cpu_time();
    std::thread::sleep(Duration::from_secs(1));
    println!("CPU without subscribers: {:.1} %", (cpu_time() - idle) * 100.0);
    let readers: Vec<_> = (0..LISTENED)
        .map(|i| {
            let topic = format!("/ambf/env/Box{}/State", i * TOPICS / LISTENED);
            let mut subscriber = RawSubscriber::connect(&node, &topic);
            std::thread::spawn(move || {
                subscriber.count(Duration::from_millis(500));
                let (begin, mut last, mut gaps) = (Instant::now(), Instant::now(), Vec::new());
                while begin.elapsed() < Duration::from_secs(3) {
                    subscriber.read_block().expect("the stream goes on");
                    gaps.push(last.elapsed().as_micros());
                    last = Instant::now();
                }
                let rate = gaps.len() as f64 / begin.elapsed().as_secs_f64();
                gaps.sort_unstable();
                let percentile = |p: usize| gaps[(gaps.len() - 1) * p / 100];
                println!("{topic}: {rate:.1} Hz, gaps {} / {} us (p50/p99)", percentile(50), percentile(99));
                rate
            })
        })
        .collect();
    std::thread::sleep(Duration::from_millis(500));
    let cpu = cpu_time();
    let rates: Vec<f64> = readers.into_iter().map(|reader| reader.join().unwrap()).collect();
    println!("CPU with {LISTENED} subscribers, theirs included: {:.1} %", (cpu_time() - cpu) / 3.0 * 100.0);
    let (threads, files) = resources();
    println!("{threads} threads, {files} files");
    let stop = Instant::now();
    simulator.ros.stop();
    println!("stopped in {} ms", stop.elapsed().as_millis());
    for rate in rates {
        // A busy machine may be slower, but never faster.
        assert!(rate > 200.0 && rate < f64::from(RATE) * 1.02, "{rate} Hz");
    }
}
