//! The numbers of the plant, and its actuator's map with the inverse of it.

/// A number of the plant; 0 means absent but for the first two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum P {
    /// K: speed at the largest input, in rpm.
    Gain,
    /// ln of τ in s.
    LogLag,
    /// By how much the record's input is early, in samples of the run: one or less is how loggers are written.
    Skew,
    /// Dead time in s, beyond that.
    DeadTime,
    /// Second lag in s.
    SecondLag,
    /// Coulomb friction as a share of the largest input.
    Coulomb,
    /// By how much it is larger forwards and smaller backwards, relative.
    FrictionSplit,
    /// What friction at rest has more, as a share of the largest input.
    Stiction,
    /// Load, as a share of the largest input.
    Bias,
    /// Part of the input that the actuator loses.
    DeadZone,
    /// By how much it is larger forwards, relative.
    DeadSplit,
    /// By how much the gain is larger forwards, relative.
    GainSplit,
    /// Bend b of u/(1 + (b·u)^p)^(1/p).
    Bend,
    /// By how much its power p is above 1: a bend at once, or one behind a straight beginning.
    BendPower,
    /// Share of the range over which the top is flat.
    FlatTop,
    /// Torque over the strongest order of the angle, cosine, as a share of the largest input.
    CoggingCos,
    /// The same, sine.
    CoggingSin,
    /// Torque over a second order, cosine.
    Cogging2Cos,
    /// The same, sine.
    Cogging2Sin,
    /// Share of the input's torque that goes with the strongest order of the angle, cosine.
    RippleCos,
    /// The same, sine.
    RippleSin,
    /// Torque of the largest load that was measured, as a share of the largest input.
    Load,
    /// Share of the input's torque that is lost with every kelvin.
    Heating,
    /// Half width of the corner of the dead zone, as a share of the largest input.
    Corner,
    /// Speed at which what friction at rest has more is gone, as a share of the gain; 0: at once.
    StribeckSpeed,
    /// Time in s in which a load behind an elastic coupling swings through a radian, 1/ω.
    Swing,
    /// Damping ratio of that.
    SwingDamping,
    /// Inertia of the load over the motor's, of which the motor is seen.
    SwingOfMotor,
    /// The same, where the load is seen.
    SwingOfLoad,
}

impl P {
    /// All, in their order.
    pub const ALL: [P; COUNT] = [
        P::Gain,
        P::LogLag,
        P::Skew,
        P::DeadTime,
        P::SecondLag,
        P::Coulomb,
        P::FrictionSplit,
        P::Stiction,
        P::Bias,
        P::DeadZone,
        P::DeadSplit,
        P::GainSplit,
        P::Bend,
        P::BendPower,
        P::FlatTop,
        P::CoggingCos,
        P::CoggingSin,
        P::Cogging2Cos,
        P::Cogging2Sin,
        P::RippleCos,
        P::RippleSin,
        P::Load,
        P::Heating,
        P::Corner,
        P::StribeckSpeed,
        P::Swing,
        P::SwingDamping,
        P::SwingOfMotor,
        P::SwingOfLoad,
    ];
}

/// How many numbers there are.
pub const COUNT: usize = P::SwingOfLoad as usize + 1;

/// All numbers of a plant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Values([f64; COUNT]);

impl Values {
    /// A gain and a lag alone.
    pub fn line(gain_rpm: f64, lag_s: f64) -> Self {
        let mut v = Self([0.0; COUNT]);
        v.set(P::Gain, gain_rpm);
        v.set(P::LogLag, lag_s.ln());
        v
    }

    /// One number.
    pub fn get(&self, p: P) -> f64 {
        self.0[p as usize]
    }

    /// Sets one number.
    pub fn set(&mut self, p: P, value: f64) {
        self.0[p as usize] = value;
    }

    /// With one number changed.
    pub fn with(mut self, p: P, value: f64) -> Self {
        self.set(p, value);
        self
    }

    /// τ in s.
    pub fn lag_s(&self) -> f64 {
        self.get(P::LogLag).exp()
    }

    /// What the actuator makes of an input.
    pub fn actuated(&self, input: f64) -> f64 {
        let sign = if input < 0.0 { -1.0 } else { 1.0 };
        let zone = self.get(P::DeadZone) * (1.0 + sign * self.get(P::DeadSplit));
        let top = 1.0 - self.get(P::FlatTop);
        let x = self.rounded(input.abs().min(top) - zone);
        sign * self.bent(x, 1.0) * (1.0 + sign * self.get(P::GainSplit))
    }

    /// What is over a threshold, with a corner as a ripple of the input about its mean makes one: the mean of max(x, 0) over ± its half width.
    fn rounded(&self, over: f64) -> f64 {
        let half = self.get(P::Corner);
        if over.abs() < half { (over + half).powi(2) / (4.0 * half) } else { over.max(0.0) }
    }

    /// A positive input bent (`side` 1) or unbent (-1); what no input is bent to is no number.
    fn bent(&self, x: f64, side: f64) -> f64 {
        let (bend, power) = (self.get(P::Bend), 1.0 + self.get(P::BendPower));
        if power == 1.0 {
            return x / (1.0 + side * bend * x);
        }
        x / (1.0 + side * (bend * x).powf(power)).powf(1.0 / power)
    }

    /// The input of which the actuator makes `x`; none where it cannot.
    pub fn input_for(&self, x: f64) -> Option<f64> {
        if x == 0.0 {
            return Some(0.0);
        }
        let sign = x.signum();
        let straight = self.bent(x.abs() / (1.0 + sign * self.get(P::GainSplit)), -1.0);
        let half = self.get(P::Corner);
        let over = if straight < half { 2.0 * (half * straight).sqrt() - half } else { straight };
        let input = over + self.get(P::DeadZone) * (1.0 + sign * self.get(P::DeadSplit));
        (straight >= 0.0 && input <= 1.0 - self.get(P::FlatTop)).then_some(sign * input)
    }

    /// Whether a number acts on the input before anything moves.
    pub fn is_of_actuator(p: P) -> bool {
        matches!(p, P::DeadZone | P::DeadSplit | P::Corner | P::GainSplit | P::Bend | P::BendPower | P::FlatTop)
    }

    /// Friction of a sense of motion, as a share of the largest input.
    pub fn friction(&self, sense: f64) -> f64 {
        self.get(P::Coulomb) * (1.0 + sense * self.get(P::FrictionSplit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if the inverse leaves out a part of the actuator, or gives an input beyond its reach.
    #[test]
    fn an_actuator_is_inverted() {
        let v = Values::line(300.0, 0.02).with(P::DeadZone, 0.15).with(P::DeadSplit, 0.2).with(P::Bend, 1.5);
        for v in [v.with(P::GainSplit, -0.1), v.with(P::BendPower, 1.3), v.with(P::Corner, 0.06)] {
            for u in [-1.0, -0.6, -0.2, 0.3, 0.9] {
                let back = v.input_for(v.actuated(u)).expect("it came from an input");
                assert!((back - u).abs() < 1e-9, "{u}: {back}");
            }
            assert_eq!(v.input_for(1.01 * v.actuated(1.0)), None);
            assert_eq!(v.input_for(2.0), None);
        }
    }
}
