"""Bits to speed: this project against SciPy and against Octave running the thesis's loop, as ratios in one run.

Run from the repository root, on an otherwise idle machine: python3 host/benches/velocity_speed.py [--without-octave]
Octave takes minutes for the record of 600 s.
"""

import argparse
import json
import pathlib
import subprocess
import tempfile
import time

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, filtfilt, medfilt, savgol_filter

TS = 0.001
STEP = round(2 * np.pi / 400, 5)


def record(seconds):
    """35 rpm with a ripple of 15 % twice a turn, at 1 kHz."""
    t = np.arange(round(seconds / TS)) * TS
    speed = 35 * np.pi / 30
    angle = speed * t
    angle += 0.075 * np.sin(2 * angle)
    return (np.floor(angle / (2 * np.pi / 400) + 0.3) % 2).astype(int)


def scipy_speed(bits):
    edges = np.flatnonzero(np.diff(bits)) + 1
    events = np.concatenate([[0.0], (edges - 0.5) * TS])
    positions = np.concatenate([[0.0], (np.arange(len(edges)) + 0.5) * STEP])
    spline = CubicSpline(events, positions)(np.arange(edges[-1] + 1) * TS)
    return savgol_filter(spline, 21, 3, deriv=1, delta=TS) * 30 / np.pi


def scipy_steps(bits):
    """The speed, and what each of the thesis's filters makes of it."""
    raw = scipy_speed(bits)
    return raw, filtfilt(*butter(2, 6 / (1 / TS / 2)), raw, padlen=6), uniform_filter1d(raw, 101), medfilt(raw, 13)


def best(run, repeats=20):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--without-octave", action="store_true", help="leave Octave out: it takes minutes for 600 s")
    without_octave = parser.parse_args().without_octave
    here = pathlib.Path(__file__).parent
    subprocess.run(["cargo", "build", "-q", "--release", "-p", "twum-host", "--example", "velocity_speed"], check=True)
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / "bits.txt"
        for seconds in (5, 60, 600):
            bits = record(seconds)
            file.write_text("\n".join(map(str, bits)) + "\n")
            ours = json.loads(
                subprocess.check_output(
                    ["cargo", "run", "-q", "--release", "-p", "twum-host", "--example", "velocity_speed", "--", str(file)]
                )
            )
            ramp = np.linspace(0.0, 1.0, len(bits))
            filter_only = best(lambda: savgol_filter(ramp, 21, 3, deriv=1, delta=TS))
            whole = best(lambda: scipy_speed(bits))
            others = [
                ("SciPy, savgol_filter alone", filter_only),
                ("SciPy, edges + CubicSpline + savgol_filter", whole),
                ("SciPy, the three filters too", best(lambda: scipy_steps(bits), repeats=5)),
            ]
            if not without_octave:
                octave, octave_rpm = map(
                    float, subprocess.check_output(["octave-cli", "-q", str(here / "thesis_loop.m"), str(file)]).split()
                )
                assert abs(octave_rpm - ours["thesis_rpm"]) < 1e-3, "the two ways must agree before they are timed"
                others.append(("Octave, the thesis's loop", octave))
            print(f"record of {seconds} s ({len(bits)} samples)")
            for name, other in others:
                print(
                    f"  {name:44} {other * 1e3:9.3f} ms = {other / ours['fit_s']:8.1f} x ours (the same steps),"
                    f" {other / ours['thesis_s']:8.1f} x ours (filters too), {other / ours['smoother_s']:8.2f} x ours (smoother)"
                )
            print(f"  ours: edges, spline and cubic {ours['fit_s'] * 1e3:.3f} ms; thesis's method, all steps {ours['thesis_s'] * 1e3:.3f} ms; smoother {ours['smoother_s'] * 1e3:.3f} ms")


if __name__ == "__main__":
    main()
