//! A series of runs on the bench: what `twum experiment run` and `twum tune` share.

use super::configuration::ConfigurationArgs;
use super::connect::{ALL_STREAMS, ConnectArgs, own_configuration, restore};
use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use std::time::Duration;
use twum_host::link::bench::{Experiment, perform};
use twum_host::link::series::make_all;
use twum_host::link::{Port, Session};
use twum_host::record::series::{Series, SeriesRun};
use twum_shared::message::Configuration;
use twum_shared::step::ConfigSpec;

/// The board, and how the runs are made on it.
pub struct Bench<'a> {
    /// How it is reached.
    pub connect: &'a ConnectArgs,
    /// What the command line says of the runs.
    pub configuration: &'a ConfigurationArgs,
    /// What the plan says besides.
    pub limited: fn(Configuration) -> Configuration,
}

impl Bench<'_> {
    /// Makes the runs of a series, which is begun once the board has answered. How it ended is beside it: what was made is kept.
    /// Afterwards the board has its own configuration again.
    pub fn make(&self, begin: impl FnOnce() -> Result<Series>) -> Result<(Series, Result<()>)> {
        self.used(Configuration::with_control(ConfigSpec::DEFAULT))?;
        let mut session = self.connect.session()?;
        let own = own_configuration(&mut session)?;
        let motor = self.connect.motor(&mut session, Some(&self.used(own)?))?;
        let series = begin()?;
        let mut used = own;
        let result = self.perform_all(&series, &mut session, &motor, &mut used);
        restore(&mut session, own, used);
        Ok((series, result))
    }

    fn used(&self, own: Configuration) -> Result<Configuration> {
        Ok((self.limited)(self.configuration.over(own)?))
    }

    /// Makes the runs that are not made yet, on a board whose own configuration is `used` at first, and which it was given last
    /// afterwards.
    fn perform_all(
        &self,
        series: &Series,
        session: &mut Session<Box<dyn Port>>,
        motor: &str,
        used: &mut Configuration,
    ) -> Result<()> {
        let own = *used;
        let bar = ProgressBar::new(series.runs().len() as u64)
            .with_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}").expect("the template is valid"));
        let begins = |index: usize, run: &SeriesRun| {
            bar.set_position(index as u64);
            bar.set_message(run.id.clone());
        };
        make_all(series, begins, |run, action| {
            session.rest(Duration::from_secs_f64(run.pause_s))?;
            *used = Configuration { pwm_hz: run.pwm_hz.round() as u16, ..self.used(own)? };
            let experiment = Experiment {
                configuration: Some(*used),
                capture: ALL_STREAMS,
                action,
                recording: Some(series.recording(run)),
                motor: motor.to_owned(),
            };
            Ok::<_, anyhow::Error>(perform(session, &experiment, None, |_| {})?)
        })
        .map_err(|(id, error)| error.context(format!("run {id}")))?;
        bar.finish_and_clear();
        Ok(())
    }
}
