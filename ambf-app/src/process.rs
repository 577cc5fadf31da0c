//! What this process has used, from `/proc`, and how it is asked to end.

use std::fs::read_to_string;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::report;

/// Signals that come so soon after the first are the same wish: terminals and scripts send them to whole groups of
/// processes. By then the forces of devices are zero, so that a program that has to be ended by force leaves none
/// behind.
const SAME: Duration = Duration::from_secs(1);

/// Set by SIGINT, SIGTERM and SIGHUP; one that comes more than a second after the first ends the program at once.
pub fn stop_flag() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let mut first: Option<Instant> = None;
    let set = ctrlc::set_handler(move || {
        flag.store(true, Ordering::Release);
        if first.get_or_insert_with(Instant::now).elapsed() > SAME {
            std::process::exit(130);
        }
    });
    if let Err(error) = set {
        report!("Ctrl+C cannot be caught ({error}): it will end the program without withdrawing its topics");
    }
    stop
}

/// User and system time of all threads so far, s; 0 where `/proc` does not tell.
pub fn cpu_seconds() -> f64 {
    // Linux reports in ticks of 1/100 s on every architecture it is built for today; schedstat is finer but per thread.
    const TICKS: f64 = 100.0;
    let stat = read_to_string("/proc/self/stat").unwrap_or_default();
    // The second field is the program's name in parentheses and may hold blanks.
    let rest = stat.rsplit(')').next().unwrap_or_default();
    let field = |n: usize| rest.split_whitespace().nth(n).and_then(|text| text.parse::<f64>().ok()).unwrap_or(0.0);
    (field(11) + field(12)) / TICKS
}

/// Largest memory the process ever had resident, MB; 0 where `/proc` does not tell.
pub fn peak_memory_mb() -> f64 {
    let status = read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_uses_something() {
        let mut sum = 0u64;
        let begin = std::time::Instant::now();
        while begin.elapsed().as_millis() < 50 {
            sum = sum.wrapping_mul(31).wrapping_add(std::hint::black_box(1));
        }
        std::hint::black_box(sum);
        assert!(cpu_seconds() > 0.0);
        assert!(peak_memory_mb() > 0.5);
    }
}
