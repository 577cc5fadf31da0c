use std::num::NonZeroU64;
use std::time::Duration;

use rustix::thread::{clock_nanosleep_absolute, set_current_timer_slack};
use rustix::time::{clock_gettime, ClockId, Timespec};
use thread_priority::unix::{set_thread_priority_and_policy, thread_native_id};
use thread_priority::{
    NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
};

/// A normal thread whose timers have no slack wakes up late by about this; the rest is spun.
const SPIN: Duration = Duration::from_micros(20);

/// The priority that the C++ program asks for.
const FIFO_PRIORITY: u8 = 99;

/// Keeps the loop of the calling thread on an absolute schedule. Periods come late, but never early: no lag piles up
/// beyond what is caught up.
#[derive(Debug)]
pub struct Pacer {
    period: Duration,
    /// On the monotonic clock.
    next: Duration,
    max_lag: u32,
    spin: Duration,
}

impl Pacer {
    /// Ticks every `period`, the first time a period from now. A tick that comes more than `max_lag` periods late
    /// starts the schedule afresh; one that comes less late is caught up.
    pub fn new(period: Duration, max_lag: u32) -> Self {
        // Without the 50 µs by which the system may delay the timers of a normal thread; refused or not.
        let _ = set_current_timer_slack(NonZeroU64::new(1));
        Self { period, next: now() + period, max_lag, spin: SPIN }
    }

    /// Waits for the next tick: sleeps to shortly before it, then spins.
    pub fn wait(&mut self) {
        let begin = now();
        if begin >= self.next + self.period * self.max_lag {
            self.next = begin;
        } else if begin < self.next {
            let wake = self.next.saturating_sub(self.spin);
            if wake > begin {
                sleep_until(wake);
            }
            while now() < self.next {
                std::hint::spin_loop();
            }
        }
        self.next += self.period;
    }

    /// Takes a tick that has come already, if there is one, without waiting.
    pub fn skip(&mut self) {
        if now() >= self.next {
            self.next += self.period;
        }
    }

    /// Asks the system to run this thread first in, first out, above all others.
    ///
    /// A thread that has this wakes up on time and does not spin: on a computer with few cores it would keep one from
    /// everybody else. Threads inherit it from the thread that starts them: [`be_normal`](Self::be_normal) goes before
    /// foreign code that may start some.
    ///
    /// # Errors
    /// Why the system refused.
    pub fn be_urgent(&mut self) -> Result<(), String> {
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

    const PERIOD: Duration = Duration::from_millis(1);

    #[test]
    fn ticks_never_come_faster_than_asked_and_are_not_caught_up() {
        let begin = Instant::now();
        let mut pacer = Pacer::new(PERIOD, 0);
        (0..20).for_each(|_| pacer.wait());
        assert!(begin.elapsed() >= 20 * PERIOD);
        std::thread::sleep(30 * PERIOD);
        pacer.wait();
        let late = Instant::now();
        (0..10).for_each(|_| pacer.wait());
        assert!(late.elapsed() >= 9 * PERIOD, "no burst after a late tick");
    }

    #[test]
    fn a_tick_that_was_taken_is_not_caught_up() {
        let begin = now();
        let mut pacer = Pacer::new(PERIOD, 1_000_000);
        pacer.skip();
        assert!(pacer.next <= now() + PERIOD, "a tick in the future is not taken");
        std::thread::sleep(5 * PERIOD);
        (0..3).for_each(|_| pacer.skip());
        assert!(pacer.next >= begin + 4 * PERIOD);
    }

    #[test]
    fn lag_is_caught_up_to_a_limit() {
        let begin = Instant::now();
        let mut pacer = Pacer::new(PERIOD, 1_000_000);
        std::thread::sleep(5 * PERIOD);
        (0..20).for_each(|_| pacer.wait());
        let elapsed = now().saturating_sub(pacer.next) + PERIOD;
        assert!(begin.elapsed() >= 20 * PERIOD && elapsed < begin.elapsed(), "the schedule stays: {elapsed:?}");
        let mut pacer = Pacer::new(PERIOD, 10);
        std::thread::sleep(50 * PERIOD);
        let begin = Instant::now();
        (0..2).for_each(|_| pacer.wait());
        assert!(begin.elapsed() >= PERIOD, "no burst to catch up 50 periods");
    }

    #[test]
    fn urgency_is_granted_or_refused_with_a_reason_and_can_be_given_back() {
        let mut pacer = Pacer::new(PERIOD, 0);
        match pacer.be_urgent() {
            Ok(()) => assert!(pacer.spin.is_zero()),
            Err(why) => assert!(!why.is_empty()),
        }
        pacer.be_normal();
        assert_eq!(pacer.spin, SPIN);
    }
}
