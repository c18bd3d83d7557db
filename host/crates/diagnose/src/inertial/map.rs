//! The map from input to steady speed of an ordinary motor, and its fit.
//!
//! y = g·(1 ± a)·sat(max(|u| − u₀·(1 ± b), 0))·sign(u): a line, and what may be lost of it. All numbers are fitted together: a dead zone
//! under a strong saturation cannot be found by adding a column to a line.

/// Which losses a map has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Shape {
    /// No motion below an input.
    pub dead_zone: bool,
    /// The two directions differ: in gain, and in the dead zone where there is one.
    pub asymmetry: bool,
    /// How the top bends.
    pub top: Top,
    /// Stuck below a breakaway, the full line above it.
    pub breakaway: bool,
}

/// How the top of the map bends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Top {
    /// Not at all.
    #[default]
    Straight,
    /// u/(1 + u/us).
    Soft,
    /// Flat from an input on.
    Flat,
}

/// Numbers of a map; those its shape does not have stay at "absent".
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Map {
    /// What it has.
    pub shape: Shape,
    /// `[gain rpm, u₀, gain asymmetry, u₀ asymmetry, top, breakaway]`; the top is 1/us of [`Top::Soft`], the input of
    /// [`Top::Flat`]. Inputs are relative to the largest.
    pub values: [f64; VALUES],
}

/// Numbers in [`Map::values`].
pub const VALUES: usize = 6;
/// Bounds of each value.
const BOUNDS: [(f64, f64); VALUES] = [(-1e7, 1e7), (0.0, 0.7), (-0.8, 0.8), (-0.95, 0.95), (0.0, 60.0), (0.005, 0.7)];
/// Steps of the derivative.
const STEPS: [f64; VALUES] = [0.0, 1e-4, 1e-4, 1e-3, 1e-4, 1e-4];

impl Map {
    /// A line of so many rpm at full input.
    pub fn line(gain_rpm: f64) -> Self {
        Self { shape: Shape::default(), values: [gain_rpm, 0.0, 0.0, 0.0, 0.0, 0.05] }
    }

    /// Speed at an input in rpm.
    pub fn at(&self, u: f64) -> f64 {
        let [gain, u0, gain_split, zone_split, top, breakaway] = self.values;
        let sign = if u < 0.0 { -1.0 } else { 1.0 };
        let (mut gain, mut threshold) = (gain, 0.0);
        if self.shape.dead_zone {
            threshold = u0;
        }
        if self.shape.asymmetry {
            gain *= 1.0 + sign * gain_split;
            threshold *= 1.0 + sign * zone_split;
        }
        let mut x = (u.abs() - threshold).max(0.0);
        x = match self.shape.top {
            Top::Straight => x,
            Top::Soft => x / (1.0 + x * top),
            Top::Flat => x.min((top - threshold).max(0.0)),
        };
        if self.shape.breakaway {
            let r = u / breakaway;
            x *= 1.0 - (-r * r).exp();
        }
        sign * gain * x
    }

    fn free(&self) -> Vec<usize> {
        let s = self.shape;
        let mut free = vec![0];
        if s.dead_zone {
            free.push(1);
        }
        if s.asymmetry {
            free.push(2);
            if s.dead_zone {
                free.push(3);
            }
        }
        if s.top != Top::Straight {
            free.push(4);
        }
        if s.breakaway {
            free.push(5);
        }
        free
    }

    /// Values the shape has, in order.
    pub fn names(&self) -> Vec<(usize, &'static str)> {
        self.free()
            .into_iter()
            .map(|k| {
                let name = match k {
                    0 => "gain_rpm",
                    1 => "threshold",
                    2 => "gain_asymmetry",
                    3 => "threshold_asymmetry",
                    4 if self.shape.top == Top::Soft => "inverse_saturation_input",
                    4 => "flat_from_input",
                    _ => "breakaway_input",
                };
                (k, name)
            })
            .collect()
    }

