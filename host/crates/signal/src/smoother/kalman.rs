//! The rotor's state as a Gaussian, carried through time and corrected by angles.

use super::Node;
use nalgebra::{Matrix3, Vector3};

/// Standard deviations of a state nothing is known of: of the speed (pitch/s) and the acceleration (pitch/s²).
const UNKNOWN_SPEED: f64 = 1e3;
const UNKNOWN_ACCELERATION: f64 = 1e4;
/// Variance that the speed of a rotor gains in a second after the drive took hold of it, until the line first says where it
/// is, in pitch²/s³: the real motor comes to 300 pitch/s within some 4 ms, which makes 2e7 of a random walk.
const KICK: f64 = 1e7;
/// Standard deviation of the speed of a rotor known to stand still, in pitch/s.
const REST_SPEED: f64 = 1e-2;
/// Noise on the acceleration for a jerk of unit strength, in s²: lets a start have a kink in its speed, and vanishes
/// where the strength is small.
const ACCELERATION_NOISE_S2: f64 = 1e-4;

/// What is known of angle (pitch), speed (pitch/s) and acceleration (pitch/s²).
#[derive(Debug, Clone, Copy)]
pub(super) struct Gaussian {
    pub(super) mean: Vector3<f64>,
    pub(super) cov: Matrix3<f64>,
}

/// A Gaussian statement about the angle, kept as precision (1/variance) and precision times mean, so that "unknown" is
/// a value like any other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Angle {
    pub(super) precision: f64,
    pub(super) weighted: f64,
}

impl Angle {
    pub(super) const UNKNOWN: Self = Self { precision: 0.0, weighted: 0.0 };

    pub(super) fn new(mean: f64, variance: f64) -> Self {
        Self { precision: 1.0 / variance, weighted: mean / variance }
    }

    /// Mean and variance, if anything is known.
    pub(super) fn moments(self) -> Option<(f64, f64)> {
        (self.precision > 1e-9).then(|| (self.weighted / self.precision, 1.0 / self.precision))
    }

    /// Goes a share of the way to another statement.
    pub(super) fn towards(self, other: Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| a + share * (b - a);
        Self { precision: mix(self.precision, other.precision), weighted: mix(self.weighted, other.weighted) }
    }
}

/// What one measurement told a filter.
#[derive(Debug, Clone, Copy)]
pub(super) struct Innovation {
    residual: f64,
    variance: f64,
    gain: Vector3<f64>,
}

impl Innovation {
    pub(super) fn log_likelihood(&self) -> f64 {
        -0.5 * (self.residual * self.residual / self.variance + self.variance.ln())
    }
}

/// How the speed changes from one node to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Change {
    /// By a white jerk of this strength, in pitch²/s⁵.
    Jerk(f64),
    /// The drive takes hold of a rotor at rest: the speed is a random walk, and nothing is known of the acceleration after
    /// it. What happens before the first edge so has little say in what happens behind it.
    Kick,
}

impl Change {
    fn transition(self, dt: f64) -> Matrix3<f64> {
        match self {
            Self::Jerk(_) => Matrix3::new(1.0, dt, 0.5 * dt * dt, 0.0, 1.0, dt, 0.0, 0.0, 1.0),
            Self::Kick => Matrix3::new(1.0, dt, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0),
        }
    }

    /// Covariance added over `dt`: by a white jerk and the white acceleration beside it, or by the random walk.
    fn noise(self, dt: f64) -> Matrix3<f64> {
        let (d2, d3) = (dt * dt, dt * dt * dt);
        let Self::Jerk(strength) = self else {
            let (angle_angle, angle_speed, speed_speed) = (KICK * d3 / 3.0, KICK * d2 / 2.0, KICK * dt);
            let acceleration = UNKNOWN_ACCELERATION * UNKNOWN_ACCELERATION;
            return Matrix3::new(angle_angle, angle_speed, 0.0, angle_speed, speed_speed, 0.0, 0.0, 0.0, acceleration);
        };
        let (d4, d5) = (d2 * d2, d2 * d3);
        let a = ACCELERATION_NOISE_S2;
        let angle_angle = d5 / 20.0 + a * d3 / 3.0;
        let angle_speed = d4 / 8.0 + a * d2 / 2.0;
        let speed_speed = d3 / 3.0 + a * dt;
        Matrix3::new(angle_angle, angle_speed, d3 / 6.0, angle_speed, speed_speed, d2 / 2.0, d3 / 6.0, d2 / 2.0, dt)
            * strength
    }
}

impl Gaussian {
    /// A rotor somewhere about `angle`, at any speed.
    pub(super) fn about(angle: f64) -> Self {
        let spread = Vector3::new(1.0, UNKNOWN_SPEED, UNKNOWN_ACCELERATION);
        Self { mean: Vector3::new(angle, 0.0, 0.0), cov: Matrix3::from_diagonal(&spread.component_mul(&spread)) }
    }

    /// A rotor somewhere about `angle`, at rest, at the moment the drive goes on.
    pub(super) fn at_rest(angle: f64) -> Self {
        let spread = Vector3::new(1.0, REST_SPEED, UNKNOWN_ACCELERATION);
        Self { mean: Vector3::new(angle, 0.0, 0.0), cov: Matrix3::from_diagonal(&spread.component_mul(&spread)) }
    }

