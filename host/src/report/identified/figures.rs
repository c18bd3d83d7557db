//! Nyquist and Bode plots of a sweep with the fitted circuit over it (thesis sections A.1.2 and A.3).

use crate::identify::stator::Identification;
use crate::identify::sweep::{Point, Sweep};
use crate::report::figure::{Figure, Panel};
use nalgebra::Complex;
use std::f64::consts::TAU;

/// Measured admittance, fitted circuit and thesis ellipse: Nyquist plot, magnitude, phase, and residual along frequency.
pub fn stator(sweep: &Sweep, found: &Identification) -> Figure {
    let circuit = found.fit.circuit();
    let (low, high) = sweep.range_hz();
    // Even over the sweep, and a circle's worth of points round each resonance.
    let mut dense: Vec<f64> = (0..1500).map(|i| low * (high / low).powf(i as f64 / 1499.0)).collect();
    for mode in &circuit.modes {
        dense.extend((-80..=80).map(|i| mode.fs_hz * (1.0 + (f64::from(i) * 0.019).tan() / (2.0 * mode.q))));
    }
    dense.retain(|f| (low..=high).contains(f));
    dense.sort_by(f64::total_cmp);
    let fitted: Vec<(f64, Complex<f64>)> = dense.iter().map(|&f| (f, circuit.admittance(f))).collect();
    let measured: Vec<(f64, Complex<f64>)> = sweep.points.iter().map(|p| (p.frequency_hz, p.admittance_s)).collect();
    // The Nyquist plot is about the resonances: what lies far off them would squeeze the circles flat.
    let near =
        |f: f64| circuit.modes.is_empty() || circuit.modes.iter().any(|m| (f - m.fs_hz).abs() < 6.0 * m.fs_hz / m.q);
    let plane = |points: &[(f64, Complex<f64>)]| -> Vec<(f64, f64)> {
        points.iter().map(|(f, y)| if near(*f) { (1e3 * y.re, 1e3 * y.im) } else { (f64::NAN, f64::NAN) }).collect()
    };
    let finite = |points: Vec<(f64, f64)>| points.into_iter().filter(|p| p.0.is_finite()).collect::<Vec<_>>();
    let mut nyquist = Panel::new("conductance G (mS)", "susceptance B (mS)")
        .title("Nyquist plot")
        .points("measured", &finite(plane(&measured)))
        .line("fitted circuit", &plane(&fitted));
    if let Some(ellipse) = &found.ellipse {
        let outline: Vec<(f64, f64)> =
            (0..=360).map(|i| ellipse.at(f64::from(i) * TAU / 360.0)).map(|y| (1e3 * y.re, 1e3 * y.im)).collect();
        nyquist = nyquist.dashed("thesis ellipse", &outline);
    }
    let of = |points: &[(f64, Complex<f64>)], value: fn(Complex<f64>) -> f64| -> Vec<(f64, f64)> {
        points.iter().map(|(f, y)| (f / 1e3, value(*y))).collect()
    };
    let magnitude = |y: Complex<f64>| y.norm();
    let phase = |y: Complex<f64>| y.arg().to_degrees();
    let wide = high / low > 5.0;
    let axis = |panel: Panel| if wide { panel.x_log() } else { panel };
    let resonances: Vec<f64> = circuit.modes.iter().map(|m| m.fs_hz / 1e3).collect();
    let residual = |part: fn(&Complex<f64>) -> f64| -> Vec<(f64, f64)> {
        sweep
            .points
            .iter()
            .zip(&found.fit.residual_s)
            .map(|(p, r)| (p.frequency_hz / 1e3, 100.0 * part(r) / p.admittance_s.norm()))
            .collect()
    };
    Figure::new(format!("Stator admittance: {}", name(&sweep.source)))
        .size(1400, 1000)
        .columns(2)
        .panel(nyquist)
        .panel(
            axis(Panel::new("frequency (kHz)", "|Y| (S)").title("Bode plot: magnitude").y_log())
                .points("measured", &of(&measured, magnitude))
                .line("fitted circuit", &of(&fitted, magnitude))
                .marks("series resonances", &resonances),
        )
        .panel(
            axis(Panel::new("frequency (kHz)", "residual (% of |Y|)").title("Measured minus fitted"))
                .points("conductance", &residual(|r| r.re))
                .points("susceptance", &residual(|r| r.im)),
        )
        .panel(
            axis(Panel::new("frequency (kHz)", "phase (deg)").title("Bode plot: phase"))
                .points("measured", &of(&measured, phase))
                .line("fitted circuit", &of(&fitted, phase)),
        )
}

/// What is measured of a sweep so far, before a circuit is fitted: Nyquist plot, magnitude and phase.
pub fn swept(points: &[Point]) -> Figure {
    let of = |x: fn(&Point) -> f64, y: fn(&Point) -> f64| -> Vec<(f64, f64)> {
        points.iter().map(|point| (x(point), y(point))).collect()
    };
    let khz: fn(&Point) -> f64 = |point| point.frequency_hz / 1e3;
    let nyquist = of(|point| 1e3 * point.admittance_s.re, |point| 1e3 * point.admittance_s.im);
    let magnitude = of(khz, |point| 1e3 * point.admittance_s.norm());
    let (least, most) = magnitude.iter().fold((f64::INFINITY, 0.0f64), |(a, b), it| (a.min(it.1), b.max(it.1)));
    // Below a decade a logarithmic axis has hardly a number on it.
    let axis = |panel: Panel| if most > 10.0 * least { panel.y_log() } else { panel };
    Figure::new("")
        .panel(
            Panel::new("conductance G (mS)", "susceptance B (mS)").title("Nyquist plot").points("measured", &nyquist),
        )
        .panel(
            axis(Panel::new("frequency (kHz)", "|Y| (mS)").title("Bode plot: magnitude"))
                .points("measured", &magnitude),
        )
        .panel(
            Panel::new("frequency (kHz)", "phase (deg)")
                .title("Bode plot: phase")
                .points("measured", &of(khz, |point| point.admittance_s.arg().to_degrees())),
        )
}

/// Coefficients over sliding speed with their intervals, and the torque's power spectrum with the cut-off.
pub fn friction(found: &crate::identify::friction::Identification) -> Figure {
    let report = &found.report;
    let mut coefficients = Panel::new("sliding speed (mm/s)", "friction coefficient").title("Coefficients, 95 %");
    for (name, overall) in [("Coulomb", &report.coulomb), ("static", &report.stat)] {
        let points: Vec<(f64, f64)> =
            overall.speeds.iter().map(|s| (1e3 * s.sliding_m_s, s.coefficient.value)).collect();
        let band: Vec<(f64, f64, f64)> = overall
            .speeds
            .iter()
            .filter_map(|s| s.coefficient.ci95.map(|[low, high]| (1e3 * s.sliding_m_s, low, high)))
            .collect();
        coefficients = coefficients.band(format!("{name}, 95 %"), &band).points(name, &points);
    }
    let spectrum: Vec<(f64, f64)> = found.spectrum.iter().skip(1).copied().collect();
    Figure::new("Friction").size(1400, 560).columns(2).panel(coefficients).panel(
        Panel::new("frequency (Hz)", "power density ((N m)^2/Hz)")
            .title("Power spectrum of the motor trials")
            .x_log()
            .y_log()
            .line("torque", &spectrum)
            .marks("cut-off", &[report.cutoff_hz]),
    )
}

fn name(source: &str) -> &str {
    std::path::Path::new(source).file_name().and_then(|n| n.to_str()).unwrap_or(source)
}
