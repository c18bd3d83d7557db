//! The Butterworth–Van Dyke circuit of a stator and its admittance (thesis section A.3).
//!
//! The clamped capacitance and the dielectric loss sit in parallel with one series branch a vibration mode:
//! Y(ω) = jωCd + 1/Rd + Σ 1/(R + jωL + 1/(jωC)).
//! Leads and a lossy dielectric may be added: a series resistance and inductance in front, and a loss tangent on Cd.

use nalgebra::{Complex, DMatrix, DVector};
use std::f64::consts::TAU;

/// One motional branch, by what a sweep determines best: its resonance, its capacitance and its quality factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mode {
    /// Series resonance (Hz).
    pub fs_hz: f64,
    /// Motional capacitance (F).
    pub c_f: f64,
    /// Quality factor.
    pub q: f64,
}

impl Mode {
    /// The branch with the given elements: inductance (H), capacitance (F), resistance (Ω).
    pub fn from_elements(l_h: f64, c_f: f64, r_ohm: f64) -> Self {
        Self { fs_hz: 1.0 / (TAU * (l_h * c_f).sqrt()), c_f, q: (l_h / c_f).sqrt() / r_ohm }
    }

    /// Motional inductance (H).
    pub fn l_h(&self) -> f64 {
        1.0 / (self.c_f * (TAU * self.fs_hz).powi(2))
    }

    /// Motional resistance (Ω).
    pub fn r_ohm(&self) -> f64 {
        1.0 / (TAU * self.fs_hz * self.c_f * self.q)
    }

    /// Motional conductance at resonance (S): the diameter of the mode's circle in the Nyquist plot.
    pub fn peak_s(&self) -> f64 {
        TAU * self.fs_hz * self.c_f * self.q
    }

    /// Parallel resonance against the clamped capacitance `cd_f` (Hz): fp² = fs²(1 + C/Cd).
    pub fn fp_hz(&self, cd_f: f64) -> f64 {
        self.fs_hz * (1.0 + self.c_f / cd_f).sqrt()
    }

    /// Admittance of the branch (S).
    pub fn admittance(&self, frequency_hz: f64) -> Complex<f64> {
        let x = frequency_hz / self.fs_hz;
        Complex::new(0.0, TAU * frequency_hz * self.c_f) / Complex::new(1.0 - x * x, x / self.q)
    }
}

/// A stator's equivalent circuit.
#[derive(Debug, Clone, PartialEq)]
pub struct Circuit {
    /// Clamped capacitance (F), the capacitance of cables and probes across the stator included.
    pub cd_f: f64,
    /// Dielectric loss conductance 1/Rd (S).
    pub loss_s: f64,
    /// Loss tangent of the clamped capacitance.
    pub loss_tangent: f64,
    /// Series resistance of the leads (Ω).
    pub lead_ohm: f64,
    /// Series inductance of the leads (H).
    pub lead_h: f64,
    /// Vibration modes.
    pub modes: Vec<Mode>,
}

impl Circuit {
    /// The single-mode circuit of the thesis.
    pub fn single(cd_f: f64, rd_ohm: f64, mode: Mode) -> Self {
        Self { cd_f, loss_s: 1.0 / rd_ohm, loss_tangent: 0.0, lead_ohm: 0.0, lead_h: 0.0, modes: vec![mode] }
    }

    /// Admittance behind the leads (S).
    fn inner(&self, frequency_hz: f64) -> Complex<f64> {
        let b = TAU * frequency_hz * self.cd_f;
        self.modes
            .iter()
            .fold(Complex::new(self.loss_s + b * self.loss_tangent, b), |sum, mode| sum + mode.admittance(frequency_hz))
    }

    /// Admittance at the terminals (S).
    pub fn admittance(&self, frequency_hz: f64) -> Complex<f64> {
        let y = self.inner(frequency_hz);
        y / (y * Complex::new(self.lead_ohm, TAU * frequency_hz * self.lead_h) + 1.0)
    }

    /// The mode with the largest conductance peak.
    pub fn main_mode(&self) -> Option<&Mode> {
        self.modes.iter().max_by(|a, b| a.peak_s().total_cmp(&b.peak_s()))
    }
}

/// How a circuit is laid out as a parameter vector: logarithms of what is positive, scaled values of what may be zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    /// Whether leads and loss tangent are free.
    pub parasitics: bool,
    /// Typical admittance of the data (S), the unit of the scaled parameters.
    pub scale_s: f64,
    /// Typical angular frequency of the data (rad/s).
    pub omega: f64,
}

impl Layout {
    /// Number of parameters before the modes'.
    pub fn background(&self) -> usize {
        if self.parasitics { 5 } else { 2 }
    }

    /// The circuit as parameters.
    pub fn pack(&self, circuit: &Circuit) -> DVector<f64> {
        let mut p = vec![circuit.cd_f.ln(), circuit.loss_s / self.scale_s];
        if self.parasitics {
            p.extend([
                circuit.loss_tangent,
                circuit.lead_ohm * self.scale_s,
                circuit.lead_h * self.scale_s * self.omega,
            ]);
        }
        for mode in &circuit.modes {
            p.extend([mode.fs_hz.ln(), mode.c_f.ln(), -mode.q.ln()]);
        }
        DVector::from_vec(p)
    }

