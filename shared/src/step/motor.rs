//! A motor for the tests of laws that have a model of one.

use super::Inputs;
use crate::Direction;
use crate::reference::Reference;

/// A rotor in doubles, in counts and ticks: it comes up to its speed within a tick or two, the wave takes a quarter of it back
/// as it dies, and constant friction brakes the rest.
pub(super) struct Motor {
    full: f64,
    was: i32,
    /// What a hand adds to the speed with the drive off, counts a tick², clockwise.
    pub push: f64,
    braking: f64,
    pub place: f64,
    speed: f64,
    pub count: i32,
    pub edge_at: f64,
}

impl Motor {
    /// A rotor at the edge from which it counts; the speed in counts/s, the braking in counts/s².
    pub fn new(full: f64, braking: f64) -> Self {
        let braking = braking * 500e-6 * 500e-6;
        Self { full: full * 500e-6, braking, was: 0, push: 0.0, place: 1e-6, speed: 0.0, count: 0, edge_at: -1e9 }
    }

    /// What the step sees of it at a tick of a run after a reference.
    pub fn sees(&self, reference: &Reference, tick: u32) -> Inputs {
        let target = reference.at(u64::from(tick) * 500);
        Inputs {
            target: target.position,
            target_rate: target.rate,
            target_fraction: target.fraction,
            position: self.count,
            edge_age_us: ((f64::from(tick) - self.edge_at) * 500.0) as u16,
        }
    }

    /// A tick under a drive, which ends at `now` ticks; counted in the sense of the drive's direction.
    pub fn turn(&mut self, drive: i32, direction: Direction, now: f64) {
        let steps = 50;
        let dies = drive == 0 && self.was != 0;
        self.was = drive;
        for step in 1..=steps {
            let dt = 1.0 / f64::from(steps);
            if drive != 0 {
                self.speed += (f64::from(drive) * self.full - self.speed) * dt;
            } else {
                self.speed *= if dies { 0.75f64.powf(dt) } else { 1.0 };
                if self.speed != 0.0 {
                    self.speed += self.push * dt;
                }
                self.speed -= self.speed.signum() * (self.braking * dt).min(self.speed.abs());
            }
            let before = self.place.floor();
            self.place += self.speed * dt;
            let edges = (self.place.floor() - before).abs() as i32;
            if edges > 0 {
                self.count += edges * direction.sign();
                self.edge_at = now - 1.0 + f64::from(step) * dt;
            }
        }
    }
}
