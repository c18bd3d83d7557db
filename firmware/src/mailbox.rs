//! A bounded queue between interrupts and tasks, behind a critical section.

use core::cell::RefCell;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use heapless::Deque;

/// Anybody may push and pull, at any priority and on any core; nothing waits, and nothing can panic, so the control
/// interrupt may use it.
pub(crate) struct Mailbox<T, const N: usize>(Mutex<CriticalSectionRawMutex, RefCell<Deque<T, N>>>);

impl<T, const N: usize> Mailbox<T, N> {
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(Deque::new())))
    }

    /// Gives the item back where there is no room.
    pub fn push(&self, item: T) -> Result<(), T> {
        // The critical section excludes a second borrow; should there be one, the queue counts as full.
        self.0.lock(|queue| match queue.try_borrow_mut() {
            Ok(mut queue) => queue.push_back(item),
            Err(_) => Err(item),
        })
    }

    /// How many items wait.
    pub fn len(&self) -> usize {
        self.0.lock(|queue| queue.try_borrow().map_or(0, |queue| queue.len()))
    }

    /// The oldest item, taken out.
    pub fn pull(&self) -> Option<T> {
        self.0.lock(|queue| queue.try_borrow_mut().ok()?.pop_front())
    }
}

impl<T: Copy, const N: usize> Mailbox<T, N> {
    /// The oldest item, left in.
    pub fn peek(&self) -> Option<T> {
        self.0.lock(|queue| queue.try_borrow().ok()?.front().copied())
    }
}

impl<T, const N: usize> Default for Mailbox<T, N> {
    fn default() -> Self {
        Self::new()
    }
}
