//! What was identified, as text for a terminal.

use crate::diagnose::inertial::MotorReport;
use crate::identify::{force_factor, friction, stator};
use crate::report::table::table;
use std::fmt::Write as _;

/// The report for a person: verdict, one table with the thesis's estimator beside the fit, modes and notes.
pub fn stator(report: &stator::Report) -> String {
    let mut out = String::new();
    let verdict = match report.verdict {
        stator::Verdict::SingleMode => "single-mode".to_owned(),
        stator::Verdict::MultiMode => format!("multi-mode: {} modes; the table is the main one's", report.modes.len()),
        stator::Verdict::NoResonance => "no resonance in the swept range".to_owned(),
    };
    let _ = writeln!(
        out,
        "{verdict}\n{} points, {:.0} to {:.0} Hz; relative residual {:.2} %\n",
        report.points,
        report.range_hz.0,
        report.range_hz.1,
        100.0 * report.residual_rel
    );
    let t = report.thesis.as_ref();
    let rows = [
        ("fs", "fs_hz", report.fs_hz, t.map(|t| t.fs_hz), "Hz"),
        ("fp", "fp_hz", report.fp_hz, t.and_then(|t| t.fp_hz), "Hz"),
        ("Q", "q", report.q, None, ""),
        ("Cd", "cd_f", report.cd_f, t.map(|t| t.cd_f), "F"),
        ("Rd", "rd_ohm", report.rd_ohm, t.map(|t| t.rd_ohm), "ohm"),
        ("C", "c_f", report.c_f, t.and_then(|t| t.c_f), "F"),
        ("L", "l_h", report.l_h, t.and_then(|t| t.l_h), "H"),
        ("R", "r_ohm", report.r_ohm, t.map(|t| t.r_ohm), "ohm"),
        ("Ms", "ms_kg", report.ms_kg, None, "kg"),
        ("Cs", "cs_ns_m", report.cs_ns_m, None, "N s/m"),
        ("Ks", "ks_n_m", report.ks_n_m, None, "N/m"),
    ];
    let number = |v: Option<f64>| v.map_or("-".to_owned(), figure);
    let rows = rows.map(|(label, name, fit, thesis, unit)| {
        let interval = match report.ci95.get(name) {
            Some(Some([low, high])) => format!("[{}, {}]", figure(*low), figure(*high)),
            _ => "-".to_owned(),
        };
        vec![label.to_owned(), number(fit), interval, number(thesis), unit.to_owned()]
    });
    out += &table(&["", "fit", "95 % interval", "thesis", ""], &rows);
    if report.modes.len() > 1 {
        let rows: Vec<Vec<String>> = report
            .modes
            .iter()
            .map(|m| {
                let [c, l, r] = [m.c_f, m.l_h, m.r_ohm].map(|v| format!("{v:.4e}"));
                let main = if m.main { "main" } else { "" };
                vec![format!("{:.1}", m.fs_hz), format!("{:.1}", m.q), c, l, r, main.to_owned()]
            })
            .collect();
        out += "\nmodes\n";
        out += &table(&["fs (Hz)", "Q", "C (F)", "L (H)", "R (ohm)", ""], &rows);
    }
    for note in &report.notes {
        let _ = writeln!(out, "\nnote: {note}");
    }
    let _ = writeln!(out, "\nMs, Cs, Ks rest on a force factor of {} N/V.", report.force_factor_n_v);
    out
}

fn figure(value: f64) -> String {
    if !value.is_finite() {
        "unbounded".to_owned()
    } else if (0.01..1e6).contains(&value.abs()) {
        format!("{value:.*}", (5 - value.abs().log10().floor() as i32).clamp(0, 6) as usize)
    } else {
        format!("{value:.5e}")
    }
}

/// The report for a person.
pub fn friction(report: &friction::Report) -> String {
    let mut out = String::new();
    let interval = |ci: Option<[f64; 2]>| ci.map_or("-".to_owned(), |[a, b]| format!("[{a:.4}, {b:.4}]"));
    for (name, o) in [("Coulomb", &report.coulomb), ("static", &report.stat)] {
        let _ = writeln!(out, "{name} coefficient: {:.4} {}", o.value, interval(o.ci95));
        let rows: Vec<Vec<String>> = o
            .speeds
            .iter()
            .map(|s| {
                let [sliding, mu] = [1e3 * s.sliding_m_s, s.coefficient.value].map(|v| format!("{v:.4}"));
                let torque = format!("{:.6}", s.torque_nm);
                let interval = interval(s.coefficient.ci95);
                vec![s.speed_rpm.to_string(), sliding, mu, interval, torque, s.trials.to_string()]
            })
            .collect();
        out += &table(&["rpm", "sliding mm/s", "mu", "95 %", "torque N m", "trials"], &rows);
        if let (Some(slope), Some(p)) = (o.slope_s_m, o.slope_p) {
            let _ = writeln!(out, "  slope over sliding speed: {:.3} s/m (p = {p:.3})", slope.value);
        }
        out.push('\n');
    }
    let _ = writeln!(out, "low-pass at {:.2} Hz ({})", report.cutoff_hz, report.cutoff_source);
    for note in &report.notes {
        let _ = writeln!(out, "note: {note}");
    }
    out
}

