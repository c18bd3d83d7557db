//! A motor and its load on an elastic coupling: the speed of one of them beside that of a rotor with a lag.
//!
//! With r the load's inertia over the motor's, τ the lag on a stiff shaft (the friction is the motor's: what goes with its speed is mostly
//! the voltage that it induces) and ω₀, ζ the swing of both against one another, the torque of the coupling is
//! M = k·φ + c·φ', k = ω₀²/(1 + r), c = 2·ζ·ω₀/(1 + r), φ' = ω₁ − ω₂, and τ·ω₁' = (1 + r)·(drive − ω₁) − τ·r·M, ω₂' = M.
//! Together they have the poles of s³ + (b + c·(1 + r))·s² + (k·(1 + r) + b·c)·s + b·k, b = (1 + r)/τ: a lag τ' and a pair that swings. The
//! motor has the zeros of 1 + (c/k)·s + s²/k beside them, the load that of 1 + (c/k)·s.
//! Reference: Schröder, Elektrische Antriebe: Regelung von Antriebssystemen, on the elastic two-mass system.

use super::values::{P, Values};

/// The swing of a motor and its load.
pub struct Swing {
    lag_s: f64,
    /// The pair of poles: frequency without damping in 1/s and damping ratio.
    own: f64,
    damping: f64,
    /// What is seen beside the speed v behind the lag, of e and of ψ, where e'' + 2·ζ·ω·e' + ω²·e = v'' and ψ' = e.
    seen: [f64; 2],
    /// ψ in rpm·s and e in rpm.
    twist: f64,
    behind: f64,
    /// Intervals in s that come again and again, with what they leave of the lag and the cosine and sine of the swing, decayed.
    kept: [(f64, [f64; 3]); 4],
    next: usize,
}

impl Swing {
    /// The swing of a plant, if there is one: of its motor or its load, whichever has an inertia beside it.
    pub fn of(values: &Values) -> Option<Self> {
        let (time_s, damping) = (values.get(P::Swing), values.get(P::SwingDamping));
        let (of_motor, of_load) = (values.get(P::SwingOfMotor), values.get(P::SwingOfLoad));
        let share = of_motor.max(of_load);
        if time_s <= 0.0 || share <= 0.0 {
            return None;
        }
        let (k, c) = (time_s.powi(-2) / (1.0 + share), 2.0 * damping / time_s / (1.0 + share));
        let b = (1.0 + share) / values.lag_s();
        let (a2, a1, a0) = (b + c * (1.0 + share), k * (1.0 + share) + b * c, b * k);
        let root = real_root(a2, a1, a0);
        let (twice, square) = (a2 + root, -a0 / root);
        let own = square.sqrt();
        // Beyond critical damping nothing swings; the bound keeps the closed form one.
        let damping = (0.5 * twice / own).clamp(0.0, 0.999);
        let motor = if of_motor > 0.0 { square / k } else { 0.0 };
        let seen = [motor - 1.0, square * c / k - 2.0 * damping * own];
        Some(Self {
            lag_s: -1.0 / root,
            own,
            damping,
            seen,
            twist: 0.0,
            behind: 0.0,
            kept: [(f64::NAN, [0.0; 3]); 4],
            next: 0,
        })
    }

    /// τ' in s.
    pub fn lag_s(&self) -> f64 {
        self.lag_s
    }

    /// Moves on by `h` while the speed behind the lag changes by `change_rpm`, ever more slowly by that lag.
    pub fn advance(&mut self, h: f64, change_rpm: f64) {
        let (own, damping, rate) = (self.own, self.damping, 1.0 / self.lag_s);
        let damped = own * (1.0 - damping * damping).sqrt();
        let [left, cos, sin] = self.step(h, damped);
        // It swings freely about what this acceleration alone would make of it, which dies with the lag.
        let made = change_rpm * rate / (1.0 - left) / (rate * rate - 2.0 * damping * own * rate + own * own);
        let (x, v) = (self.twist - made, self.behind + rate * made);
        self.twist = made * left + x * cos + (v + damping * own * x) / damped * sin;
        self.behind = -rate * made * left + v * cos - (damping * own * v + own * own * x) / damped * sin;
    }

    fn step(&mut self, h: f64, damped: f64) -> [f64; 3] {
        if let Some(known) = self.kept.iter().find(|k| k.0 == h) {
            return known.1;
        }
        let decay = (-self.damping * self.own * h).exp();
        let step = [(-h / self.lag_s).exp(), decay * (damped * h).cos(), decay * (damped * h).sin()];
        self.kept[self.next] = (h, step);
        self.next = (self.next + 1) % self.kept.len();
        step
    }

