use std::time::{Duration, Instant};

/// Sleeping wakes up late by up to about this; the rest is spun.
const SPIN: Duration = Duration::from_micros(60);

/// Periods that a loop may be behind and still catch up: what a preempted iteration costs on a busy computer.
const MAX_LAG: u32 = 10;

/// Keeps a loop at a frequency on an absolute schedule. Further behind than a few periods it starts afresh: no lag
/// piles up.
#[derive(Debug, Clone)]
pub(super) struct Pacer {
    period: Duration,
    next: Instant,
}

impl Pacer {
    pub fn new(period: Duration) -> Self {
        Self { period, next: Instant::now() + period }
    }

    /// Waits for the end of the period. Most of it is slept, the last part spun.
    pub fn wait(&mut self) {
        let now = Instant::now();
        if now > self.next + self.period * MAX_LAG {
            self.next = now + self.period;
            return;
        }
        if now >= self.next {
            self.next += self.period;
            return;
        }
        if let Some(rest) = self.next.checked_duration_since(now + SPIN) {
            std::thread::sleep(rest);
        }
        while Instant::now() < self.next {
            std::hint::spin_loop();
        }
        self.next += self.period;
    }
}

/// The shortest slice that Linux grants, ns.
const SLICE: u64 = 100_000;

/// Asks the scheduler for short slices of time in this thread. Its share stays the same, but when it wakes up it need
/// not wait until a thread of lower priority, such as one that draws, has used up a slice of some 3 ms. Linux since
/// 6.12 heeds it, others ignore or refuse it.
pub(super) fn ask_for_short_slices() {
    // SAFETY: `sched_attr` is a plain structure of numbers, of which its size is told: no more of it is written or
    // read.
    unsafe {
        let mut attributes: libc::sched_attr = std::mem::zeroed();
        let size = std::mem::size_of_val(&attributes);
        if libc::syscall(libc::SYS_sched_getattr, 0, &raw mut attributes, size, 0) == 0
            && attributes.sched_policy == libc::SCHED_OTHER as u32
        {
            attributes.sched_runtime = SLICE;
            libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lag_does_not_pile_up() {
        let mut pacer = Pacer::new(Duration::from_millis(1));
        std::thread::sleep(Duration::from_millis(50));
        let begin = Instant::now();
        pacer.wait();
        pacer.wait();
        assert!(begin.elapsed() >= Duration::from_millis(1), "no burst to catch up 50 periods");
    }

    #[test]
    fn a_period_is_never_shorter_on_average() {
        let begin = Instant::now();
        let mut pacer = Pacer::new(Duration::from_millis(1));
        for _ in 0..50 {
            pacer.wait();
        }
        assert!(begin.elapsed() >= Duration::from_millis(50));
    }

    #[test]
    fn slices_are_short_and_the_priority_stays() {
        std::thread::spawn(|| {
            let nice = rustix::process::getpriority_process(None).unwrap().min(18) + 1;
            rustix::process::setpriority_process(None, nice).unwrap();
            ask_for_short_slices();
            assert_eq!(rustix::process::getpriority_process(None), Ok(nice));
            // The second line after the head of the table: "se.slice : 100000" where the kernel shows it.
            let shown = std::fs::read_to_string("/proc/thread-self/sched").unwrap_or_default();
            if let Some(line) = shown.lines().find(|line| line.starts_with("se.slice")) {
                let slice: u64 = line.rsplit(' ').next().unwrap().parse().unwrap();
                // Longer: an older kernel, which ignores it.
                assert!(slice == SLICE || slice >= 700_000, "{line}");
            }
        })
        .join()
        .unwrap();
    }
}
