//! The hardware watchdog is fed only while both the control interrupt and the communication tasks advance.

use crate::shared::Shared;
use embassy_time::{Duration, Ticker};

/// How often progress is checked. The hardware timeout must be longer than this.
pub const FEED_PERIOD_MS: u64 = 100;

/// A board's hardware watchdog, already running.
pub trait Watchdog {
    /// Postpones the reset by the full timeout.
    fn feed(&mut self);
}

/// Feeds the watchdog while there is progress; a hung control core or a hung task lets it bite. Never returns.
pub async fn supervise<W: Watchdog>(shared: &Shared, mut watchdog: W) {
    let mut seen = (shared.ticks(), shared.transmit_turns());
    let mut ticker = Ticker::every(Duration::from_millis(FEED_PERIOD_MS));
    loop {
        ticker.next().await;
        let now = (shared.ticks(), shared.transmit_turns());
        if now.0 != seen.0 && now.1 != seen.1 {
            watchdog.feed();
            seen = now;
        }
    }
}