    /// What is seen beyond the speed behind the lag, in rpm.
    pub fn rpm(&self) -> f64 {
        self.seen[0] * self.behind + self.seen[1] * self.twist
    }

    /// The way that this has made where that speed is `rpm` now, in rpm·s.
    pub fn way(&self, rpm: f64) -> f64 {
        let whole = (rpm - self.behind - 2.0 * self.damping * self.own * self.twist) / (self.own * self.own);
        self.seen[0] * self.twist + self.seen[1] * whole
    }
}

/// A real root of a cubic whose roots are those of a stable plant: between −a2, where it is a0 − a1·a2 < 0 (Routh and Hurwitz), and 0, where
/// it is a0 > 0. By halves: Newton's steps leave it where the load swings more slowly than the motor.
fn real_root(a2: f64, a1: f64, a0: f64) -> f64 {
    let (mut low, mut high) = (-a2, 0.0);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if ((middle + a2) * middle + a1) * middle + a0 > 0.0 {
            high = middle;
        } else {
            low = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if the swing is not that of two inertias with a spring and a damper between them, on either of them.
    #[test]
    fn a_load_on_a_spring_swings_as_two_inertias_do() {
        let (share, time_s, damping, lag, h) = (0.6, 0.025, 0.12, 0.05, 1e-3);
        let values = Values::line(300.0, lag).with(P::Swing, time_s).with(P::SwingDamping, damping);
        let both = |p: P| Swing::of(&values.with(p, share)).expect("it swings");
        let (mut of_motor, mut of_load) = (both(P::SwingOfMotor), both(P::SwingOfLoad));
        let (spring, damper) = (time_s.powi(-2) / (1.0 + share), 2.0 * damping / time_s / (1.0 + share));
        let (mut motor, mut load, mut twist, mut ways) = (0.0, 0.0, 0.0, [0.0; 2]);
        let behind_lag = |t: f64| 300.0 * (1.0 - (-t / of_motor.lag_s()).exp());
        let speeds: Vec<f64> = (0..=400).map(|k| behind_lag(f64::from(k) * h)).collect();
        let whole = 300.0 * 0.4 - of_motor.lag_s() * speeds[400];
        let fine = 1e-6;
        for w in speeds.windows(2) {
            for _ in 0..1000 {
                let torque = spring * twist + damper * (motor - load);
                motor += fine * ((1.0 + share) / lag * (300.0 - motor) - share * torque);
                load += fine * torque;
                twist += fine * (motor - load);
                ways = [ways[0] + fine * motor, ways[1] + fine * load];
            }
            for swing in [&mut of_motor, &mut of_load] {
                swing.advance(h, w[1] - w[0]);
            }
            assert!((w[1] + of_motor.rpm() - motor).abs() < 0.02, "motor {} {motor}", w[1] + of_motor.rpm());
            assert!((w[1] + of_load.rpm() - load).abs() < 0.02, "load {} {load}", w[1] + of_load.rpm());
        }
        let last = speeds[400];
        for (swing, way) in [&of_motor, &of_load].into_iter().zip(ways) {
            assert!((whole + swing.way(last) - way).abs() < 1e-3, "{} {way}", whole + swing.way(last));
        }
    }

    /// Fails if the root is none: every plant of the bounds has its lag, and a finite swing.
    #[test]
    fn every_coupling_has_a_lag_of_its_own() {
        for share in [0.01, 0.4, 3.0, 30.0] {
            for time_s in [1e-5, 0.01, 0.1, 10.0] {
                for damping in [1e-3, 0.1, 0.7] {
                    let values = Values::line(300.0, 0.1).with(P::Swing, time_s).with(P::SwingDamping, damping);
                    let mut swing = Swing::of(&values.with(P::SwingOfMotor, share)).expect("it swings");
                    let (k, c) = (time_s.powi(-2) / (1.0 + share), 2.0 * damping / time_s / (1.0 + share));
                    let b = (1.0 + share) / 0.1;
                    let s = -1.0 / swing.lag_s();
                    let terms = [s * s * s, (b + c * (1.0 + share)) * s * s, (k * (1.0 + share) + b * c) * s, b * k];
                    let size = terms.iter().map(|t| t.abs()).fold(0.0, f64::max);
                    assert!(terms.iter().sum::<f64>().abs() < 1e-9 * size, "{share} {time_s} {damping}: {s}");
                    swing.advance(1e-3, 1.0);
                    assert!(swing.rpm().is_finite() && swing.way(1.0).is_finite(), "{share} {time_s} {damping}");
                }
            }
        }
    }

    /// Fails if a plant without a coupling swings.
    #[test]
    fn a_stiff_shaft_does_not_swing() {
        assert!(Swing::of(&Values::line(300.0, 0.05)).is_none());
    }
}
