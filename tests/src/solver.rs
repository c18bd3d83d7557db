//! Adaptive Runge–Kutta of order 5(4) after Dormand and Prince (J. Comp. Appl. Math. 6, 1980).

/// Integrates `dy/dt = f(t, y)` from `t` to `until` with local errors below `tolerance` (relative to `scale`).
///
/// Returns the number of accepted steps.
pub fn integrate<const N: usize>(
    f: &mut impl FnMut(f64, &[f64; N]) -> [f64; N],
    t: &mut f64,
    y: &mut [f64; N],
    until: f64,
    step: &mut f64,
    scale: &[f64; N],
    tolerance: f64,
) -> usize {
    const A: [[f64; 6]; 6] = [
        [1.0 / 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0],
        [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0],
        [19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0, 0.0, 0.0],
        [9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0, 0.0],
        [35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
    ];
    const C: [f64; 6] = [1.0 / 5.0, 3.0 / 10.0, 4.0 / 5.0, 8.0 / 9.0, 1.0, 1.0];
    const E: [f64; 7] =
        [71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339200.0, 22.0 / 525.0, -1.0 / 40.0];
    let mut steps = 0;
    let mut k = [[0.0; N]; 7];
    k[0] = f(*t, y);
    while *t < until - 1e-15 {
        let h = step.min(until - *t);
        let mut next = *y;
        for (s, row) in A.iter().enumerate() {
            for i in 0..N {
                let mut sum = 0.0;
                for (j, a) in row.iter().enumerate().take(s + 1) {
                    sum += a * k[j][i];
                }
                next[i] = y[i] + h * sum;
            }
            k[s + 1] = f(*t + C[s] * h, &next);
        }
        let mut error: f64 = 0.0;
        for i in 0..N {
            let mut e = 0.0;
            for (j, c) in E.iter().enumerate() {
                e += c * k[j][i];
            }
            error = error.max((h * e).abs() / (tolerance * scale[i].max(y[i].abs())));
        }
        if error <= 1.0 || h < 1e-12 {
            *t += h;
            *y = next;
            k[0] = k[6];
            steps += 1;
        }
        *step = h * (0.9 * error.max(1e-8).powf(-0.2)).clamp(0.2, 5.0);
    }
    steps
}
