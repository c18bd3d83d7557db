//! Who holds the motor: one page at a time, for as long as it shows what the board says.
//!
//! A page that holds the motor answers every message of its stream. The lease counts from when the message it answered was
//! *sent*, so a page that is gone, frozen or far behind loses the motor alike. What it set in motion is stopped then, and it
//! gets the motor back only when a person asks for it again.
//!
//! A terminal to which the board is lent holds the motor as long as the loan lasts: the board's own command timeout watches it.

use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// Why the motor is not given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HeldError {
    /// Another page has it, and something is going on.
    #[error("another page holds the motor and is using it: stop it first (anybody may), then take it")]
    InUse,
    /// A terminal has it.
    #[error("a terminal has the board: stop it first (anybody may), then take it")]
    Lent,
    /// A page holds it, and a terminal asks.
    #[error("a page holds the motor: give it back there first")]
    Held,
    /// The page does not hold it.
    #[error("this page does not hold the motor: take it first")]
    NotHolder,
    /// No page of that name is connected.
    #[error("this page has no stream: load it again")]
    Unknown,
}

enum Lease {
    Page { name: String, until: Instant },
    Terminal,
}

impl Lease {
    fn is_of(&self, page: &str) -> bool {
        matches!(self, Self::Page { name, .. } if name == page)
    }

    /// The end of this page's lease.
    fn until(&mut self, page: &str) -> Option<&mut Instant> {
        match self {
            Self::Page { name, until } if name == page => Some(until),
            _ => None,
        }
    }
}

/// The holder, if there is one.
#[derive(Default)]
pub struct Holder {
    lease: Mutex<Option<Lease>>,
}

impl Holder {
    fn lock(&self) -> MutexGuard<'_, Option<Lease>> {
        self.lease.lock().expect("nothing panics while it holds the lease")
    }

    /// Gives the motor to a page. One that another page has is given only while nothing is going on, one that a terminal has
    /// not at all.
    ///
    /// # Errors
    /// When another page uses it, or a terminal has it.
    pub fn take(&self, page: &str, is_at_work: bool, timeout: Duration) -> Result<(), HeldError> {
        let mut lease = self.lock();
        match lease.as_ref() {
            Some(Lease::Terminal) => return Err(HeldError::Lent),
            Some(other) if is_at_work && !other.is_of(page) => return Err(HeldError::InUse),
            _ => {}
        }
        *lease = Some(Lease::Page { name: page.to_owned(), until: Instant::now() + timeout });
        Ok(())
    }

    /// Gives the motor to a terminal.
    ///
    /// # Errors
    /// When a page holds it, or another terminal.
    pub fn lend(&self) -> Result<(), HeldError> {
        let mut lease = self.lock();
        match lease.as_ref() {
            Some(Lease::Terminal) => Err(HeldError::Lent),
            Some(Lease::Page { .. }) => Err(HeldError::Held),
            None => {
                *lease = Some(Lease::Terminal);
                Ok(())
            }
        }
    }

    /// The terminal has given it back, or is gone.
    pub fn is_returned(&self) {
        let mut lease = self.lock();
        if matches!(*lease, Some(Lease::Terminal)) {
            *lease = None;
        }
    }

    /// The page has shown what was sent to it at `sent`.
    pub fn beat(&self, page: &str, sent: Instant, timeout: Duration) {
        if let Some(until) = self.lock().as_mut().and_then(|lease| lease.until(page)) {
            *until = (*until).max(sent + timeout);
        }
    }

    /// The page gives the motor back.
    pub fn release(&self, page: &str) -> bool {
        let mut lease = self.lock();
        let held = lease.as_ref().is_some_and(|lease| lease.is_of(page));
        if held {
            *lease = None;
        }
        held
    }

    /// Ends a page's lease that ran out so long ago; whether it did so now.
    pub fn expire(&self, patience: Duration) -> bool {
        let mut lease = self.lock();
        let over = matches!(*lease, Some(Lease::Page { until, .. }) if Instant::now() > until + patience);
        if over {
            *lease = None;
        }
        over
    }

    /// Whether the page may move the motor. Asking is a sign of life.
    ///
    /// # Errors
    /// When it may not.
    pub fn check(&self, page: &str, timeout: Duration) -> Result<(), HeldError> {
        match self.lock().as_mut().and_then(|lease| lease.until(page)) {
            Some(until) => {
                *until = (*until).max(Instant::now() + timeout);
                Ok(())
            }
            None => Err(HeldError::NotHolder),
        }
    }

    /// `you`, `another` or `nobody`, to a page. A terminal is another.
    pub fn of(&self, page: &str) -> &'static str {
        match self.lock().as_ref() {
            Some(lease) if lease.is_of(page) => "you",
            Some(_) => "another",
            None => "nobody",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_page_holds_it_until_it_falls_silent() {
        let (holder, timeout) = (Holder::default(), Duration::from_millis(40));
        assert_eq!(holder.check("a", timeout), Err(HeldError::NotHolder));
        holder.take("a", false, timeout).unwrap();
        assert_eq!((holder.of("a"), holder.of("b")), ("you", "another"));
        assert_eq!(holder.take("b", true, timeout), Err(HeldError::InUse));
        assert_eq!(holder.check("b", timeout), Err(HeldError::NotHolder));
        // An answer to what was sent long ago is no sign of life, nor is another page's.
        let long_ago = Instant::now().checked_sub(Duration::from_secs(1)).unwrap();
        holder.beat("a", long_ago, timeout);
        holder.beat("b", Instant::now() + Duration::from_secs(9), timeout);
        std::thread::sleep(Duration::from_millis(60));
        assert!(!holder.expire(timeout * 100) && holder.expire(Duration::ZERO) && !holder.expire(Duration::ZERO));
        assert_eq!(holder.check("a", timeout), Err(HeldError::NotHolder), "it does not come back by itself");
        holder.beat("a", Instant::now(), timeout);
        assert_eq!(holder.of("a"), "nobody");
        holder.take("b", false, timeout).unwrap();
        holder.take("a", false, timeout).unwrap();
        assert!(!holder.release("b") && holder.release("a"));
    }

    #[test]
    fn a_terminal_has_it_as_long_as_it_is_lent_and_no_page_meanwhile() {
        let (holder, timeout) = (Holder::default(), Duration::ZERO);
        holder.take("a", false, Duration::from_secs(9)).unwrap();
        assert_eq!(holder.lend(), Err(HeldError::Held));
        holder.is_returned();
        assert_eq!(holder.of("a"), "you", "what was never lent is not returned");
        holder.release("a");
        holder.lend().unwrap();
        assert_eq!(holder.lend(), Err(HeldError::Lent));
        assert_eq!(holder.take("a", false, timeout), Err(HeldError::Lent));
        assert!(!holder.expire(timeout) && !holder.release("a"));
        assert_eq!((holder.of("a"), holder.check("a", timeout)), ("another", Err(HeldError::NotHolder)));
        holder.is_returned();
        holder.take("a", false, timeout).unwrap();
    }
}
