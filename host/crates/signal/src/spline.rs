//! Cubic spline through points, the third derivative continuous at the second and second-last point ("not-a-knot").

/// A cubic spline through points of increasing x.
#[derive(Debug, Clone)]
pub struct Spline {
    x: Vec<f64>,
    y: Vec<f64>,
    slope: Vec<f64>,
}

impl Spline {
    /// The spline through `(x[i], y[i])`: MATLAB's `spline` and `interp1(…, 'spline')`. Two points give a line, three a
    /// parabola. The slopes solve the usual tridiagonal equations (de Boor, A Practical Guide to Splines, chapter IV).
    ///
    /// Returns `None` unless there are two points or more, of strictly increasing finite x.
    pub fn not_a_knot(x: Vec<f64>, y: Vec<f64>) -> Option<Self> {
        let n = x.len();
        let increasing = x.windows(2).all(|w| w[0] < w[1] && w[1].is_finite());
        if n < 2 || y.len() != n || !x[0].is_finite() || !increasing {
            return None;
        }
        let h: Vec<f64> = x.windows(2).map(|w| w[1] - w[0]).collect();
        let d: Vec<f64> = y.windows(2).zip(&h).map(|(w, h)| (w[1] - w[0]) / h).collect();
        let slope = match n {
            2 => vec![d[0]; 2],
            3 => {
                let curvature = (d[1] - d[0]) / (h[0] + h[1]);
                vec![d[0] - curvature * h[0], d[0] + curvature * h[0], d[1] + curvature * h[1]]
            }
            _ => slopes(&h, &d),
        };
        Some(Self { x, y, slope })
    }

    /// The spline at times `at` (any order, fastest ascending; beyond the ends the outer pieces go on).
    pub fn values(&self, at: impl IntoIterator<Item = f64>) -> Vec<f64> {
        let mut values = Vec::new();
        self.extend(&mut values, at);
        values
    }

    /// Adds the spline's [`values`](Self::values) to the end of `to`.
    pub fn extend(&self, to: &mut Vec<f64>, at: impl IntoIterator<Item = f64>) {
        let mut i = 0;
        let mut piece = self.piece(i);
        to.extend(at.into_iter().map(|t| {
            // Divisions are what a value costs: of the many times in a piece the first alone makes them.
            if !piece.holds.contains(&t) {
                i = self.index(t, i);
                piece = self.piece(i);
            }
            piece.at(t)
        }));
    }

    /// The piece that holds `t`, which piece `i` does not: the next one, most often.
    fn index(&self, t: f64, i: usize) -> usize {
        let last = self.x.len() - 2;
        let next = (i + 1).min(last);
        if t >= self.x[next] && (next == last || t < self.x[next + 1]) {
            return next;
        }
        self.x.partition_point(|x| *x <= t).saturating_sub(1).min(last)
    }

    /// The cubic between points `i` and `i + 1`.
    fn piece(&self, i: usize) -> Piece {
        let last = self.x.len() - 2;
        let h = self.x[i + 1] - self.x[i];
        let d = (self.y[i + 1] - self.y[i]) / h;
        let begin = if i == 0 { f64::NEG_INFINITY } else { self.x[i] };
        let end = if i == last { f64::INFINITY } else { self.x[i + 1] };
        Piece {
            holds: begin..end,
            from: self.x[i],
            value: self.y[i],
            slope: self.slope[i],
            square: (3.0 * d - 2.0 * self.slope[i] - self.slope[i + 1]) / h,
            cube: (self.slope[i] + self.slope[i + 1] - 2.0 * d) / (h * h),
        }
    }
}

/// One cubic of the spline: the times it holds for, and its coefficients about its first point.
struct Piece {
    holds: std::ops::Range<f64>,
    from: f64,
    value: f64,
    slope: f64,
    square: f64,
    cube: f64,
}

impl Piece {
    fn at(&self, t: f64) -> f64 {
        let u = t - self.from;
        self.value + u * (self.slope + u * (self.square + u * self.cube))
    }
}

