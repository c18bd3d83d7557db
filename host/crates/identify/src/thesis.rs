//! The thesis's estimator (section A.1.2), as listed: sine fits, admittance, an ellipse through the Nyquist plot, and the
//! circuit read off its extremes. It gives single values; `fit` gives the ones to use.
//!
//! Kept as listed: the frequency of each channel is fitted, the phase of the first channel is taken from the finished
//! admittance instead of from the voltage (right only when the scope triggers at its zero crossing), Cd carries the error of
//! reading the susceptance at the nearest grid point, and fs and fp are grid points. Made general: the listing's fixed
//! frequency windows are four bandwidths round the mode for the ellipse and 0.7 for fs.

use super::sine;
use super::sweep::Sweep;
use nalgebra::{Complex, DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// What the thesis's script prints.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Estimate {
    /// Series resonance (Hz), a grid point.
    pub fs_hz: f64,
    /// Parallel resonance (Hz), a grid point; absent when the line through fs misses the ellipse.
    pub fp_hz: Option<f64>,
    /// Clamped capacitance (F).
    pub cd_f: f64,
    /// Motional capacitance (F).
    pub c_f: Option<f64>,
    /// Motional inductance (H).
    pub l_h: Option<f64>,
    /// Dielectric loss (Ω); negative when the ellipse crosses the axis.
    pub rd_ohm: f64,
    /// Motional resistance (Ω).
    pub r_ohm: f64,
}

/// An ellipse in the Nyquist plot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    /// Centre (S).
    pub centre: Complex<f64>,
    /// Semi-axis along `tilt` (S).
    pub a: f64,
    /// Semi-axis across (S).
    pub b: f64,
    /// Angle of the first axis (rad).
    pub tilt: f64,
}

impl Ellipse {
    /// The conic of least squared algebraic distance, normalised so that its constant term is −1 about the mean.
    pub fn fit(points: &[Complex<f64>]) -> Option<Self> {
        if points.len() < 6 {
            return None;
        }
        let mean = points.iter().sum::<Complex<f64>>() / points.len() as f64;
        let spread = (points.iter().map(|p| (p - mean).norm_sqr()).sum::<f64>() / points.len() as f64).sqrt();
        let design = DMatrix::from_fn(points.len(), 5, |i, j| {
            let z = (points[i] - mean) / spread;
            [z.re * z.re, z.re * z.im, z.im * z.im, z.re, z.im][j]
        });
        let normal = design.transpose() * &design;
        let right = design.transpose() * DVector::from_element(points.len(), 1.0);
        let k = normal.cholesky()?.solve(&right);
        let (a, b, c, d, e) = (k[0], k[1], k[2], k[3], k[4]);
        let determinant = 4.0 * a * c - b * b;
        if determinant <= 0.0 {
            return None;
        }
        let centre = Complex::new((b * e - 2.0 * c * d) / determinant, (b * d - 2.0 * a * e) / determinant);
        let level = 1.0 + a * centre.re.powi(2) + b * centre.re * centre.im + c * centre.im.powi(2);
        let tilt = 0.5 * b.atan2(a - c);
        let (sin, cos) = tilt.sin_cos();
        let along = a * cos * cos + b * cos * sin + c * sin * sin;
        let across = a * sin * sin - b * cos * sin + c * cos * cos;
        let (a2, b2) = (level / along, level / across);
        (a2 > 0.0 && b2 > 0.0).then(|| Self {
            centre: mean + centre * spread,
            a: a2.sqrt() * spread,
            b: b2.sqrt() * spread,
            tilt,
        })
    }

    /// The point at parameter `t` (rad).
    pub fn at(&self, t: f64) -> Complex<f64> {
        self.centre + Complex::from_polar(1.0, self.tilt) * Complex::new(self.a * t.cos(), self.b * t.sin())
    }

    /// Points with the least and the greatest conductance.
    fn extremes(&self) -> (Complex<f64>, Complex<f64>) {
        let t = (-self.b * self.tilt.sin()).atan2(self.a * self.tilt.cos());
        (self.at(t + std::f64::consts::PI), self.at(t))
    }

