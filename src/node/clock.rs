//! Ticks of real time: absolute deadlines on a plain thread.

use std::time::Duration;

/// Nanoseconds of the monotonic clock.
pub fn monotonic() -> i64 {
    read(libc::CLOCK_MONOTONIC)
}

/// Nanoseconds since 1970 of the system clock.
pub fn system() -> i64 {
    read(libc::CLOCK_REALTIME)
}

fn read(clock: libc::clockid_t) -> i64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is valid for writing; both clocks exist on every Linux.
    unsafe { libc::clock_gettime(clock, &mut time) };
    time.tv_sec * 1_000_000_000 + time.tv_nsec
}

/// Sleeps until the monotonic clock shows `deadline` ns. Returns at once when that has passed.
pub fn sleep_until(deadline: i64) {
    let time = libc::timespec {
        tv_sec: deadline.div_euclid(1_000_000_000),
        tv_nsec: deadline.rem_euclid(1_000_000_000),
    };
    // SAFETY: `time` is valid for reading, the remaining time is not asked for. A signal ends the
    // sleep early: sleep again.
    while unsafe {
        libc::clock_nanosleep(
            libc::CLOCK_MONOTONIC,
            libc::TIMER_ABSTIME,
            &time,
            std::ptr::null_mut(),
        )
    } == libc::EINTR
    {}
}

/// Priority of the thread that ticks, above every `priority` of a node.
const TICK_PRIORITY: i32 = 50;

/// Asks the kernel to wake this thread on time: timer slack of 1 ns instead of 50 us, and, where it
/// is wanted and permitted, SCHED_FIFO.
///
/// Returns whether real-time scheduling was granted.
pub fn prepare_tick_thread(real_time: bool) -> bool {
    // SAFETY: plain calls on the calling thread with valid arguments.
    unsafe {
        libc::prctl(libc::PR_SET_TIMERSLACK, 1usize);
        let parameters = libc::sched_param { sched_priority: TICK_PRIORITY };
        real_time
            && libc::pthread_setschedparam(libc::pthread_self(), libc::SCHED_FIFO, &parameters) == 0
    }
}

/// Ticks at a fixed rate, counted from a start; tick times do not drift.
#[derive(Clone, Copy, Debug)]
pub struct Ticks {
    start: i64,
    rate: f64,
    index: u64,
}

impl Ticks {
    /// The first tick is at `start` (monotonic, ns); `rate` in Hz.
    pub fn new(start: i64, rate: f64) -> Ticks {
        Ticks { start, rate, index: 0 }
    }

    /// Monotonic time of the next tick, ns.
    pub fn next_deadline(&self) -> i64 {
        self.start + (self.index as f64 * 1e9 / self.rate).round() as i64
    }

    /// Sleeps until the next tick and returns by how much it is late, ns.
    pub fn wait(&mut self) -> i64 {
        let deadline = self.next_deadline();
        self.index += 1;
        sleep_until(deadline);
        monotonic() - deadline
    }

    /// Gives up the ticks that were missed: the next one is now.
    pub fn resynchronise(&mut self) {
        self.start = monotonic();
        self.index = 0;
    }
}

/// Period of a rate in Hz.
pub fn period(rate: f64) -> Duration {
    Duration::from_secs_f64(rate.recip())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_come_at_their_deadlines_and_not_before() {
        let start = monotonic();
        let mut ticks = Ticks::new(start, 1000.0);
        for k in 0..20 {
            let late = ticks.wait();
            assert!(late >= 0 && monotonic() >= start + k * 1_000_000);
        }
        assert_eq!(ticks.next_deadline(), start + 20_000_000);
    }
}
