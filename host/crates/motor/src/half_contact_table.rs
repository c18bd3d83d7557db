//! The half-contact angle φ that carries a force: the inverse of q = sin φ − φ·cos φ, tabulated once.

use std::f64::consts::PI;
use std::sync::OnceLock;

const NODES: usize = 256;
/// Below this q the table runs in (3q)^(1/3), in which φ is smooth at 0; above, in sqrt(1 − q/π), smooth at π.
const SPLIT: f64 = 1.0;

/// φ and cos φ against q in 0..π, by cubic interpolation: error below 1e-9.
#[derive(Debug)]
pub struct HalfContactTable {
    low: Vec<[f64; 4]>,
    high: Vec<[f64; 4]>,
}

fn q_of(phi: f64) -> f64 {
    // The difference loses everything to rounding near 0.
    if phi < 0.05 {
        let s = phi * phi;
        phi * s / 3.0 * (1.0 - s / 10.0 * (1.0 - s / 28.0))
    } else {
        phi.sin() - phi * phi.cos()
    }
}

/// φ by bisection: slow, used for the nodes.
fn solve(q: f64) -> f64 {
    let (mut a, mut b) = (0.0, PI);
    for _ in 0..100 {
        let m = 0.5 * (a + b);
        if q_of(m) < q { a = m } else { b = m }
    }
    0.5 * (a + b)
}

fn low_variable(q: f64) -> f64 {
    (3.0 * q).cbrt()
}

fn high_variable(q: f64) -> f64 {
    (1.0 - q / PI).max(0.0).sqrt()
}

impl HalfContactTable {
    /// The table, built on first use.
    pub fn shared() -> &'static HalfContactTable {
        static TABLE: OnceLock<HalfContactTable> = OnceLock::new();
        TABLE.get_or_init(HalfContactTable::build)
    }

    fn build() -> Self {
        // Value and slope of φ and cos φ at each node; dφ/dq = 1/(φ·sin φ).
        let node = |q: f64, dq: f64, at_edge: (f64, f64)| {
            let phi = solve(q);
            let product = phi * phi.sin();
            if product < 1e-6 {
                let (phi, slope) = at_edge;
                [phi, slope, phi.cos(), -phi.sin() * slope]
            } else {
                let slope = dq / product;
                [phi, slope, phi.cos(), -phi.sin() * slope]
            }
        };
        let low_step = low_variable(SPLIT) / NODES as f64;
        let low = (0..=NODES)
            .map(|i| {
                let x = i as f64 * low_step;
                node(x * x * x / 3.0, x * x, (0.0, 1.0))
            })
            .collect();
        let high_step = high_variable(SPLIT) / NODES as f64;
        let high = (0..=NODES)
            .map(|i| {
                let x = i as f64 * high_step;
                // Near π: q ≈ π − π·(π − φ)²/2, so φ ≈ π − √2·x.
                node(PI * (1.0 - x * x), -2.0 * PI * x, (PI, -std::f64::consts::SQRT_2))
            })
            .collect();
        HalfContactTable { low, high }
    }

    /// φ and cos φ for a force `q` (1); beyond π the contact is full.
    #[inline]
    pub fn at(&self, q: f64) -> (f64, f64) {
        let (nodes, x, step) = if q < SPLIT {
            (&self.low, low_variable(q.max(0.0)), low_variable(SPLIT) / NODES as f64)
        } else {
            (&self.high, high_variable(q), high_variable(SPLIT) / NODES as f64)
        };
        let at = x / step;
        let i = (at as usize).min(NODES - 1);
        let t = at - i as f64;
        let (a, b) = (&nodes[i], &nodes[i + 1]);
        let hermite = |p0: f64, m0: f64, p1: f64, m1: f64| {
            let d = p1 - p0;
            let (m0, m1) = (m0 * step, m1 * step);
            p0 + t * (m0 + t * (3.0 * d - 2.0 * m0 - m1 + t * (m0 + m1 - 2.0 * d)))
        };
        (hermite(a[0], a[1], b[0], b[1]), hermite(a[2], a[3], b[2], b[3]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverts_the_contact_force() {
        let table = HalfContactTable::shared();
        for i in 1..1000 {
            let phi = PI * i as f64 / 1000.0;
            let (found, cos) = table.at(q_of(phi));
            assert!((found - phi).abs() < 1e-7, "{phi} gave {found}");
            assert!((cos - phi.cos()).abs() < 1e-7);
        }
        assert_eq!(table.at(4.0).0, PI);
    }
}
