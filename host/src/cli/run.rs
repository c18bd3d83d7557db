//! What `twum speed` and `twum track` share: a run that is watched, and what is said of the motor afterwards.

use super::configuration::ConfigurationArgs;
use super::connect::{ConnectArgs, RecordArgs};
use super::output::progress;
use anyhow::Result;
use std::process::ExitCode;
use std::time::Duration;
use twum_host::link::bench::Action;
use twum_host::record::export::{EncoderSource, to_measurement};
use twum_host::record::live::LiveView;
use twum_host::record::load::load_runs;
use twum_host::record::measurement::Measurement;
use twum_host::record::recording::{Command, Gathering};
use twum_host::report::run::RunFigures;
use twum_shared::message::{Configuration, DeviceMessage};
use twum_shared::step::ConfigSpec;

/// A run that is not recorded is kept in memory up to this length for its figures: 2000 ticks a second are 80 MB then.
const KEPT: Duration = Duration::from_secs(900);

/// Makes a run and says how the line and the motor did.
pub fn make(
    connect: &ConnectArgs,
    configuration: &ConfigurationArgs,
    record: &RecordArgs,
    action: impl Fn(&Configuration) -> Result<Action>,
) -> Result<ExitCode> {
    // How long the run is does not hang on the configuration; that its counts may is why the board's own is asked for later.
    let planned = action(&configuration.over(Configuration::with_control(ConfigSpec::DEFAULT))?)?;
    let (command, length) = match &planned {
        Action::Speed(run) => (Command::Speed(*run), Duration::from_millis(run.duration_ms.into())),
        Action::Track(run) => (Command::Track(run.clone()), Duration::from_millis(run.duration_ms.into())),
        Action::Watch(_) | Action::Driver(_) => (Command::Unknown, Duration::ZERO),
    };
    let mut kept = (record.out.is_none() && length <= KEPT).then(|| Gathering::new(command));
    let (bar, mut view, mut start_us) = (progress(length), LiveView::new(), None);
    let outcome = connect.perform_with(configuration, action, record.out.clone(), |received| {
        let (time_us, message) = (received.header.time_us, &received.message);
        if let DeviceMessage::RunStarted { start_us: at } = message {
            start_us = Some(*at);
        }
        view.observe(time_us, message);
        let run_us = start_us.map_or(0, |start| time_us.saturating_sub(start));
        bar.set_position((run_us / 1000).min(length.as_millis() as u64));
        bar.set_message(format!("{:7.1}° {:6.1} rpm", view.position_deg(), view.speed_rpm()));
        if let Some(kept) = &mut kept {
            kept.take(received.header, message);
        }
    })?;
    bar.finish_and_clear();
    let measurement = match (&record.out, kept) {
        (Some(path), _) => load_runs(path).ok().map(|(measurement, _)| measurement),
        (None, Some(kept)) => in_memory(kept),
        (None, None) => None,
    };
    // A run too short to say anything of, or cut short, still has its frames: no figures are no failure.
    let figures = measurement.and_then(|measurement| RunFigures::of(&measurement).ok().flatten());
    record.conclude(&outcome, figures.as_ref(), None)
}

fn in_memory(kept: Gathering) -> Option<Measurement> {
    to_measurement(&kept.recording(), "run", EncoderSource::Edges).ok().map(|(measurement, _)| measurement)
}