    /// Least squares over points (input, speed) by damped Gauss–Newton, and the squared error left.
    pub fn fit(mut self, u: &[f64], y: &[f64], iterations: usize) -> (Self, f64) {
        let free = self.free();
        let n = free.len();
        let mut error = self.error(u, y);
        let mut damping = 1e-3;
        for _ in 0..iterations {
            let mut normal = nalgebra::DMatrix::<f64>::zeros(n, n);
            let mut right = nalgebra::DVector::<f64>::zeros(n);
            let mut row = vec![0.0; n];
            let moved: Vec<(Map, f64)> = free.iter().map(|k| self.nudged(*k)).collect();
            for (u, y) in u.iter().zip(y) {
                let now = self.at(*u);
                for (r, (m, h)) in row.iter_mut().zip(&moved) {
                    *r = (m.at(*u) - now) / h;
                }
                for i in 0..n {
                    right[i] += row[i] * (y - now);
                    for j in 0..=i {
                        normal[(i, j)] += row[i] * row[j];
                    }
                }
            }
            for i in 0..n {
                for j in 0..i {
                    normal[(j, i)] = normal[(i, j)];
                }
            }
            let before = error;
            for _ in 0..4 {
                let mut damped = normal.clone();
                for i in 0..n {
                    damped[(i, i)] = damped[(i, i)] * (1.0 + damping) + 1e-12;
                }
                let Some(step) = damped.cholesky().map(|c| c.solve(&right)) else { break };
                let mut trial = self;
                for (k, s) in free.iter().zip(step.iter()) {
                    trial.values[*k] = (trial.values[*k] + s).clamp(BOUNDS[*k].0, BOUNDS[*k].1);
                }
                let after = trial.error(u, y);
                if after < error {
                    (self, error) = (trial, after);
                    damping = (damping * 0.2).max(1e-9);
                    break;
                }
                damping *= 10.0;
            }
            if before - error <= 1e-6 * before {
                break;
            }
        }
        (self, error)
    }

    /// Standard errors of the shape's values, for a residual variance of `variance` a point.
    pub fn spread(&self, u: &[f64], variance: f64) -> [f64; VALUES] {
        let free = self.free();
        let n = free.len();
        let moved: Vec<(Map, f64)> = free.iter().map(|k| self.nudged(*k)).collect();
        let mut normal = nalgebra::DMatrix::<f64>::zeros(n, n);
        for u in u {
            let now = self.at(*u);
            let row: Vec<f64> = moved.iter().map(|(m, h)| (m.at(*u) - now) / h).collect();
            for i in 0..n {
                for j in 0..n {
                    normal[(i, j)] += row[i] * row[j];
                }
            }
        }
        let mut out = [0.0; VALUES];
        if let Some(inverse) = normal.try_inverse() {
            for (i, k) in free.iter().enumerate() {
                out[*k] = (variance * inverse[(i, i)]).max(0.0).sqrt();
            }
        }
        out
    }

    fn nudged(&self, k: usize) -> (Map, f64) {
        let step = if k == 0 { 1e-4 * self.values[0].abs().max(1.0) } else { STEPS[k] };
        // Away from a bound, so that the derivative never vanishes there.
        let step = if self.values[k] + step > BOUNDS[k].1 { -step } else { step };
        let mut m = *self;
        m.values[k] += step;
        (m, step)
    }

    fn error(&self, u: &[f64], y: &[f64]) -> f64 {
        u.iter().zip(y).map(|(u, y)| (y - self.at(*u)).powi(2)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if values are not fitted together: a dead zone hides under a strong saturation.
    #[test]
    fn a_dead_zone_under_a_saturation_is_recovered() {
        let shape = Shape { dead_zone: true, asymmetry: true, top: Top::Soft, breakaway: false };
        let truth = Map { shape, values: [5000.0, 0.17, 0.02, 0.1, 6.0, 0.05] };
        let u: Vec<f64> = (-100..=100).map(|k| f64::from(k) / 100.0).collect();
        let y: Vec<f64> = u.iter().map(|u| truth.at(*u)).collect();
        let start = Map { shape, values: [2000.0, 0.05, 0.0, 0.0, 2.0, 0.05] };
        let (fitted, error) = start.fit(&u, &y, 100);
        for k in 0..5 {
            assert!((fitted.values[k] / truth.values[k] - 1.0).abs() < 0.02, "{k}: {fitted:?}");
        }
        assert!(error < 1.0, "{error}");
    }

    /// Closed form: the slope of a line through the origin.
    #[test]
    fn a_line_is_least_squares() {
        let (u, y) = ([-1.0, 0.5, 1.0], [-90.0, 60.0, 110.0]);
        let (fitted, _) = Map::line(1.0).fit(&u, &y, 10);
        assert!((fitted.values[0] - 230.0 / 2.25).abs() < 1e-6, "{fitted:?}");
    }
}
