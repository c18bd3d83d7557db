//! Two orthogonal standing waves as slowly varying complex amplitudes, in the frame that turns with the drive's frequency.
//!
//! Of a displacement Re\[(a₁ cos nθ + a₂ sin nθ) exp(iωt)\] the amplitudes follow τ ȧ = push − (1 + i x) a, where x is the drive's
//! distance from the mode in half-widths of its resonance and τ = 2Q/ω. The surface moves sideways, where it is highest, with
//! Im(ā₁ a₂) over the height there, whatever the place: the Wronskian of the two is constant.

use super::motor::Motor;

/// A complex amplitude.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Phasor {
    re: f64,
    im: f64,
}

impl Phasor {
    fn times(self, b: Self) -> Self {
        Self { re: self.re * b.re - self.im * b.im, im: self.re * b.im + self.im * b.re }
    }

    fn square(self) -> f64 {
        self.re * self.re + self.im * self.im
    }

    fn turned(length: f64, angle: f64) -> Self {
        Self { re: length * angle.cos(), im: length * angle.sin() }
    }

    /// 1/(1 + i x).
    fn response(x: f64) -> Self {
        let square = 1.0 + x * x;
        Self { re: 1.0 / square, im: -x / square }
    }
}

/// What the two modes are driven with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tuning {
    /// Distance of the drive from the modes' mean in half-widths.
    pub detuning: f64,
    /// Error of the quadrature in rad.
    pub quadrature: f64,
    /// Direction of the wave.
    pub sign: f64,
}

/// The state of the two modes.
#[derive(Debug, Clone)]
pub struct Stator {
    modes: [Phasor; 2],
    goal: [Phasor; 2],
    decay: [Phasor; 2],
    split: f64,
    /// Step over the time constant.
    step: f64,
    push: f64,
    tuning: Tuning,
}

impl Stator {
    /// At rest; to be followed in steps of `dt` s.
    pub fn new(motor: &Motor, dt: f64) -> Self {
        let tuning = Tuning { detuning: motor.detuning, quadrature: motor.quadrature, sign: 1.0 };
        let mut new = Self {
            modes: [Phasor::default(); 2],
            goal: [Phasor::default(); 2],
            decay: [Phasor::default(); 2],
            split: motor.split,
            step: dt / motor.wave_s,
            push: push(motor),
            tuning,
        };
        new.set(tuning);
        new
    }

    /// Tunes the drive; what changes the wave by less than a ten-thousandth waits until it is more.
    pub fn tune(&mut self, to: Tuning) {
        let now = &self.tuning;
        if (to.detuning - now.detuning).abs() + (to.quadrature - now.quadrature).abs() > 1e-4 || to.sign != now.sign {
            self.set(to);
        }
    }

    fn set(&mut self, to: Tuning) {
        self.tuning = to;
        let x = [to.detuning - 0.5 * self.split, to.detuning + 0.5 * self.split];
        self.decay = x.map(|x| Phasor::turned((-self.step).exp(), -self.step * x));
        let ahead = to.sign * std::f64::consts::FRAC_PI_2 + to.quadrature;
        let drives = [Phasor::turned(self.push, 0.0), Phasor::turned(self.push, ahead)];
        self.goal = [drives[0].times(Phasor::response(x[0])), drives[1].times(Phasor::response(x[1]))];
    }

    /// One step, exact for a steady push, with `level` of the voltage (the share of the step that the drive is on, in it).
    #[inline]
    pub fn step(&mut self, level: f64) {
        for k in 0..2 {
            let goal = Phasor { re: self.goal[k].re * level, im: self.goal[k].im * level };
            let off = Phasor { re: self.modes[k].re - goal.re, im: self.modes[k].im - goal.im }.times(self.decay[k]);
            self.modes[k] = Phasor { re: goal.re + off.re, im: goal.im + off.im };
        }
    }

    /// Speed of the wave's surface and its amplitude, both over the steady ones.
    #[inline]
    pub fn surface(&self) -> [f64; 2] {
        let [a, b] = self.modes;
        let height = (0.5 * (a.square() + b.square())).sqrt();
        if height < 1e-6 {
            return [0.0; 2];
        }
        [(a.re * b.im - a.im * b.re) / height, height]
    }
}

/// Push on the modes at which the wave's surface is as fast as the motor's full speed.
fn push(motor: &Motor) -> f64 {
    1.0 / steady_surface(motor).max(0.05)
}

/// Speed of the surface that a push of 1 makes in the end.
pub fn steady_surface(motor: &Motor) -> f64 {
    let x = [motor.detuning - 0.5 * motor.split, motor.detuning + 0.5 * motor.split];
    let a = Phasor::response(x[0]);
    let b = Phasor::turned(1.0, std::f64::consts::FRAC_PI_2 + motor.quadrature).times(Phasor::response(x[1]));
    (a.re * b.im - a.im * b.re) / (0.5 * (a.square() + b.square())).sqrt()
}
