//! From a sweep to a stator: circuit, modes, mechanical parameters, each with a 95 % interval.

use super::circuit::{Circuit, Mode};
use super::fit::{self, Fit, ResidualTest};
use super::sweep::{Point, Sweep};
use super::{modes, thesis};
use nalgebra::Complex;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use twum_fit::quantile::{NORMAL_95, quantiles, student_95};

/// Force factor of the 30 mm PCBMotor in the thesis (N/V, section A.4), found there by trial.
pub const THESIS_FORCE_FACTOR: f64 = 0.5439;

/// What may be chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Also fit series resistance and inductance of the leads and the loss tangent.
    pub parasitics: bool,
    /// Modal electromechanical force factor (N/V).
    pub force_factor_n_v: f64,
    /// Its relative standard uncertainty; 0 takes it as exact.
    pub force_factor_relative: f64,
    /// Relative standard uncertainty of the shunt (waveforms only); 0 takes it as exact.
    pub shunt_relative: f64,
    /// Bootstrap replicates for the intervals; 0 takes the fit's covariance.
    pub bootstrap: usize,
    /// Seed of the bootstrap.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            parasitics: false,
            force_factor_n_v: THESIS_FORCE_FACTOR,
            force_factor_relative: 0.0,
            shunt_relative: 0.0,
            bootstrap: 0,
            seed: 1,
        }
    }
}

/// What the sweep shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// One resonance.
    SingleMode,
    /// More than one: a single circuit would be the wrong model.
    MultiMode,
    /// None inside the swept range.
    NoResonance,
}

/// 95 % intervals by field name.
pub type Intervals = BTreeMap<&'static str, Option<[f64; 2]>>;

/// One vibration mode's circuit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeReport {
    /// Whether it is the one with the largest conductance peak.
    pub main: bool,
    /// Series resonance (Hz).
    pub fs_hz: f64,
    /// Parallel resonance against Cd (Hz).
    pub fp_hz: f64,
    /// Motional capacitance (F).
    pub c_f: f64,
    /// Motional inductance (H).
    pub l_h: f64,
    /// Motional resistance (Ω).
    pub r_ohm: f64,
    /// Quality factor.
    pub q: f64,
    /// 95 % intervals.
    pub ci95: Intervals,
}

/// What the parasitics were fitted to, when asked for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Parasitics {
    /// Series resistance (Ω).
    pub lead_ohm: f64,
    /// Series inductance (H).
    pub lead_h: f64,
    /// Loss tangent of Cd.
    pub loss_tangent: f64,
}

/// The answer of `twum identify stator`. The single values are those of the main mode, and null without a resonance.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Version of this shape.
    pub schema: u32,
    /// What the sweep shows.
    pub verdict: Verdict,
    /// File or folder read.
    pub source: String,
    /// Frequencies in the sweep.
    pub points: usize,
    /// Lowest and highest frequency (Hz).
    pub range_hz: (f64, f64),
    /// Series resonance (Hz).
    pub fs_hz: Option<f64>,
    /// Parallel resonance (Hz).
    pub fp_hz: Option<f64>,
    /// Clamped capacitance (F).
    pub cd_f: Option<f64>,
    /// Motional capacitance (F).
    pub c_f: Option<f64>,
    /// Motional inductance (H).
    pub l_h: Option<f64>,
    /// Dielectric loss (Ω); null where its conductance is not distinguishable from zero or below.
    pub rd_ohm: Option<f64>,
    /// Motional resistance (Ω).
    pub r_ohm: Option<f64>,
    /// Quality factor.
    pub q: Option<f64>,
    /// √mean(|Y − Ŷ|²/|Y|²).
    pub residual_rel: f64,
    /// Is there structure left in the residual?
    pub residual_test: ResidualTest,
    /// 95 % intervals of the fields above and below.
    pub ci95: Intervals,
    /// How the intervals were made.
    pub ci_method: String,
    /// Each mode's circuit, by frequency.
    pub modes: Vec<ModeReport>,
    /// Force factor the mechanical values rest on (N/V).
    pub force_factor_n_v: f64,
    /// Effective modal mass Ms = η²L (kg).
    pub ms_kg: Option<f64>,
    /// Damping Cs = η²R (N·s/m).
    pub cs_ns_m: Option<f64>,
    /// Stiffness Ks = η²/C (N/m).
    pub ks_n_m: Option<f64>,
    /// Leads and loss tangent, when fitted.
    pub parasitics: Option<Parasitics>,
    /// The thesis's estimator on the same data, for the main mode.
    pub thesis: Option<thesis::Estimate>,
    /// What a reader should know before using the numbers.
    pub notes: Vec<String>,
}