    pub(super) fn after(&self, dt: f64, change: Change) -> Self {
        let f = change.transition(dt);
        Self { mean: f * self.mean, cov: f * self.cov * f.transpose() + change.noise(dt) }
    }

    /// Takes in a measured angle.
    pub(super) fn measure(&mut self, mean: f64, variance: f64) -> Innovation {
        let total = self.cov[(0, 0)] + variance;
        let gain = self.cov.column(0) / total;
        let residual = mean - self.mean[0];
        self.mean += gain * residual;
        // Gain times gain keeps the covariance symmetric.
        self.cov -= gain * gain.transpose() * total;
        Innovation { residual, variance: total, gain }
    }
}

/// The state at each node, given all of them (modified Bryson-Frazier: filter forwards, then carry the gradient and the
/// curvature of the later log-likelihood backwards; no matrix is inverted). `start` is what is known at the first node
/// before what it says.
pub(super) fn smoothed(nodes: &[Node], start: Gaussian) -> Vec<Gaussian> {
    let mut states: Vec<Gaussian> = Vec::with_capacity(nodes.len());
    let mut told = Vec::with_capacity(nodes.len());
    for (i, node) in nodes.iter().enumerate() {
        let mut g = match i.checked_sub(1) {
            None => start,
            Some(before) => states[before].after(node.time_s - nodes[before].time_s, node.change),
        };
        told.push(node.angle.moments().map(|(mean, variance)| g.measure(mean, variance)));
        states.push(g);
    }
    let (mut gradient, mut curvature) = (Vector3::zeros(), Matrix3::zeros());
    for i in (0..nodes.len()).rev() {
        let g = states[i];
        states[i] = Gaussian { mean: g.mean - g.cov * gradient, cov: g.cov - g.cov * curvature * g.cov };
        if let Some(told) = told[i] {
            let mut kept = Matrix3::identity();
            for row in 0..3 {
                kept[(row, 0)] -= told.gain[row];
            }
            gradient = kept.transpose() * gradient;
            gradient[0] -= told.residual / told.variance;
            curvature = kept.transpose() * curvature * kept;
            curvature[(0, 0)] += 1.0 / told.variance;
        }
        if i > 0 {
            let f = nodes[i].change.transition(nodes[i].time_s - nodes[i - 1].time_s);
            gradient = f.transpose() * gradient;
            curvature = f.transpose() * curvature * f;
        }
    }
    states
}

/// The first angle that anything is said about.
pub(super) fn first_angle(nodes: &[Node]) -> f64 {
    nodes.iter().find_map(|n| n.angle.moments()).map_or(0.5, |(mean, _)| mean)
}

#[cfg(test)]
mod tests {
    use super::super::Statement;
    use super::*;

    /// Against the joint Gaussian of all states, conditioned on all measurements at once.
    #[test]
    fn smoothing_equals_conditioning_the_joint_gaussian() {
        let measured =
            [(0.0, Some(0.1)), (0.01, None), (0.013, Some(1.2)), (0.02, Some(1.9)), (0.03, None), (0.031, Some(3.4))];
        let (change, variance) = (Change::Jerk(1e8), 0.01);
        let nodes: Vec<Node> = measured
            .iter()
            .map(|&(time_s, z)| Node {
                time_s,
                statement: Statement::Nothing,
                angle: z.map_or(Angle::UNKNOWN, |z| Angle::new(z, variance)),
                change,
            })
            .collect();
        let got = smoothed(&nodes, Gaussian::about(0.1));

        let n = nodes.len();
        let mut mean = nalgebra::DVector::zeros(3 * n);
        let mut cov = nalgebra::DMatrix::zeros(3 * n, 3 * n);
        let mut g = Gaussian::about(0.1);
        for i in 0..n {
            if i > 0 {
                let dt = nodes[i].time_s - nodes[i - 1].time_s;
                let f = change.transition(dt);
                g = g.after(dt, change);
                for j in 0..i {
                    let cross = f * cov.fixed_view::<3, 3>(3 * (i - 1), 3 * j);
                    cov.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&cross);
                    cov.fixed_view_mut::<3, 3>(3 * j, 3 * i).copy_from(&cross.transpose());
                }
            }
            mean.fixed_rows_mut::<3>(3 * i).copy_from(&g.mean);
            cov.fixed_view_mut::<3, 3>(3 * i, 3 * i).copy_from(&g.cov);
        }
        for (i, z) in measured.iter().enumerate().filter_map(|(i, m)| m.1.map(|z| (i, z))) {
            let column = cov.column(3 * i).into_owned();
            let gain = &column / (column[3 * i] + variance);
            mean += &gain * (z - mean[3 * i]);
            cov -= &gain * column.transpose();
        }
        for i in 0..n {
            for row in 0..3 {
                let (a, b) = (got[i].mean[row], mean[3 * i + row]);
                assert!((a - b).abs() < 1e-6 * b.abs().max(1.0), "node {i} row {row}: {a} {b}");
                let (a, b) = (got[i].cov[(row, row)], cov[(3 * i + row, 3 * i + row)]);
                assert!((a / b - 1.0).abs() < 1e-5, "node {i} variance {row}: {a} {b}");
            }
        }
    }
}
