"""Prints the Q30 coefficients of the odd degree-9 polynomial for sin(pi/2 x) on [0, 1] used by src/reference.rs."""
import numpy as np

nodes = (np.cos(np.pi * (np.arange(200) + 0.5) / 200) + 1) / 2
powers = np.array([1, 3, 5, 7, 9])
basis = nodes[:, None] ** powers
# c1 = 1 - c3 - c5 - c7 - c9 holds the value at x = 1 at exactly 1.
reduced = basis[:, 1:] - basis[:, :1]
rest = np.linalg.lstsq(reduced, np.sin(np.pi / 2 * nodes) - nodes, rcond=None)[0]
coefficients = np.concatenate([[1 - rest.sum()], rest])
rounded = np.round(coefficients * 2**30).astype(int)
rounded[0] += 2**30 - rounded.sum()
print(", ".join(str(c) for c in rounded))
grid = np.linspace(0, 1, 100001)
print("largest error:", np.abs((grid[:, None] ** powers) @ (rounded / 2**30) - np.sin(np.pi / 2 * grid)).max())
