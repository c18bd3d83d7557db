//! Writing what was identified into a motor file, with its interval and where it came from.

use super::{force_factor, friction, stator};
use std::path::Path;
use twum_files::output::{self, Existing, OutputError};
use twum_fit::quantile::NORMAL_95;
use twum_motor::motor::{Entry, Motor, MotorError};
use twum_motor::parameters::Flavour;

/// One parameter to write.
#[derive(Debug, Clone, PartialEq)]
pub struct Update {
    /// Name in the motor file.
    pub name: &'static str,
    /// The table it belongs to; `None` is the listed one, and the physical one where that has it.
    pub flavour: Option<Flavour>,
    /// Value in the unit of the motor file.
    pub value: f64,
    /// 95 % interval.
    pub ci95: Option<[f64; 2]>,
    /// Command and data it came from.
    pub source: String,
}

/// Why a motor file could not be written.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The motor file to start from, or the outcome, will not do.
    #[error(transparent)]
    Motor(#[from] MotorError),
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] OutputError),
    /// It could not be put as TOML.
    #[error("cannot write a motor as TOML")]
    Toml(#[from] toml::ser::Error),
    /// There is nothing to save.
    #[error("nothing to save: {0}")]
    Nothing(String),
}

/// Writes `updates` into the motor file at `path`; a new one starts from the motor `base` and takes the file's name. The
/// file is checked as a whole before the old one is replaced. Comments in it are not kept.
///
/// # Errors
/// [`SaveError`]; the old file is then as it was.
pub fn save(path: &Path, base: &str, updates: &[Update]) -> Result<(), SaveError> {
    let existing = path.exists();
    let mut motor = Motor::load(&if existing { path.display().to_string() } else { base.to_owned() })?;
    if !existing && let Some(stem) = path.file_stem().and_then(|s| s.to_str()) {
        motor.title = format!("{} ({stem})", motor.title);
        stem.clone_into(&mut motor.name);
    }
    for update in updates {
        let source = match update.ci95 {
            Some([low, high]) => format!("{}; 95 % interval {low:.6e} to {high:.6e}", update.source),
            None => update.source.clone(),
        };
        let write = |entry: &mut Entry| {
            entry.value = update.value;
            entry.uncertainty =
                update.ci95.map(|[low, high]| (high - low) / (2.0 * NORMAL_95)).filter(|u| u.is_finite());
            entry.source.clone_from(&source);
        };
        let listed = motor.parameters.get_mut(update.name);
        match (update.flavour, listed) {
            (None | Some(Flavour::Thesis), Some(entry)) => write(entry),
            (Some(flavour @ (Flavour::Physical | Flavour::Measured)), Some(listed)) => {
                let own = if flavour == Flavour::Physical { &mut motor.physical } else { &mut motor.measured };
                write(own.entry(update.name.to_owned()).or_insert_with(|| listed.clone()));
            }
            (_, None) => {}
        }
        if let (None, Some(entry)) = (update.flavour, motor.physical.get_mut(update.name)) {
            write(entry);
        }
    }
    let text = motor.to_toml()?;
    Motor::parse(&path.display().to_string(), &text)?;
    Ok(if existing { output::rewrite(path, text) } else { output::write(path, text, Existing::Keep) }?)
}

/// A stator's parameters. In the thesis's reading Ms, Cs and Ks are η²L, η²R and η²/C. The physical reading keeps its
/// modal mass, which no admittance tells, and takes resonance and damping from the sweep: Ks = Ms·(2πfs)², Cs = Ms·2πfs/Q.
///
/// # Errors
/// When the sweep showed no resonance, or the motor `base` cannot be read.
pub fn stator(report: &stator::Report, path: &Path, base: &str) -> Result<Vec<Update>, SaveError> {
    let (Some(ms), Some(cs), Some(ks), Some(fs), Some(q)) =
        (report.ms_kg, report.cs_ns_m, report.ks_n_m, report.fs_hz, report.q)
    else {
        return Err(SaveError::Nothing("the sweep shows no resonance".to_owned()));
    };
    let existing = path.exists();
    let motor = Motor::load(&if existing { path.display().to_string() } else { base.to_owned() })?;
    let mass = motor.parameters(Flavour::Physical).modal_mass_kg;
    let omega = std::f64::consts::TAU * fs;
    let interval = |name: &str| report.ci95.get(name).copied().flatten();
    let verdict = if report.modes.len() > 1 { ", the main of several modes" } else { "" };
    let source = format!(
        "twum identify stator {}: {} points{verdict}, eta = {} N/V, residual {:.2} %",
        report.source,
        report.points,
        report.force_factor_n_v,
        100.0 * report.residual_rel
    );
    let update = |name, flavour, value, ci95, how: &str| Update {
        name,
        flavour: Some(flavour),
        value,
        ci95,
        source: format!("{source}{how}"),
    };
    let scaled = |name: &str, f: &dyn Fn(f64) -> f64| {
        interval(name).map(|[a, b]| if f(a) < f(b) { [f(a), f(b)] } else { [f(b), f(a)] })
    };
    let kept = format!("; resonance and Q at the modal mass of {mass} kg");
    Ok(vec![
        update("Ms", Flavour::Thesis, ms, interval("ms_kg"), ""),
        update("Cs", Flavour::Thesis, cs, interval("cs_ns_m"), ""),
        update("Ks", Flavour::Thesis, ks, interval("ks_n_m"), ""),
        update("eta", Flavour::Thesis, report.force_factor_n_v, None, "; given, not identified by the sweep"),
        update(
            "Ks",
            Flavour::Physical,
            mass * omega * omega,
            scaled("fs_hz", &|f| mass * (std::f64::consts::TAU * f).powi(2)),
            &kept,
        ),
        update("Cs", Flavour::Physical, mass * omega / q, scaled("q", &|q| mass * omega / q), &kept),
    ])
}

/// The friction coefficients. The bench drags the rotor over a stator that does not vibrate, which is the model's `uoff`; the
/// thesis takes the same number for friction under a wave, `u`.
pub fn friction(report: &friction::Report) -> Vec<Update> {
    let source = format!("twum identify friction {}: {} speeds", report.source, report.coulomb.speeds.len());
    ["u", "uoff"]
        .map(|name| Update {
            name,
            flavour: None,
            value: report.coulomb.value,
            ci95: report.coulomb.ci95,
            source: source.clone(),
        })
        .into()
}

/// The force factor, in the reading it was fitted in.
pub fn force_factor(report: &force_factor::Report) -> Vec<Update> {
    vec![Update {
        name: "eta",
        flavour: Some(report.flavour),
        value: report.eta_n_v,
        ci95: Some(report.ci95),
        source: format!("twum identify force-factor {}: {} runs", report.source, report.runs.len()),
    }]
}
