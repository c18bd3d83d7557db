//! The demonstration: something is hidden in a simulated motor, an experiment is made on it and the cause looked for; then the
//! firmware's own code drives a motor along the thesis's sine, once under each named controller. The recordings are decoded,
//! checked bit for bit and drawn.

pub mod hidden;

use crate::compare::replay::{Replay, ReplayReport};
use crate::diagnose::DiagnoseError;
use crate::link::bench::{Action, Experiment, perform};
use crate::link::{LinkError, Session, SimulatedLink, Tally};
use crate::model::effects::{EffectError, EffectSet};
use crate::model::motor::Motor;
use crate::model::parameters::Flavour;
use crate::output::{NewFolder, Output, OutputError};
use crate::record::load::LoadError;
use crate::record::measurement::ControlSpec;
use crate::record::store::{Entry, Reader, Sender, StoreError};
use crate::report::figure::{Figure, FigureError, Panel};
use crate::sim::{NotOnABoard, Setup};
use hidden::{Found, Hide};
use serde::Serialize;
use std::io::Write as _;
use std::path::Path;
use thiserror::Error;
use twum_shared::frame;
use twum_shared::message::{CaptureMode, Configuration, ControlBlock, DeviceMessage, RunEnd, TrackRun};
use twum_shared::reference::Reference;

/// The thesis's test: 89 counts at 1.257 rad/s (C.2).
pub const THESIS_SINE: Reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
/// Length of each run, ms.
const DURATION_MS: u32 = 20_000;

