//! The wave's crest after a switching.

/// Speed of the wave's crest after the drive was switched: it follows with a time constant.
pub(super) struct Wave {
    pub(super) tau: f64,
    /// Speed of the full crest in rad/s.
    pub(super) full: f64,
    /// What the contact accelerates or brakes the rotor by, in rad/s².
    pub(super) rate: f64,
    /// Speed of the crest at `since`, the last fall.
    pub(super) crest: f64,
    pub(super) since: f64,
}

impl Wave {
    pub(super) fn crest_at(&self, t: f64) -> f64 {
        self.crest * (-(t - self.since).max(0.0) / self.tau).exp()
    }

    /// The drive is on from `from` to `until`.
    pub(super) fn rise(&mut self, from: f64, until: f64) {
        if self.tau > 0.0 {
            self.crest = self.full - (self.full - self.crest_at(from)) * (-(until - from).max(0.0) / self.tau).exp();
            self.since = until;
        }
    }

    /// How long, after a fall, the crest stays faster than a rotor of `speed` that it still pulls, in s.
    pub(super) fn overrun_s(&self, fall: f64, speed: f64) -> f64 {
        if self.tau <= 0.0 {
            return 0.0;
        }
        let crest = self.crest_at(fall);
        let mut time = 0.0;
        for _ in 0..4 {
            time = self.tau * (crest / (speed.abs() + self.rate * time).max(1e-3 * self.full)).max(1.0).ln();
        }
        time
    }

    /// Share of the full crest that is missing at a time.
    pub(super) fn missing(&self, t: f64) -> f64 {
        if self.tau > 0.0 && self.full > 0.0 { 1.0 - self.crest_at(t) / self.full } else { 0.0 }
    }
}
