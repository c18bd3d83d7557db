//! Virtual time for embassy-time: one clock a thread.
//!
//! embassy-time has one driver a program. This one keeps the time and the timers in thread-local storage, so every thread
//! has a clock of its own that stands still until [`set`] moves it.

use embassy_time_driver::Driver;
use std::cell::{Cell, RefCell};
use std::task::Waker;

thread_local! {
    static NOW_US: Cell<u64> = const { Cell::new(0) };
    static TIMERS: RefCell<Vec<(u64, Waker)>> = const { RefCell::new(Vec::new()) };
}

struct ThreadClock;

impl Driver for ThreadClock {
    fn now(&self) -> u64 {
        now_us()
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        TIMERS.with_borrow_mut(|timers| {
            let waiting = timers.iter().any(|(other, same)| *other == at && same.will_wake(waker));
            if !waiting {
                timers.push((at, waker.clone()));
            }
        });
    }
}

embassy_time_driver::time_driver_impl!(static CLOCK: ThreadClock = ThreadClock);

/// This thread's time, µs.
pub fn now_us() -> u64 {
    NOW_US.get()
}

/// When this thread's next timer is due, µs.
pub fn next_timer_us() -> Option<u64> {
    TIMERS.with_borrow(|timers| timers.iter().map(|(at, _)| *at).min())
}

/// Moves this thread's clock and wakes the timers that are due.
pub fn set(now: u64) {
    NOW_US.set(now);
    let due: Vec<Waker> =
        TIMERS.with_borrow_mut(|timers| timers.extract_if(.., |(at, _)| *at <= now).map(|(_, waker)| waker).collect());
    for waker in due {
        waker.wake();
    }
}

/// Forgets this thread's timers and starts its clock anew: a board was switched on.
pub fn reset(start_us: u64) {
    NOW_US.set(start_us);
    forget_timers();
}

/// Forgets this thread's timers: a board restarts, and what waited on it is gone.
pub fn forget_timers() {
    TIMERS.with_borrow_mut(Vec::clear);
}

#[cfg(test)]
mod tests {
    use super::*;
    use embassy_time::{Duration, Timer};
    use std::future::Future;
    use std::task::{Context, Poll};

    #[test]
    fn a_timer_is_ready_exactly_when_it_is_due() {
        reset(100);
        let mut timer = std::pin::pin!(Timer::after(Duration::from_micros(50)));
        let mut context = Context::from_waker(Waker::noop());
        assert_eq!(timer.as_mut().poll(&mut context), Poll::Pending);
        assert_eq!(next_timer_us(), Some(150));
        set(149);
        assert_eq!(timer.as_mut().poll(&mut context), Poll::Pending);
        set(150);
        assert_eq!(timer.as_mut().poll(&mut context), Poll::Ready(()));
    }

    #[test]
    fn threads_have_clocks_of_their_own() {
        reset(5);
        std::thread::spawn(|| {
            reset(1_000_000);
            assert_eq!(now_us(), 1_000_000);
        })
        .join()
        .unwrap();
        assert_eq!(now_us(), 5);
    }
}
