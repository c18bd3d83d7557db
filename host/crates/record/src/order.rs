//! The order of a board's frames: what is missing, what came twice, and when the board began anew. The session that listens
//! and the decoder that reads a recording count alike.

use std::collections::VecDeque;
use twum_shared::frame::Header;

/// Frames remembered to know one that comes again. A line that repeats does so within its buffers, far less than these.
const REMEMBERED: usize = 256;

/// How a frame follows those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// The first one heard.
    First,
    /// After so many that are missing, mostly none.
    Next {
        /// Sequence numbers between the frame before and this one.
        missing: u32,
    },
    /// It was here before: to be dropped.
    Again,
    /// The board has restarted: its clock, its sequence and its indices begin anew.
    Restart,
}

/// Follows the headers of one board.
#[derive(Debug, Clone, Default)]
pub struct Order {
    recent: VecDeque<Header>,
}

impl Order {
    /// Whether a frame was heard.
    pub fn has_begun(&self) -> bool {
        !self.recent.is_empty()
    }

    /// Takes the next header; `is_hello` tells the answer that a board gives first.
    pub fn take(&mut self, header: Header, is_hello: bool) -> Arrival {
        let Some(&last) = self.recent.back() else {
            self.remember(header);
            return Arrival::First;
        };
        // A board that starts the same way twice says the same hello at the same time of its clock.
        let begins = is_hello && header != last && header.sequence < last.sequence;
        if header == last || (!begins && self.recent.contains(&header)) {
            return Arrival::Again;
        }
        let ahead = header.sequence.wrapping_sub(last.sequence);
        // Neither the clock nor the sequence ever goes back; half the range and more ahead is behind.
        if header.time_us < last.time_us || ahead > u32::MAX / 2 || begins {
            self.recent.clear();
            self.remember(header);
            return Arrival::Restart;
        }
        self.remember(header);
        Arrival::Next { missing: ahead.saturating_sub(1) }
    }

    fn remember(&mut self, header: Header) {
        if self.recent.len() == REMEMBERED {
            self.recent.pop_front();
        }
        self.recent.push_back(header);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrivals(headers: &[(u32, u64)]) -> Vec<Arrival> {
        let mut order = Order::default();
        headers.iter().map(|&(sequence, time_us)| order.take(Header { sequence, time_us }, false)).collect()
    }

    #[test]
    fn frames_that_come_again_are_neither_restarts_nor_losses() {
        use Arrival::{Again, First, Next};
        let next = Next { missing: 0 };
        let found = arrivals(&[(5, 50), (5, 50), (6, 60), (7, 70), (6, 60), (5, 50), (8, 80)]);
        assert_eq!(found, [First, Again, next, next, Again, Again, next]);
    }

    #[test]
    fn losses_are_counted_over_the_wrap_and_a_restart_by_clock_or_sequence() {
        use Arrival::{First, Next, Restart};
        let found = arrivals(&[(u32::MAX - 1, 10), (2, 20), (0, 5), (1, 6), (0, 9), (3, 10)]);
        let missing = |missing| Next { missing };
        assert_eq!(found, [First, missing(3), Restart, missing(0), Restart, missing(2)]);
    }

    #[test]
    fn a_board_that_starts_the_same_way_again_has_restarted() {
        let mut order = Order::default();
        let at = |sequence, time_us| Header { sequence, time_us };
        order.take(at(0, 100), true);
        order.take(at(1, 200), false);
        assert_eq!(order.take(at(0, 100), true), Arrival::Restart);
        assert_eq!(order.take(at(0, 100), true), Arrival::Again);
    }
}