/// Slopes at `n >= 4` points with spacings `h` and divided differences `d`, by Gaussian elimination of the tridiagonal
/// system (Thomas): every row is divided by its diagonal on the way down.
fn slopes(h: &[f64], d: &[f64]) -> Vec<f64> {
    let n = h.len() + 1;
    let end = |h0: f64, h1: f64, d0: f64, d1: f64| ((3.0 * h0 + 2.0 * h1) * h1 * d0 + h0 * h0 * d1) / (h0 + h1);
    let mut upper = Vec::with_capacity(n);
    let mut slope = Vec::with_capacity(n);
    upper.push((h[0] + h[1]) / h[1]);
    slope.push(end(h[0], h[1], d[0], d[1]) / h[1]);
    for i in 1..n {
        let (lower, diagonal, off, right) = if i == n - 1 {
            let (a, b) = (h[n - 2], h[n - 3]);
            (a + b, b, 0.0, end(a, b, d[n - 2], d[n - 3]))
        } else {
            (h[i], 2.0 * (h[i - 1] + h[i]), h[i - 1], 3.0 * (h[i] * d[i - 1] + h[i - 1] * d[i]))
        };
        let scale = 1.0 / (diagonal - lower * upper[i - 1]);
        upper.push(off * scale);
        slope.push((right - lower * slope[i - 1]) * scale);
    }
    for i in (0..n - 1).rev() {
        slope[i] -= upper[i] * slope[i + 1];
    }
    slope
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_reproduced_and_continued() {
        let f = |x: f64| 1.0 - 2.0 * x + 0.5 * x * x - 0.1 * x * x * x;
        let x = [0.0, 0.7, 1.0, 2.5, 2.6, 4.0];
        let spline = Spline::not_a_knot(x.to_vec(), x.map(f).to_vec()).unwrap();
        let at = [5.0, -1.0, 0.3, 1.7, 2.55, 4.0];
        for (v, t) in spline.values(at).iter().zip(at) {
            assert!((v - f(t)).abs() < 1e-12, "{t}");
        }
    }

    /// Fails if a time is taken to another piece than its own: one that lies before the last one, at a point, or beyond the ends.
    #[test]
    fn the_order_of_the_times_changes_nothing() {
        let x = [0.0, 0.7, 1.0, 2.5, 2.6, 4.0, 5.1];
        let y = x.map(|x: f64| (3.0 * x).sin());
        let spline = Spline::not_a_knot(x.to_vec(), y.to_vec()).unwrap();
        let at = [5.5, 0.9, 2.55, -1.0, 4.0, 2.5, 0.0, 5.1, 1.7, 0.3];
        let alone: Vec<f64> = at.iter().flat_map(|t| spline.values([*t])).collect();
        assert_eq!(spline.values(at), alone);
        for (v, y) in spline.values(x.into_iter().rev()).iter().zip(y.iter().rev()) {
            assert!((v - y).abs() < 1e-12, "{v} {y}");
        }
        for t in [0.7, 1.0, 2.5, 2.6, 4.0] {
            let [before, after] = [t - 1e-9, t + 1e-9].map(|t| spline.values([t])[0]);
            assert!((before - after).abs() < 1e-7, "{t}: {before} {after}");
        }
    }

    #[test]
    fn few_points_give_the_polynomial_through_them() {
        let parabola = Spline::not_a_knot(vec![0.0, 1.0, 3.0], vec![0.0, 1.0, 9.0]).unwrap();
        assert!((parabola.values([2.0])[0] - 4.0).abs() < 1e-12);
        assert_eq!(Spline::not_a_knot(vec![0.0, 2.0], vec![0.0, 1.0]).unwrap().values([1.0]), [0.5]);
        assert!(Spline::not_a_knot(vec![0.0], vec![0.0]).is_none());
        assert!(Spline::not_a_knot(vec![0.0, 0.0], vec![0.0, 1.0]).is_none());
        assert!(Spline::not_a_knot(vec![0.0, f64::NAN], vec![0.0, 1.0]).is_none());
    }
}