    /// The parameters as a circuit.
    pub fn unpack(&self, p: &DVector<f64>) -> Circuit {
        let n = self.background();
        let (tangent, ohm, henry) = if self.parasitics {
            (p[2], p[3] / self.scale_s, p[4] / (self.scale_s * self.omega))
        } else {
            (0.0, 0.0, 0.0)
        };
        Circuit {
            cd_f: p[0].exp(),
            loss_s: p[1] * self.scale_s,
            loss_tangent: tangent,
            lead_ohm: ohm,
            lead_h: henry,
            modes: p.as_slice()[n..]
                .chunks_exact(3)
                .map(|m| Mode { fs_hz: m[0].exp(), c_f: m[1].exp(), q: (-m[2]).exp() })
                .collect(),
        }
    }

    /// ∂Y/∂p at one frequency, one entry a parameter.
    pub fn gradient(&self, circuit: &Circuit, frequency_hz: f64, out: &mut Vec<Complex<f64>>) {
        out.clear();
        let omega = TAU * frequency_hz;
        let b = omega * circuit.cd_f;
        let y = circuit.inner(frequency_hz);
        let lead = Complex::new(circuit.lead_ohm, omega * circuit.lead_h);
        let through = (y * lead + 1.0).powi(-2);
        out.push(Complex::new(b * circuit.loss_tangent, b) * through);
        out.push(Complex::new(self.scale_s, 0.0) * through);
        if self.parasitics {
            out.push(Complex::new(b, 0.0) * through);
            let by_impedance = -(y * y) * through;
            out.push(by_impedance / self.scale_s);
            out.push(by_impedance * Complex::new(0.0, omega / (self.scale_s * self.omega)));
        }
        for mode in &circuit.modes {
            // Y = jωC/D with D = 1 − x² + jx/Q and x = f/fs.
            let x = frequency_hz / mode.fs_hz;
            let d = Complex::new(1.0 - x * x, x / mode.q);
            let branch = Complex::new(0.0, omega * mode.c_f) / d;
            out.push(-branch / d * Complex::new(2.0 * x * x, -x / mode.q) * through);
            out.push(branch * through);
            out.push(-branch / d * Complex::new(0.0, x / mode.q) * through);
        }
    }

    /// ∂Y/∂p over a sweep: two rows a frequency (real, imaginary), divided by `sigma` (S).
    pub fn jacobian(&self, circuit: &Circuit, frequency_hz: &[f64], sigma: &[f64]) -> DMatrix<f64> {
        let columns = self.background() + 3 * circuit.modes.len();
        let mut jacobian = DMatrix::zeros(2 * frequency_hz.len(), columns);
        let mut row = Vec::with_capacity(columns);
        for (i, (&f, &s)) in frequency_hz.iter().zip(sigma).enumerate() {
            self.gradient(circuit, f, &mut row);
            for (j, d) in row.iter().enumerate() {
                jacobian[(2 * i, j)] = d.re / s;
                jacobian[(2 * i + 1, j)] = d.im / s;
            }
        }
        jacobian
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_modes() -> Circuit {
        Circuit {
            cd_f: 1e-9,
            loss_s: 1e-5,
            loss_tangent: 0.01,
            lead_ohm: 30.0,
            lead_h: 2e-5,
            modes: vec![Mode { fs_hz: 44_000.0, c_f: 6e-12, q: 32.0 }, Mode { fs_hz: 47_000.0, c_f: 2e-12, q: 80.0 }],
        }
    }

    #[test]
    fn the_admittance_is_the_one_of_the_elements() {
        let (l, c, r) = (2.109, 6.166e-12, 18_488.0);
        let circuit = Circuit::single(900e-12, 5e6, Mode::from_elements(l, c, r));
        for f in [30_000.0, 44_100.0, 50_000.0] {
            let w = TAU * f;
            let branch = Complex::new(1.0, 0.0) / Complex::new(r, w * l - 1.0 / (w * c));
            let expected = branch + Complex::new(1.0 / 5e6, w * 900e-12);
            assert!((circuit.admittance(f) - expected).norm() < 1e-9 * expected.norm());
        }
        let mode = circuit.modes[0];
        assert!((mode.l_h() / l - 1.0).abs() < 1e-12 && (mode.r_ohm() / r - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_gradient_is_the_finite_difference() {
        let circuit = two_modes();
        for parasitics in [false, true] {
            let mut circuit = circuit.clone();
            if !parasitics {
                (circuit.loss_tangent, circuit.lead_ohm, circuit.lead_h) = (0.0, 0.0, 0.0);
            }
            let layout = Layout { parasitics, scale_s: 3e-4, omega: 2.7e5 };
            let p = layout.pack(&circuit);
            let mut gradient = Vec::new();
            layout.gradient(&circuit, 45_100.0, &mut gradient);
            for j in 0..p.len() {
                let at = |h: f64| {
                    let mut q = p.clone();
                    q[j] += h;
                    layout.unpack(&q).admittance(45_100.0)
                };
                let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!((numeric - gradient[j]).norm() < 1e-6 * numeric.norm() + 1e-14, "parameter {j}");
            }
        }
    }
}