/// The report for a person.
pub fn force_factor(report: &force_factor::Report) -> String {
    let mut out = String::new();
    // Data that say next to nothing bound nothing.
    let bound = |end: f64| if end.is_finite() { format!("{end:.5}") } else { "no bound".to_owned() };
    let [a, b] = report.ci95.map(bound);
    let [c, d] = report.ci95_others_exact.map(bound);
    let _ = writeln!(out, "force factor {:.5} N/V, 95 % [{a}, {b}] ({} model)", report.eta_n_v, report.flavour);
    let _ = writeln!(out, "  [{c}, {d}] were everything else in the motor file exact\n");
    let figure = |value: f64| if value.is_finite() { format!("{value:.2}") } else { "-".to_owned() };
    let percent = |share: f64| format!("{:.1}%", 100.0 * share);
    let trade = |t: &force_factor::Trade| {
        let known = [percent(t.prior_relative), percent(t.posterior_relative)];
        [vec![t.with.to_string(), figure(t.correlation), figure(t.exchange)], known.to_vec()].concat()
    };
    let trades: Vec<_> = report.trades.iter().map(trade).collect();
    out += &table(&["with", "correlation", "% of eta for 1 %", "known to", "after fit"], &trades);
    out.push('\n');
    let ms = |s: Option<f64>| s.map_or("-".to_owned(), |s| format!("{:.1}", 1e3 * s));
    let runs: Vec<Vec<String>> = report
        .runs
        .iter()
        .map(|r| {
            let [rpm, model_rpm] = [r.rpm, r.model_rpm].map(|v| format!("{v:.2}"));
            vec![r.id.clone(), format!("{:.3}", r.duty), rpm, model_rpm, ms(r.lag_s), ms(r.model_lag_s)]
        })
        .collect();
    out += &table(&["run", "duty", "rpm", "model", "lag ms", "model"], &runs);
    let mm = |t: f64| format!("{:.2}", 1e3 * t);
    let measured: Vec<String> = report.stall_measured_nm.iter().map(|t| mm(*t)).collect();
    let beside = if measured.is_empty() { String::new() } else { format!(", measured {}", measured.join(", ")) };
    let _ = writeln!(out, "\nstall torque of the fitted model {} mN m{beside}", mm(report.stall_nm));
    if let Some(r2) = report.r2_speed {
        let _ = writeln!(out, "\nR2 of the speeds {r2:.4}");
    }
    for note in &report.notes {
        let _ = writeln!(out, "note: {note}");
    }
    out
}

/// The numbers of an ordinary motor, and the input that cancels them.
pub fn motor(report: &MotorReport) -> String {
    let mut out = format!(
        "{}; errors on what was not fitted: {:.3} rpm with gain and lag alone, {:.3} with all, noise {:.3}\n\n",
        report.verdict.word(),
        report.line_rmse_rpm,
        report.rmse_rpm,
        report.noise_floor_rpm
    );
    let rows: Vec<Vec<String>> = report
        .parameters
        .iter()
        .map(|p| {
            let interval = format!("[{}, {}]", figure(p.ci95[0]), figure(p.ci95[1]));
            vec![p.name.clone(), figure(p.value), interval, p.unit.clone(), p.effect.clone()]
        })
        .collect();
    out += &table(&["", "fit", "95 % interval", "", "of"], &rows);
    let _ = writeln!(
        out,
        "\nsizes are shares of the largest input, {}; `ambiguous` could be another effect",
        report.largest_input
    );
    if let Some(c) = &report.compensation {
        let _ = writeln!(
            out,
            "\nfeed-forward  {}\nexpected      {:.3} rpm of error in a sine of half the reach, {:.3} with gain and lag alone (simulated)",
            c.formula, c.rms_rpm, c.line_rms_rpm
        );
    }
    for note in &report.notes {
        let _ = writeln!(out, "\nnote: {note}");
    }
    out
}
