//! The way down: linearise, step, and shorten what went too far.

/// How much larger the diagonal of the normal equations is made where the step before went too far (Marquardt, SIAM J. Appl. Math. 11 (1963)
/// 431): the first step is Gauss and Newton's, the last a thirtieth of each parameter's own.
pub const DAMPINGS: [f64; 5] = [0.0, 0.03, 0.3, 3.0, 30.0];

/// Gauss–Newton from `at` (Nocedal & Wright, Numerical Optimization, 2nd ed., chapter 10), at most `steps` of them.
///
/// `linearise` gives the equations around a point and what the point costs; `attempt` the point that they lead to, a rung shorter each time,
/// with its cost, or nothing where they have no solution. The first that costs less is taken. It ends where none does, or where the costs
/// before and after are `alike`.
pub fn descend<Point, Equations>(
    mut at: Point,
    steps: usize,
    rungs: &[f64],
    mut linearise: impl FnMut(&Point) -> (Equations, f64),
    attempt: impl Fn(&Point, &Equations, f64) -> Option<(Point, f64)>,
    alike: impl Fn(f64, f64) -> bool,
) -> Point {
    for _ in 0..steps {
        let (equations, before) = linearise(&at);
        let better = |rung: &f64| attempt(&at, &equations, *rung).filter(|(_, after)| *after < before);
        let Some((next, after)) = rungs.iter().find_map(better) else { break };
        at = next;
        if alike(before, after) {
            break;
        }
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley, as residuals 10·(y − x²) and 1 − x: bent, so that full steps go too far.
    fn cost(p: &[f64; 2]) -> f64 {
        100.0 * (p[1] - p[0] * p[0]).powi(2) + (1.0 - p[0]).powi(2)
    }

    fn damped(p: &[f64; 2], damping: f64) -> Option<([f64; 2], f64)> {
        let (x, r) = (p[0], [10.0 * (p[1] - p[0] * p[0]), 1.0 - p[0]]);
        let j = [[-20.0 * x, 10.0], [-1.0, 0.0]];
        let g = |a: usize, b: usize| j[0][a] * j[0][b] + j[1][a] * j[1][b];
        let (a, b, d) = (g(0, 0) * (1.0 + damping), g(0, 1), g(1, 1) * (1.0 + damping));
        let rhs = [0, 1].map(|k| -(j[0][k] * r[0] + j[1][k] * r[1]));
        let det = a * d - b * b;
        let next = [x + (d * rhs[0] - b * rhs[1]) / det, p[1] + (a * rhs[1] - b * rhs[0]) / det];
        Some((next, cost(&next)))
    }

    /// Fails if a step that costs more is taken, or one that is too long is not shortened: from here the full one leads uphill.
    #[test]
    fn a_bent_valley_is_followed_to_its_end() {
        let start = [-1.2, 1.0];
        let full = damped(&start, 0.0).expect("a step");
        assert!(full.1 > cost(&start), "the full step costs more: {}", full.1);
        let costs = std::cell::RefCell::new(vec![cost(&start)]);
        let linearise = |p: &[f64; 2]| {
            costs.borrow_mut().push(cost(p));
            ((), cost(p))
        };
        let end =
            descend(start, 60, &DAMPINGS, linearise, |p, (), d| damped(p, d), |before, after| before - after < 1e-12);
        assert!((end[0] - 1.0).abs() < 1e-4 && (end[1] - 1.0).abs() < 1e-4, "{end:?}");
        assert!(costs.borrow().windows(2).all(|w| w[1] <= w[0]));
    }

    /// Fails if the search goes on where nothing is gained, or moves where no step has a solution.
    #[test]
    fn it_ends_where_nothing_is_gained() {
        let looked = std::cell::Cell::new(0);
        let linearise = |_: &f64| {
            looked.set(looked.get() + 1);
            ((), 1.0)
        };
        assert_eq!(descend(5.0, 9, &DAMPINGS, linearise, |_, (), _| None, |_, _| false), 5.0);
        assert_eq!(looked.get(), 1);
        assert_eq!(descend(5.0, 9, &DAMPINGS, linearise, |p, (), _| Some((p - 1.0, 0.9)), |_, _| true), 4.0);
        assert_eq!(looked.get(), 2);
    }
}