/// The report and what it was made from, for figures.
#[derive(Debug, Clone)]
pub struct Identification {
    /// The numbers.
    pub report: Report,
    /// The fitted circuit.
    pub fit: Fit,
    /// The thesis's ellipse, where it found one.
    pub ellipse: Option<thesis::Ellipse>,
}

/// A quantity of the circuit: its name in the JSON, its value, and how it grows with the shunt and the force factor.
struct Quantity {
    name: &'static str,
    value: fn(&Circuit, &Mode) -> f64,
    by_shunt: f64,
    by_force_factor: f64,
}

const MODAL: [Quantity; 6] = [
    Quantity { name: "fs_hz", value: |_, m| m.fs_hz, by_shunt: 0.0, by_force_factor: 0.0 },
    Quantity { name: "fp_hz", value: |c, m| m.fp_hz(c.cd_f), by_shunt: 0.0, by_force_factor: 0.0 },
    Quantity { name: "c_f", value: |_, m| m.c_f, by_shunt: -1.0, by_force_factor: 0.0 },
    Quantity { name: "l_h", value: |_, m| m.l_h(), by_shunt: 1.0, by_force_factor: 0.0 },
    Quantity { name: "r_ohm", value: |_, m| m.r_ohm(), by_shunt: 1.0, by_force_factor: 0.0 },
    Quantity { name: "q", value: |_, m| m.q, by_shunt: 0.0, by_force_factor: 0.0 },
];

// Stator motion by the electrical analogy (thesis section 4): Ms = η²L, Cs = η²R, Ks = η²/C. Here per η².
const WHOLE: [Quantity; 4] = [
    Quantity { name: "cd_f", value: |c, _| c.cd_f, by_shunt: -1.0, by_force_factor: 0.0 },
    Quantity { name: "ms_kg", value: |_, m| m.l_h(), by_shunt: 1.0, by_force_factor: 2.0 },
    Quantity { name: "cs_ns_m", value: |_, m| m.r_ohm(), by_shunt: 1.0, by_force_factor: 2.0 },
    Quantity { name: "ks_n_m", value: |_, m| 1.0 / m.c_f, by_shunt: 1.0, by_force_factor: 2.0 },
];