    /// Where the ray from the origin towards `through` first meets the ellipse.
    fn first_on_ray(&self, through: Complex<f64>) -> Option<Complex<f64>> {
        let turn = Complex::from_polar(1.0, -self.tilt);
        let scaled = |z: Complex<f64>| Complex::new(z.re / self.a, z.im / self.b);
        let (u, o) = (scaled(through * turn), scaled(-self.centre * turn));
        let (qa, qb, qc) = (u.norm_sqr(), (u * o.conj()).re, o.norm_sqr() - 1.0);
        let root = qb * qb - qa * qc;
        if root < 0.0 {
            return None;
        }
        [(-qb - root.sqrt()) / qa, (-qb + root.sqrt()) / qa].into_iter().find(|s| *s > 0.0).map(|s| through * s)
    }
}

/// The admittances as the listing computes them: from the waveforms where there are any.
pub fn admittances(sweep: &Sweep) -> Vec<(f64, Complex<f64>)> {
    let Some(shunt) = sweep.shunt_ohm.filter(|_| !sweep.waveforms.is_empty()) else {
        return sweep.points.iter().map(|p| (p.frequency_hz, p.admittance_s)).collect();
    };
    sweep
        .waveforms
        .par_iter()
        .filter_map(|w| {
            let one = sine::fit_free(w.frequency_hz, &w.time_s, &w.v1)?.phasor;
            let two = sine::fit_free(w.frequency_hz, &w.time_s, &w.v2)?.phasor;
            let (a1, a2) = (one.norm(), two.norm());
            let y = (Complex::from_polar(a1, -two.arg()) - a2) / (a2 * shunt);
            Some((w.frequency_hz, Complex::from_polar(y.norm(), y.arg() - one.arg())))
        })
        .collect()
}

/// Reads the circuit off the Nyquist plot, near the resonance `fs_hz` of quality factor `q`. `None` when the points there
/// form no ellipse.
pub fn estimate(points: &[(f64, Complex<f64>)], fs_hz: f64, q: f64) -> Option<(Estimate, Ellipse)> {
    let bandwidth = fs_hz / q;
    let within = |f: f64, widths: f64| (f - fs_hz).abs() <= widths * bandwidth;
    let window: Vec<Complex<f64>> = points.iter().filter(|(f, _)| within(*f, 4.0)).map(|p| p.1).collect();
    let ellipse = Ellipse::fit(&window)?;
    let (left, right) = ellipse.extremes();
    let at_fs = points
        .iter()
        .enumerate()
        .filter(|(_, (f, _))| within(*f, 0.7))
        .min_by(|a, b| (a.1.1.im - right.im).abs().total_cmp(&(b.1.1.im - right.im).abs()))?;
    let (index, (fs, y_fs)) = (at_fs.0, *at_fs.1);
    let fp = ellipse.first_on_ray(y_fs).and_then(|p| {
        points[index..].iter().min_by(|a, b| (a.1.re - p.re).abs().total_cmp(&(b.1.re - p.re).abs())).map(|p| p.0)
    });
    let cd = y_fs.im / (TAU * fs);
    let c = fp.filter(|fp| *fp > fs).map(|fp| cd * (fp * fp - fs * fs) / (fs * fs));
    let rd = 1.0 / left.re;
    Some((
        Estimate {
            fs_hz: fs,
            fp_hz: fp,
            cd_f: cd,
            c_f: c,
            l_h: c.map(|c| 1.0 / (c * (TAU * fs).powi(2))),
            rd_ohm: rd,
            r_ohm: 1.0 / (right.re - 1.0 / rd),
        },
        ellipse,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilted_ellipse_comes_back() {
        let truth = Ellipse { centre: Complex::new(3e-5, 2e-4), a: 4e-5, b: 2e-5, tilt: 0.4 };
        let points: Vec<_> = (0..100).map(|i| truth.at(i as f64 * 0.05)).collect();
        let found = Ellipse::fit(&points).unwrap();
        let (left, right) = found.extremes();
        let sampled: Vec<_> = (0..100_000).map(|i| truth.at(i as f64 * TAU / 1e5).re).collect();
        assert!((right.re - sampled.iter().cloned().fold(f64::MIN, f64::max)).abs() < 1e-10);
        assert!((left.re - sampled.iter().cloned().fold(f64::MAX, f64::min)).abs() < 1e-10);
        assert!((found.centre - truth.centre).norm() < 1e-12);
    }

    #[test]
    fn the_ray_meets_the_near_side() {
        let circle = Ellipse { centre: Complex::new(3.0, 0.0), a: 1.0, b: 1.0, tilt: 0.3 };
        assert!((circle.first_on_ray(Complex::new(8.0, 0.0)).unwrap().re - 2.0).abs() < 1e-12);
        assert!(circle.first_on_ray(Complex::new(0.0, 1.0)).is_none());
    }
}