/// Why a demonstration failed.
#[derive(Debug, Error)]
pub enum DemoError {
    /// The conversation with the simulated board.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The recordings.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// What cannot be hidden in a simulated board.
    #[error(transparent)]
    NotOnABoard(#[from] NotOnABoard),
    /// An effect that is not there.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// The runs of the experiment.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// The diagnosis.
    #[error(transparent)]
    Diagnose(#[from] DiagnoseError),
    /// Its answer as JSON.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// The pictures.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// The folder of the experiment.
    #[error("cannot make the experiment's folder: {0}")]
    Folder(std::io::Error),
    /// The other files.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// How well one run tracked, and what was checked about it.
#[derive(Clone, Debug, Serialize)]
pub struct RunSummary {
    /// Name of the controller.
    pub control: &'static str,
    /// Mean squared error, deg².
    pub mse_deg2: f64,
    /// Mean absolute error, deg.
    pub mean_absolute_deg: f64,
    /// Largest error, deg.
    pub worst_deg: f64,
    /// Mean start of a tick after it was due, µs of virtual time.
    pub tick_late_mean_us: f64,
    /// Latest start, µs of virtual time.
    pub tick_late_worst_us: u16,
    /// Longest tick, µs of virtual time.
    pub tick_duration_worst_us: u16,
    /// Frames received, lost and bad.
    pub link: Tally,
    /// The bit-for-bit check, made on the recording as it was read back.
    pub replay: ReplayReport,
}

/// The control ticks of a run, for its files and pictures.
struct Ticks {
    time_s: Vec<f64>,
    target_deg: Vec<f64>,
    position_deg: Vec<f64>,
    duty: Vec<f64>,
    late_us: Vec<u16>,
    duration_us: Vec<u16>,
}

/// All that a demonstration found.
#[derive(Clone, Debug, Serialize)]
pub struct Demo {
    /// The experiment on the motor with something hidden.
    pub diagnosis: Found,
    /// The two controllers.
    pub controllers: Vec<RunSummary>,
}

/// Runs the demonstration into a new folder; `progress` is told what is being done.
///
/// # Errors
/// When the folder exists or a file in it cannot be written; for an effect that a board cannot have.
pub fn run(folder: &Path, hide: &Hide, seed: u64, mut progress: impl FnMut(&str)) -> Result<Demo, DemoError> {
    let mut folder = NewFolder::begin(folder)?;
    let mut summaries = Vec::new();
    let recordings = folder.path().join("experiment");
    std::fs::create_dir(&recordings).map_err(DemoError::Folder)?;
    let (page, diagnosis) = hidden::experiment(&recordings, hide, seed, &mut progress)?;
    let hidden = diagnosis.hidden.as_deref().unwrap_or("nothing");
    let mut page = page
        .heading("What was hidden")
        .paragraph(&format!(
            "Hidden in the simulated motor, with seed {seed}: {hidden}. The runs are in experiment/; `twum diagnose` takes \
             that folder, and `twum demo --hide NAME` hides what you name."
        ))
        .heading("Two controllers");
    page = page.paragraph(
        "The firmware's own code, run in virtual time on a simulated board, aligned a simulated 30 mm PCBMotor (flavour `measured`) and tracked \
         89 counts (80.1°) at 1.257 rad/s for 20 s under both named controllers. Every frame was recorded; every control \
         tick in the recordings was recomputed with the same fixed-point step. Times of ticks are virtual.",
    );
    for (name, control) in [("thesis", ControlSpec::Thesis), ("default", ControlSpec::Default)] {
        progress(&format!("tracking with `{name}`"));
        let recording = folder.path().join(format!("{name}.mcap"));
        let link = track(&recording, control)?;
        progress(&format!("checking `{name}`"));
        let (ticks, replay) = read_back(&recording)?;
        folder.file(format!("{name}.csv"), |out| write_csv(out, &ticks))?;
        let figure = figure(name, &ticks);
        for extension in ["svg", "png"] {
            figure.write(folder.path().join(format!("{name}.{extension}")))?;
        }
        let summary = summarise(name, &ticks, link, replay);
        page = page.heading(&format!("Controller `{name}`")).figure(figure, "Position, error and duty of the run.");
        summaries.push(summary);
    }
    let page = page.heading("Table").table(&table_header(), &table_rows(&summaries));
    page.write(folder.path().join("report.html"))?;
    folder.file("diagnosis.json", |out| write_json(out, &diagnosis))?;
    folder.finish()?;
    Ok(Demo { diagnosis, controllers: summaries })
}

fn track(recording: &Path, control: ControlSpec) -> Result<Tally, DemoError> {
    let spec = control.config().expect("the named controllers are valid; a test builds both");
    // The thesis's own test, which this flavour gives as the real motor did.
    let setup = Setup::hybrid(&Motor::pcbmotor_30mm(), Flavour::Measured, &EffectSet::default())?;
    let mut session = Session::new(SimulatedLink::new(setup));
    let experiment = Experiment {
        configuration: Some(Configuration::with_control(spec)),
        capture: CaptureMode { bits: true, edges: true, control: true },
        action: Action::Track(TrackRun { reference: THESIS_SINE, duration_ms: DURATION_MS }),
        recording: Some(recording.to_owned()),
        motor: "pcbmotor-30mm".to_owned(),
    };
    let outcome = perform(&mut session, &experiment, None, |_| {})?;
    match outcome.run.map(|run| run.end) {
        Some(RunEnd::Fault(fault)) => Err(LinkError::Fault(fault).into()),
        _ => Ok(outcome.tally),
    }
}

/// Decodes and checks a recording from its file: what is claimed is what was stored.
fn read_back(recording: &Path) -> Result<(Ticks, ReplayReport), DemoError> {
    let mut reader = Reader::open(recording)?;
    let mut replay = Replay::new();
    let mut ticks = Ticks {
        time_s: Vec::new(),
        target_deg: Vec::new(),
        position_deg: Vec::new(),
        duty: Vec::new(),
        late_us: Vec::new(),
        duration_us: Vec::new(),
    };
    let mut configuration: Option<Configuration> = None;
    while let Some(entry) = reader.next_entry()? {
        let Entry::Frame { sender: Sender::Device, bytes, .. } = entry else { continue };
        let mut block = bytes.strip_suffix(&[0]).unwrap_or(bytes).to_vec();
        let Ok((_, message)) = frame::decode::<DeviceMessage>(&mut block) else { continue };
        replay.observe(&message);
        match (&message, &configuration) {
            (DeviceMessage::Configured(new), _) => configuration = Some(*new),
            (DeviceMessage::Control(block), Some(configuration)) => ticks.extend(block, configuration),
            _ => {}
        }
    }
    Ok((ticks, replay.report().clone()))
}

impl Ticks {
    fn extend(&mut self, block: &ControlBlock, configuration: &Configuration) {
        let degrees = |counts: i32| f64::from(counts) * 360.0 / f64::from(configuration.edges_per_rev);
        for (index, sample) in block.samples.iter().enumerate() {
            let tick = block.first_tick + index as u64;
            self.time_s.push(tick as f64 * f64::from(configuration.control.period_us) * 1e-6);
            self.target_deg.push(degrees(sample.target));
            self.position_deg.push(degrees(sample.position));
            let duty = f64::from(sample.on_steps) / f64::from(configuration.control.duty_steps);
            self.duty.push(duty * f64::from(sample.direction.sign()));
            self.late_us.push(sample.late_us);
            self.duration_us.push(sample.duration_us);
        }
    }

    fn errors_deg(&self) -> impl Iterator<Item = f64> + '_ {
        self.target_deg.iter().zip(&self.position_deg).map(|(target, position)| target - position)
    }

    fn against_time(&self, values: impl Iterator<Item = f64>) -> Vec<(f64, f64)> {
        self.time_s.iter().copied().zip(values).collect()
    }
}

fn summarise(control: &'static str, ticks: &Ticks, link: Tally, replay: ReplayReport) -> RunSummary {
    let count = ticks.time_s.len().max(1) as f64;
    RunSummary {
        control,
        mse_deg2: ticks.errors_deg().map(|error| error * error).sum::<f64>() / count,
        mean_absolute_deg: ticks.errors_deg().map(f64::abs).sum::<f64>() / count,
        worst_deg: ticks.errors_deg().map(f64::abs).fold(0.0, f64::max),
        tick_late_mean_us: ticks.late_us.iter().map(|&late| f64::from(late)).sum::<f64>() / count,
        tick_late_worst_us: ticks.late_us.iter().copied().max().unwrap_or(0),
        tick_duration_worst_us: ticks.duration_us.iter().copied().max().unwrap_or(0),
        link,
        replay,
    }
}

fn figure(name: &str, ticks: &Ticks) -> Figure {
    Figure::new(format!("Thesis sine under `{name}`, simulated board"))
        .size(1000, 900)
        .panel(
            Panel::new("time (s)", "position (°)")
                .line("target", &ticks.against_time(ticks.target_deg.iter().copied()))
                .line("position", &ticks.against_time(ticks.position_deg.iter().copied())),
        )
        .panel(Panel::new("time (s)", "error (°)").line("target - position", &ticks.against_time(ticks.errors_deg())))
        .panel(Panel::new("time (s)", "duty (signed)").line("duty", &ticks.against_time(ticks.duty.iter().copied())))
}

fn write_json(out: &mut Output, found: &Found) -> Result<(), DemoError> {
    let text = serde_json::to_string_pretty(found)?;
    writeln!(out, "{text}").map_err(|reason| out.failed(reason).into())
}

fn write_csv(out: &mut Output, ticks: &Ticks) -> Result<(), OutputError> {
    let mut write = || -> std::io::Result<()> {
        writeln!(out, "time_s,target_deg,position_deg,duty")?;
        for index in 0..ticks.time_s.len() {
            let (time, target, position) = (ticks.time_s[index], ticks.target_deg[index], ticks.position_deg[index]);
            writeln!(out, "{time:.4},{target:.1},{position:.1},{:.5}", ticks.duty[index])?;
        }
        Ok(())
    };
    write().map_err(|reason| out.failed(reason))
}

/// Header of [`table_rows`].
pub fn table_header() -> [&'static str; 9] {
    [
        "controller",
        "MSE (deg²)",
        "mean |error| (°)",
        "worst (°)",
        "tick late mean/worst (µs, virtual)",
        "tick duration worst (µs, virtual)",
        "frames received/lost/bad",
        "ticks checked",
        "mismatched",
    ]
}

/// The summaries as rows of text.
pub fn table_rows(summaries: &[RunSummary]) -> Vec<Vec<String>> {
    summaries
        .iter()
        .map(|summary| {
            vec![
                summary.control.to_owned(),
                format!("{:.3}", summary.mse_deg2),
                format!("{:.3}", summary.mean_absolute_deg),
                format!("{:.1}", summary.worst_deg),
                format!("{:.1} / {}", summary.tick_late_mean_us, summary.tick_late_worst_us),
                summary.tick_duration_worst_us.to_string(),
                format!("{} / {} / {}", summary.link.received, summary.link.lost, summary.link.bad),
                summary.replay.checked.to_string(),
                summary.replay.mismatched.to_string(),
            ]
        })
        .collect()
}