/// Identifies the stator behind a sweep. `None` when no circuit at all could be fitted.
pub fn identify(sweep: &Sweep, options: &Options) -> Option<Identification> {
    let fit = modes::find(sweep, options.parasitics)?;
    let circuit = fit.circuit();
    let verdict = match circuit.modes.len() {
        0 => Verdict::NoResonance,
        1 => Verdict::SingleMode,
        _ => Verdict::MultiMode,
    };
    let replicates = bootstrap(sweep, &fit, options);
    let interval = |index: Option<usize>, q: &Quantity| {
        let scale = if q.by_force_factor == 0.0 { 1.0 } else { options.force_factor_n_v.powi(2) };
        let shunt = if sweep.shunt_ohm.is_some() { options.shunt_relative } else { 0.0 };
        let extra = (q.by_shunt * shunt).hypot(q.by_force_factor * options.force_factor_relative);
        let of = |c: &Circuit| (q.value)(c, &index.and_then(|i| c.modes.get(i)).copied().unwrap_or(NO_MODE)) * scale;
        if replicates.is_empty() { fit.interval(extra, of) } else { percentiles(&replicates, extra, of) }
    };
    let main = circuit.main_mode().and_then(|m| circuit.modes.iter().position(|o| o == m));
    let mut ci95 = Intervals::new();
    let mut values: BTreeMap<&str, f64> = BTreeMap::new();
    if let Some(index) = main {
        for q in MODAL.iter().chain(&WHOLE) {
            let scale = if q.by_force_factor == 0.0 { 1.0 } else { options.force_factor_n_v.powi(2) };
            values.insert(q.name, (q.value)(&circuit, &circuit.modes[index]) * scale);
            ci95.insert(q.name, interval(Some(index), q));
        }
    } else {
        values.insert("cd_f", circuit.cd_f);
        ci95.insert("cd_f", interval(None, &WHOLE[0]));
    }
    ci95.insert("rd_ohm", rd_interval(&fit));
    let of_mode = |i: usize| MODAL.iter().map(|q| (q.name, interval(Some(i), q))).collect();
    let modes = mode_reports(&circuit, main, &of_mode);
    let read_off =
        main.map(|i| circuit.modes[i]).and_then(|m| thesis::estimate(&thesis::admittances(sweep), m.fs_hz, m.q));
    let get = |name: &str| values.get(name).copied();
    let report = Report {
        schema: 1,
        verdict,
        source: sweep.source.clone(),
        points: sweep.points.len(),
        range_hz: sweep.range_hz(),
        fs_hz: get("fs_hz"),
        fp_hz: get("fp_hz"),
        cd_f: get("cd_f"),
        c_f: get("c_f"),
        l_h: get("l_h"),
        rd_ohm: (circuit.loss_s > 0.0).then(|| 1.0 / circuit.loss_s),
        r_ohm: get("r_ohm"),
        q: get("q"),
        residual_rel: fit.residual_rel,
        residual_test: fit.residual_test,
        ci95,
        ci_method: if replicates.is_empty() {
            "sandwich covariance of the weighted fit".to_owned()
        } else {
            format!("wild bootstrap, {} replicates, seed {}", replicates.len(), options.seed)
        },
        modes,
        force_factor_n_v: options.force_factor_n_v,
        ms_kg: get("ms_kg"),
        cs_ns_m: get("cs_ns_m"),
        ks_n_m: get("ks_n_m"),
        parasitics: options.parasitics.then_some(Parasitics {
            lead_ohm: circuit.lead_ohm,
            lead_h: circuit.lead_h,
            loss_tangent: circuit.loss_tangent,
        }),
        thesis: read_off.map(|r| r.0),
        notes: notes(sweep, &fit, verdict, options),
    };
    Some(Identification { report, fit, ellipse: read_off.map(|r| r.1) })
}

/// Every mode with its intervals, by frequency.
fn mode_reports(circuit: &Circuit, main: Option<usize>, intervals: &dyn Fn(usize) -> Intervals) -> Vec<ModeReport> {
    let of = |(i, m): (usize, &Mode)| ModeReport {
        main: main == Some(i),
        fs_hz: m.fs_hz,
        fp_hz: m.fp_hz(circuit.cd_f),
        c_f: m.c_f,
        l_h: m.l_h(),
        r_ohm: m.r_ohm(),
        q: m.q,
        ci95: intervals(i),
    };
    let mut modes: Vec<ModeReport> = circuit.modes.iter().enumerate().map(of).collect();
    modes.sort_by(|a, b| a.fs_hz.total_cmp(&b.fs_hz));
    modes
}

const NO_MODE: Mode = Mode { fs_hz: f64::NAN, c_f: f64::NAN, q: f64::NAN };

/// Rd's interval through its conductance, which is what the data bound; an upper end beyond all bounds is null.
fn rd_interval(fit: &Fit) -> Option<[f64; 2]> {
    let g = fit.circuit().loss_s;
    let reach = student_95(fit.freedom()) * fit.standard_error(|c| c.loss_s)?;
    if g + reach <= 0.0 {
        return None;
    }
    // JSON has no infinity: serde_json writes null.
    Some([1.0 / (g + reach), if g - reach > 0.0 { 1.0 / (g - reach) } else { f64::INFINITY }])
}

