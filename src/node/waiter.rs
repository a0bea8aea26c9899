//! A plain thread that waits for what is polled, parked in between.

use std::{
    marker::PhantomData,
    sync::Arc,
    task::{Context, Poll, Wake, Waker},
    thread::{self, Thread},
    time::Instant,
};

struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.0.unpark();
    }
}

/// Parks the thread that made it.
pub struct Waiter {
    waker: Waker,
    /// Stays on its thread: another one would park itself and never be woken.
    not_send: PhantomData<*const ()>,
}

impl Default for Waiter {
    fn default() -> Self {
        Self::new()
    }
}

impl Waiter {
    pub fn new() -> Self {
        Self { waker: Waker::from(Arc::new(Unpark(thread::current()))), not_send: PhantomData }
    }

    /// Wakes the wait from another thread, so that it polls again: for stop flags and the like.
    pub fn waker(&self) -> Waker {
        self.waker.clone()
    }

    /// Polls until it is ready, parked in between; `None` when `deadline` has passed first.
    pub fn wait<T>(
        &self,
        deadline: Option<Instant>,
        mut poll: impl FnMut(&mut Context<'_>) -> Poll<T>,
    ) -> Option<T> {
        let mut context = Context::from_waker(&self.waker);
        loop {
            if let Poll::Ready(value) = poll(&mut context) {
                return Some(value);
            }
            match deadline {
                None => thread::park(),
                Some(deadline) => {
                    let left = deadline.saturating_duration_since(Instant::now());
                    if left.is_zero() {
                        return None;
                    }
                    thread::park_timeout(left);
                }
            }
        }
    }
}

/// Whose turn it is among sources that are polled one after the other: what was served comes last
/// in the next round, so that none of them, however much it has, keeps the others waiting.
pub struct Turns<S: 'static> {
    sources: &'static [S],
    first: usize,
}

impl<S: Copy> Turns<S> {
    /// The order of the first round.
    pub fn new(sources: &'static [S]) -> Self {
        Self { sources, first: 0 }
    }

    /// What the first source gives that has something.
    pub fn poll<T>(&mut self, mut poll: impl FnMut(S) -> Poll<T>) -> Poll<T> {
        let count = self.sources.len();
        for turn in (self.first..count).chain(0..self.first) {
            if let Poll::Ready(value) = poll(self.sources[turn]) {
                self.first = (turn + 1) % count;
                return Poll::Ready(value);
            }
        }
        Poll::Pending
    }
}

#[cfg(test)]
mod tests {
    use std::{
        sync::atomic::{AtomicBool, Ordering},
        time::Duration,
    };

    use super::*;

    #[test]
    fn a_wait_ends_at_its_deadline() {
        let start = Instant::now();
        let limit = Duration::from_millis(20);
        let nothing: Option<()> = Waiter::new().wait(Some(start + limit), |_| Poll::Pending);
        assert_eq!(nothing, None);
        assert!(start.elapsed() >= limit, "{:?}", start.elapsed());
    }

    #[test]
    fn a_source_that_always_has_something_leaves_the_others_their_turn() {
        let mut turns = Turns::new(&["flood", "sample", "silent"]);
        let mut samples = 0;
        let mut served = Vec::new();
        for _ in 0..6 {
            let Poll::Ready(source) = turns.poll(|source| match source {
                "flood" => Poll::Ready(source),
                "sample" if samples < 2 => {
                    samples += 1;
                    Poll::Ready(source)
                }
                _ => Poll::Pending,
            }) else {
                panic!("nothing is ready");
            };
            served.push(source);
        }
        assert_eq!(served, ["flood", "sample", "flood", "sample", "flood", "flood"]);
    }

    #[test]
    fn another_thread_wakes_a_wait_without_deadline() {
        let waiter = Waiter::new();
        let waker = waiter.waker();
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let other = thread::spawn(move || {
            flag.store(true, Ordering::SeqCst);
            waker.wake();
        });
        let polled = waiter.wait(None, |_| {
            if stop.load(Ordering::SeqCst) { Poll::Ready(1) } else { Poll::Pending }
        });
        assert_eq!(polled, Some(1));
        other.join().unwrap();
    }
}
