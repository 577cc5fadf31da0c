//! When a haptic loop ticks, and how urgently its thread runs.

use std::num::NonZeroU64;
use std::time::Duration;

use rustix::thread::{clock_nanosleep_absolute, set_current_timer_slack};
use rustix::time::{clock_gettime, ClockId, Timespec};
use thread_priority::unix::{set_thread_priority_and_policy, thread_native_id};
use thread_priority::{
    NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
};

/// A normal thread wakes up late by about this; the rest is spun.
const SPIN: Duration = Duration::from_micros(20);

/// The priority that the C++ program asks for.
const FIFO_PRIORITY: u8 = 99;

/// Keeps a loop on an absolute schedule. A tick that comes too late for the next one is not caught up.
#[derive(Debug)]
pub(super) struct Pace {
    period: Duration,
    /// On the monotonic clock.
    next: Duration,
    spin: Duration,
}

impl Pace {
    /// Ticks every `period`, the first time a period from now.
    pub fn new(period: Duration) -> Self {
        Self { period, next: now() + period, spin: SPIN }
    }

    /// Waits for the next tick: sleeps to shortly before it, then spins.
    pub fn wait(&mut self) {
        let begin = now();
        if self.next <= begin {
            self.next = begin + self.period;
            return;
        }
        let wake = self.next.saturating_sub(self.spin);
        if wake > begin {
            sleep_until(wake);
        }
        while now() < self.next {
            std::hint::spin_loop();
        }
        self.next += self.period;
    }

    /// Asks the system to run this thread first in, first out, above all others; says why it refused. A thread that has
    /// it wakes up on time and does not spin: on a computer with few cores it would keep one from everybody else.
    ///
    /// Threads inherit it from the thread that starts them: [`be_normal`](Self::be_normal) goes before foreign code
    /// that may start some.
    pub fn be_urgent(&mut self) -> Result<(), String> {
        // Without the 50 µs by which the system may delay the timers of a normal thread; refused or not.
        let _ = set_current_timer_slack(NonZeroU64::new(1));
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let priority = ThreadPriorityValue::try_from(FIFO_PRIORITY).map_err(|error| error.to_string())?;
        set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(priority), policy)
            .map_err(|error| error.to_string())?;
        self.spin = Duration::ZERO;
        Ok(())
    }

    /// Runs this thread as any other again.
    pub fn be_normal(&mut self) {
        if self.spin.is_zero() {
            let policy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
            let _ = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, policy);
            self.spin = SPIN;
        }
    }
}

/// The monotonic clock.
fn now() -> Duration {
    let time = clock_gettime(ClockId::Monotonic);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}

fn sleep_until(time: Duration) {
    let time = Timespec { tv_sec: time.as_secs() as i64, tv_nsec: i64::from(time.subsec_nanos()) };
    // Woken up by a signal: the schedule is absolute, so that sleeping on is right.
    while clock_nanosleep_absolute(ClockId::Monotonic, &time) == Err(rustix::io::Errno::INTR) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    #[test]
    fn ticks_never_come_faster_than_asked_and_are_not_caught_up() {
        let mut pace = Pace::new(Duration::from_millis(1));
        let begin = Instant::now();
        (0..20).for_each(|_| pace.wait());
        assert!(begin.elapsed() >= Duration::from_millis(20));
        std::thread::sleep(Duration::from_millis(30));
        pace.wait();
        let late = Instant::now();
        (0..10).for_each(|_| pace.wait());
        assert!(late.elapsed() >= Duration::from_millis(9), "no burst after a late tick");
    }

    #[test]
    fn urgency_is_granted_or_refused_with_a_reason_and_can_be_given_back() {
        let mut pace = Pace::new(Duration::from_millis(1));
        match pace.be_urgent() {
            Ok(()) => assert!(pace.spin.is_zero()),
            Err(why) => assert!(!why.is_empty()),
        }
        pace.be_normal();
        assert_eq!(pace.spin, SPIN);
    }
}