fn notes(sweep: &Sweep, fit: &Fit, verdict: Verdict, options: &Options) -> Vec<String> {
    let mut notes = Vec::new();
    let circuit = fit.circuit();
    if !fit.residual_test.passed {
        let lead =
            if verdict == Verdict::SingleMode && !options.parasitics { parasitic_hint(sweep, fit) } else { None };
        notes.push(lead.unwrap_or_else(|| {
            format!(
                "the residual has structure (neighbouring points correlate by {:.2}, {:.1} times the noise): the circuit \
                 is not the whole truth, and the intervals are widened for it",
                fit.residual_test.lag1, fit.residual_test.misfit_over_noise
            )
        }));
    }
    if verdict == Verdict::NoResonance && !fit.residual_test.passed {
        notes.push("yet it is no plain capacitor: a resonance may lie beyond the swept range; sweep wider".to_owned());
    }
    if circuit.loss_s <= 0.0 {
        notes.push("the dielectric loss 1/Rd is not above zero in these data".to_owned());
    }
    let spacing = sweep.points.windows(2).map(|p| p[1].frequency_hz - p[0].frequency_hz).fold(0.0, f64::max);
    if let Some(m) = circuit.main_mode() {
        let width = m.fs_hz / m.q;
        let local = sweep.points.iter().filter(|p| (p.frequency_hz - m.fs_hz).abs() < width).count();
        if local < 5 {
            notes.push(format!(
                "only {local} points within a bandwidth of the resonance ({width:.1} Hz; coarsest step {spacing:.1} Hz): sweep it finer"
            ));
        }
        if fit.covariance.is_none() {
            notes.push("the data do not determine every parameter: no intervals".to_owned());
        }
    }
    notes
}

/// Whether leads explain the misfit, and what the resonance would be with them.
fn parasitic_hint(sweep: &Sweep, plain: &Fit) -> Option<String> {
    let layout = super::circuit::Layout { parasitics: true, ..plain.layout };
    let full = fit::fit(sweep, layout, &plain.circuit())?;
    let (c, m) = (full.circuit(), *full.circuit().main_mode()?);
    // Leads that explain the resonance away altogether explain nothing.
    (m.q.is_finite() && full.residual_rel < 0.7 * plain.residual_rel).then(|| {
        format!(
            "the residual has structure: leads ({:.3} ohm, {:.3e} H) and a loss tangent of {:.4} lower it from {:.2} % to \
             {:.2} % and would make fs {:.0} Hz and Q {:.0}; use --parasitics if they are real",
            c.lead_ohm,
            c.lead_h,
            c.loss_tangent,
            100.0 * plain.residual_rel,
            100.0 * full.residual_rel,
            m.fs_hz,
            m.q
        )
    })
}

/// Refits of the sweep with residuals of random sign, in runs as long as they correlate.
fn bootstrap(sweep: &Sweep, fit: &Fit, options: &Options) -> Vec<Circuit> {
    let circuit = fit.circuit();
    let f = sweep.frequencies();
    let run = if fit.residual_test.passed { 1 } else { (f.len() / 20).clamp(1, 50) };
    (0..options.bootstrap)
        .into_par_iter()
        .filter_map(|replicate| {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(options.seed);
            rng.set_stream(replicate as u64);
            let mut sign = 1.0;
            let y: Vec<Complex<f64>> = f
                .iter()
                .zip(&fit.residual_s)
                .enumerate()
                .map(|(i, (&f, r))| {
                    if i % run == 0 {
                        sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
                    }
                    circuit.admittance(f) + r * sign
                })
                .collect();
            fit::minimise(fit.layout, &f, &y, &fit.sigma_s, &circuit)
        })
        .collect()
}

fn percentiles(replicates: &[Circuit], extra: f64, of: impl Fn(&Circuit) -> f64) -> Option<[f64; 2]> {
    let values: Vec<f64> = replicates.iter().map(of).filter(|v| v.is_finite()).collect();
    if values.len() < 20 {
        return None;
    }
    let [low, middle, high] = quantiles(values, [0.025, 0.5, 0.975]);
    // A further independent uncertainty adds in quadrature to each half.
    let widen = |end: f64| middle * ((end / middle).ln().hypot(NORMAL_95 * extra) * (end - middle).signum()).exp();
    Some(if extra > 0.0 { [widen(low), widen(high)] } else { [low, high] })
}

/// A sweep made from a known circuit, without noise; the base of synthetic studies and of the simulated bench.
pub fn synthetic(circuit: &Circuit, frequency_hz: impl IntoIterator<Item = f64>) -> Sweep {
    Sweep {
        source: "synthetic".to_owned(),
        points: frequency_hz
            .into_iter()
            .map(|f| Point { frequency_hz: f, admittance_s: circuit.admittance(f), sigma_s: None })
            .collect(),
        waveforms: Vec::new(),
        shunt_ohm: None,
    }
}
