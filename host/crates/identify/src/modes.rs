//! How many vibration modes a sweep shows, found one at a time.
//!
//! After each fit the residual is searched for the shape a further resonance would leave, over frequency and quality
//! factor, with everything the present circuit could follow projected out. The strongest is added and all is refitted.
//! It counts only if the residual drops by more than chance allows and, where the circuit rather than the noise limits
//! the fit, by enough to matter. Leads and loss tangent are free here, so that a lead's resistance is not taken for a mode.

use super::circuit::{Circuit, Layout, Mode};
use super::fit::{Fit, fit};
use super::sweep::Sweep;
use nalgebra::{Complex, DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// The most modes looked for.
pub const MOST_MODES: usize = 12;
/// Below this quality factor a bump is background.
const LOWEST_Q: f64 = 3.0;
/// A mode must lower the residual by this share where misfit, not noise, limits the fit.
const MATERIAL_DROP: f64 = 0.05;
/// And its circle must be at least this share of |Y| at its resonance there.
const MATERIAL_PEAK: f64 = 0.03;
/// Residual over noise from which the fit counts as limited by the circuit.
const MISFIT: f64 = 1.5;

/// Finds the circuit with as many modes as the data carry; `parasitics` decides what the returned fit has free.
/// No modes means that no resonance was found. `None` when not even the background could be fitted.
pub fn find(sweep: &Sweep, parasitics: bool) -> Option<Fit> {
    let layout = |parasitics| {
        let mut magnitude: Vec<f64> = sweep.points.iter().map(|p| p.admittance_s.norm()).collect();
        magnitude.sort_by(f64::total_cmp);
        let (low, high) = sweep.range_hz();
        Layout { parasitics, scale_s: magnitude[magnitude.len() / 2], omega: TAU * (low * high).sqrt() }
    };
    let plain = layout(false);
    let full = layout(true);
    let mut background = fit(sweep, plain, &capacitor(sweep, |_| Complex::new(0.0, 0.0)))?;
    if background.circuit().cd_f < 1e-6 * capacitor(sweep, |_| Complex::new(0.0, 0.0)).cd_f {
        // A resonance that fills the sweep can leave no capacitance to a fit without one.
        let start = capacitor(sweep, |_| Complex::new(0.0, 0.0));
        background.parameters = plain.pack(&start);
    }
    let Some(first) = add(sweep, plain, &background) else { return Some(background) };
    let mut current = match fit(sweep, full, &first.circuit()) {
        Some(better) if better.residual_rel < first.residual_rel => better,
        _ => first.clone(),
    };
    while current.circuit().modes.len() < MOST_MODES {
        let Some(next) = add(sweep, current.layout, &current) else { break };
        current = next;
    }
    if current.circuit().modes.len() == 1 && !parasitics {
        return Some(first);
    }
    let start = current.circuit();
    if parasitics {
        return fit(sweep, full, &start);
    }
    let bare = Circuit { loss_tangent: 0.0, lead_ohm: 0.0, lead_h: 0.0, ..start };
    fit(sweep, plain, &bare)
}

/// A bare capacitor with a loss, by the median of the data less what `other` explains.
fn capacitor(sweep: &Sweep, other: impl Fn(f64) -> Complex<f64>) -> Circuit {
    let left = |p: &super::sweep::Point| p.admittance_s - other(p.frequency_hz);
    let median = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v[v.len() / 2]
    };
    let cd = median(sweep.points.iter().map(|p| left(p).im / (TAU * p.frequency_hz)).collect());
    let g = median(sweep.points.iter().map(|p| left(p).re).collect());
    let y = median(sweep.points.iter().map(|p| left(p).norm() / (TAU * p.frequency_hz)).collect());
    Circuit {
        cd_f: if cd > 0.0 { cd } else { y },
        loss_s: g,
        loss_tangent: 0.0,
        lead_ohm: 0.0,
        lead_h: 0.0,
        modes: Vec::new(),
    }
}

/// The fit with one more mode, if the data ask for it.
fn add(sweep: &Sweep, layout: Layout, current: &Fit) -> Option<Fit> {
    let (low, high) = sweep.range_hz();
    let spacing = (high - low) / sweep.points.len() as f64;
    let mut taken: Vec<f64> = Vec::new();
    // The strongest place may lead the fit astray; the next ones get their chance. A resonance that dwarfs everything is best
    // met at the peak of the conductance.
    let peak = if current.circuit().modes.is_empty() { conductance_peak(sweep) } else { None };
    for attempt in 0..4 {
        let start = match (attempt, peak) {
            (0, Some(mode)) => Circuit { modes: vec![mode], ..capacitor(sweep, |f| mode.admittance(f)) },
            (0, None) => continue,
            _ => {
                let mode = strongest(sweep, current, &taken)?;
                taken.push(mode.fs_hz);
                let mut start = current.circuit();
                start.modes.push(mode);
                start
            }
        };
        let Some(next) = fit(sweep, layout, &start) else { continue };
        let circuit = next.circuit();
        let sane = circuit.cd_f > 0.0
            && circuit.modes.iter().all(|m| {
                m.fs_hz > low && m.fs_hz < high && m.q >= LOWEST_Q && m.fs_hz / m.q > 0.5 * spacing.min(m.fs_hz * 1e-2)
            });
        if sane && worthwhile(sweep, current, &next) {
            return Some(next);
        }
    }
    None
}

