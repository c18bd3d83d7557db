"""The carrier model's right-hand side in Python, thesis flavour, integrated with SciPy's solve_ivp.

    python3 host/benches/reference/carrier_scipy.py [seconds]

Prints the speed after `seconds` of full drive from rest and what it cost; `twum model speed --solver carrier --seconds S` and
`cargo bench -p twum-host --bench model` give the other side of the comparison in docs/model.md.
"""

import math
import sys
import time

import numpy as np
from scipy.integrate import solve_ivp

F, VRMS = 45000.0, 105.0
MS, CS, KS, ETA = 0.624, 5469.328, 4.798e10, 0.5439
RR, R0, N, H = 0.7, 0.013675, 6, 0.00025
MR, JR, CZ, CTHETA = 6.09e-3, 765.58e-9, 35.0, 2e-7
U, FEXT, TLOAD, CN = 0.1057, 1.0, 0.0, 20761245675 / 3.33
OMEGA, VMAX, K = 2 * math.pi * F, VRMS / 0.7071, N / R0
WMIN = FEXT / (2 * RR * R0 * CN)

calls = 0


def rhs(t, x):
    global calls
    calls += 1
    w1, w2, v1, v2, z, zd, _, speed = x
    travelling = math.sqrt(w1 * w1 + w2 * w2)
    amplitude = max(travelling, WMIN)
    phi = math.acos(min(1.0, max(-1.0, z / (RR * amplitude))))
    ratio = R0 * R0 * speed / (H * K * RR * amplitude * OMEGA)
    psi = min(math.acos(min(1.0, max(-1.0, ratio))), phi)
    sx, cx, ss, cs = math.sin(phi), math.cos(phi), math.sin(psi), math.cos(psi)
    g1 = 2 * (psi - phi / 2 + ss * cs - sx * cx / 2 - cx * (2 * ss - sx))
    g2 = 2 * ss * ss - sx * sx - 2 * cx * cx + 4 * cx * cs - 2
    beta_x, beta_s = sx - phi * cx, ss - psi * cx
    normal = -RR * RR * R0 * CN * (phi - sx * cx)
    drag = U * H * N * RR * RR * CN
    fint = 2 * RR * R0 * CN * amplitude * beta_x
    tint = 2 * U * RR * R0 * R0 * CN * travelling * (2 * beta_s - beta_x)
    f1 = ETA * VMAX * math.cos(OMEGA * t) + normal * w1 + drag * (w2 * g1 - w1 * g2)
    f2 = ETA * VMAX * math.sin(OMEGA * t) + normal * w2 - drag * (w1 * g1 + w2 * g2)
    return (
        v1,
        v2,
        (f1 - KS * w1 - CS * v1) / MS,
        (f2 - KS * w2 - CS * v2) / MS,
        zd,
        (fint - FEXT - CZ * zd) / MR,
        speed,
        (tint - TLOAD - CTHETA * speed) / JR,
    )


def main():
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 0.005
    scale = np.array([1e-8, 1e-8, 1e-3, 1e-3, 1e-8, 1e-3, 1e-3, 1.0])
    for method in ("RK45", "DOP853"):
        global calls
        calls = 0
        began = time.process_time()
        run = solve_ivp(rhs, (0, seconds), np.zeros(8), method=method, rtol=1e-6, atol=1e-6 * scale, t_eval=[seconds])
        spent = time.process_time() - began
        print(f"{method}: {run.y[7, -1]:.5f} rad/s, {calls} derivatives, {spent:.3f} s, {spent / seconds:.0f} s a simulated second")


if __name__ == "__main__":
    main()
