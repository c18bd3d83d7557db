//! The wave's height after a switching.

use super::motion::decayed;

/// The stator's wave: it follows the drive with a time constant, and carries the rotor from some height on.
pub(super) struct Wave {
    /// Time constants in s of building up and of dying away.
    builds_up_s: f64,
    dies_s: f64,
    /// Share of its full height from which it carries the rotor.
    lift: f64,
    /// Speed of the full crest in rad/s.
    pub(super) full: f64,
    /// What the contact accelerates or brakes the rotor by, in rad/s².
    pub(super) rate: f64,
    /// Whether it is driven, since when (s), and its height then (share of the full one).
    driven: bool,
    since: f64,
    height: f64,
}

/// Time constants after which the wave is at its height, or gone, to a few thousandths.
const SETTLED: f64 = 5.0;
/// First step after a switching, and how later ones grow with the time since a rise, in time constants: the crest moves in a straight line
/// within one.
const STEP: f64 = 0.5;
const GROWTH: f64 = 1.0;

impl Wave {
    /// A wave that is not driven and not there.
    pub(super) fn new([builds_up_s, dies_s]: [f64; 2], lift: f64, full: f64, rate: f64) -> Self {
        let lift = lift.clamp(GONE, MOST_LIFT);
        Self { builds_up_s, dies_s, lift, full, rate, driven: false, since: 0.0, height: 0.0 }
    }

    /// Where it goes, and in which time constant (s).
    fn going(&self) -> (f64, f64) {
        if self.driven { (1.0, self.builds_up_s) } else { (0.0, self.dies_s) }
    }

    /// Its height as a share of the full one.
    pub(super) fn height_at(&self, t: f64) -> f64 {
        let (goal, tau) = self.going();
        let age = (t - self.since).max(0.0);
        // A wave without inertia is where it goes at once.
        let kept = if tau > 0.0 { decayed(age / tau) } else { 0.0 };
        goal + (self.height - goal) * kept
    }

    /// Its height at both ends of a straight course between two times, which is as high as the wave on average.
    pub(super) fn course(&self, from: f64, to: f64) -> [f64; 2] {
        let start = self.height_at(from);
        let (goal, tau) = self.going();
        if tau <= 0.0 {
            return [start, self.height_at(to)];
        }
        let x = (to - from) / tau;
        let kept = decayed(x);
        let ends = [start, goal + (start - goal) * kept];
        let mean = if x > 1e-6 { goal + (start - goal) * (1.0 - kept) / x } else { start };
        ends.map(|height| height + mean - 0.5 * (ends[0] + ends[1]))
    }

    /// The drive is switched at `t`.
    pub(super) fn switch(&mut self, t: f64, driven: bool) {
        self.height = self.height_at(t);
        self.since = t;
        self.driven = driven;
    }

    /// What happened before lies `later` seconds later: a period that repeats one before it.
    pub(super) fn shift(&mut self, later: f64) {
        self.since += later;
    }

    pub(super) fn driven(&self) -> bool {
        self.driven
    }

    /// When it begins to carry the rotor after a rise, or stops after a fall.
    pub(super) fn crosses_lift(&self) -> f64 {
        let (goal, tau) = self.going();
        let [from, to] = [self.height, self.lift].map(|h| (h - goal).abs());
        if from > to { self.since + tau * (from / to).ln() } else { self.since }
    }

    /// The longest step from `t` in which the crest moves in a straight line.
    pub(super) fn step_s(&self, t: f64) -> f64 {
        let (age, (_, tau)) = ((t - self.since).max(0.0), self.going());
        if self.driven && age >= SETTLED * tau {
            f64::INFINITY
        } else if self.driven {
            (STEP * tau).max(GROWTH * age)
        } else {
            STEP * tau
        }
    }
}

/// Height at which a wave is gone (e⁻⁵), and one from which it has to carry: at its full height alone it would not at all.
const GONE: f64 = 0.0067;
const MOST_LIFT: f64 = 0.9;