/// The mode that a lone peak of the conductance would be, by its height and its width at half of it.
fn conductance_peak(sweep: &Sweep) -> Option<Mode> {
    let points = &sweep.points;
    let top = points.iter().enumerate().max_by(|a, b| a.1.admittance_s.re.total_cmp(&b.1.admittance_s.re))?.0;
    let height = points[top].admittance_s.re;
    let above = |p: &&super::sweep::Point| p.admittance_s.re > 0.5 * height;
    let right = points[top..].iter().take_while(above).last()?.frequency_hz;
    let left = points[..=top].iter().rev().take_while(above).last()?.frequency_hz;
    let fs_hz = points[top].frequency_hz;
    let q = fs_hz / (right - left).max(fs_hz * 1e-6);
    (height > 0.0).then(|| Mode { fs_hz, c_f: height / (TAU * fs_hz * q), q })
}

/// Whether the last mode of `next` is more than chance, and more than a stopgap for another shortcoming.
fn worthwhile(sweep: &Sweep, current: &Fit, next: &Fit) -> bool {
    let n = 2.0 * sweep.points.len() as f64;
    let chi2 = |fit: &Fit| -> f64 {
        fit.residual_s.iter().zip(&current.sigma_s).map(|(r, s)| r.norm_sqr() / (s * s)).sum::<f64>()
    };
    let (before, after) = (chi2(current), chi2(next));
    // Below the floor of the point variances there is nothing left to explain.
    if before < 0.01 * n || n * (before / after).ln() < 3.0 * n.ln() + 10.0 {
        return false;
    }
    if current.residual_test.misfit_over_noise < MISFIT {
        return true;
    }
    let circuit = next.circuit();
    let Some(mode) = circuit.modes.last() else { return false };
    (after / before).sqrt() < 1.0 - MATERIAL_DROP
        && mode.peak_s() > MATERIAL_PEAK * circuit.admittance(mode.fs_hz).norm()
}

/// The mode whose trace in the residual is strongest, away from the frequencies in `taken`.
fn strongest(sweep: &Sweep, current: &Fit, taken: &[f64]) -> Option<Mode> {
    let f = sweep.frequencies();
    let jacobian = current.layout.jacobian(&current.circuit(), &f, &current.sigma_s);
    let basis = orthonormal(jacobian);
    let residual = DVector::from_iterator(
        2 * f.len(),
        current.residual_s.iter().zip(&current.sigma_s).flat_map(|(r, s)| [r.re / s, r.im / s]),
    );
    let residual = &residual - &basis * basis.tr_mul(&residual);
    let (low, high) = sweep.range_hz();
    let candidates: Vec<(f64, f64)> = [3.0, 10.0, 30.0, 100.0, 300.0, 1000.0]
        .into_iter()
        .flat_map(|q: f64| {
            let steps = ((high / low).ln() * 4.0 * q).ceil().clamp(4.0, f.len().clamp(4, 2000) as f64);
            (0..steps as usize).map(move |i| (low * (high / low).powf((i as f64 + 0.5) / steps), q))
        })
        .filter(|(f0, q)| taken.iter().all(|t| (f0 - t).abs() > t / q))
        .collect();
    candidates
        .into_par_iter()
        .filter_map(|(fs_hz, q)| {
            let unit = Mode { fs_hz, c_f: 1.0, q };
            let shape = DVector::from_iterator(
                2 * f.len(),
                f.iter().zip(&current.sigma_s).flat_map(|(&f, s)| {
                    let y: Complex<f64> = unit.admittance(f) / *s;
                    [y.re, y.im]
                }),
            );
            let power = shape.norm_squared() - basis.tr_mul(&shape).norm_squared();
            let overlap = shape.dot(&residual);
            // A shape the circuit can already imitate says nothing; a negative capacitance is no mode.
            (power > 1e-6 * shape.norm_squared() && overlap > 0.0)
                .then(|| (overlap * overlap / power, Mode { fs_hz, c_f: overlap / power, q }))
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|best| best.1)
}

/// Orthonormal basis of a matrix's columns, dependent ones dropped.
fn orthonormal(mut matrix: DMatrix<f64>) -> DMatrix<f64> {
    let mut kept: Vec<DVector<f64>> = Vec::new();
    for mut column in matrix.column_iter_mut() {
        let before = column.norm();
        for _ in 0..2 {
            for q in &kept {
                let along = q.dot(&column);
                column.axpy(-along, q, 1.0);
            }
        }
        if column.norm() > 1e-9 * before && before > 0.0 {
            kept.push(column.normalize());
        }
    }
    if kept.is_empty() { DMatrix::zeros(matrix.nrows(), 0) } else { DMatrix::from_columns(&kept) }
}
