//! Rigol DS1052E and DS1000Z (DS1104Z) oscilloscopes: settings, single acquisitions, screen records in volts.

use super::scpi::{InstrumentError, Scpi};
use std::time::Duration;

/// How long an acquisition or a setting may take.
const ACQUISITION: Duration = Duration::from_secs(5);

/// Which command set it speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Family {
    /// DS1052E: 600 points, scaled by division.
    Ds1052e,
    /// DS1104Z and its family: 1200 points, scaled by a preamble.
    Ds1104z,
}

/// A record of one channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Sample times (s), zero at the trigger.
    pub time_s: Vec<f64>,
    /// Voltages (V).
    pub volt: Vec<f64>,
    /// Whether the converter ran into an end of its range.
    pub clipped: bool,
    /// Largest swing over the converter's range, 0 to 1.
    pub used: f64,
}

/// An oscilloscope with channel 1 before the shunt and channel 2 behind it.
#[derive(Debug)]
pub struct Oscilloscope {
    scpi: Scpi,
    family: Family,
    volt_a_division: [f64; 2],
}

impl Oscilloscope {
    /// Takes over an oscilloscope.
    ///
    /// # Errors
    /// When it is of neither family or does not answer.
    pub fn new(mut scpi: Scpi) -> Result<Self, InstrumentError> {
        let identity = scpi.query("*IDN?")?;
        let upper = identity.to_ascii_uppercase();
        let model = upper.split(',').nth(1).unwrap_or_default().trim().to_owned();
        let family = if model.starts_with("DS1") && model.ends_with('E') {
            Family::Ds1052e
        } else if (model.starts_with("DS1") || model.starts_with("MSO1")) && model.contains('Z') {
            Family::Ds1104z
        } else {
            return Err(scpi.unexpected("*IDN?", &identity, "expected a Rigol DS1052E or DS1000Z"));
        };
        Ok(Self { scpi, family, volt_a_division: [1.0; 2] })
    }

    /// Its command set.
    pub fn family(&self) -> Family {
        self.family
    }

    /// Sets both channels for a sine of `vpp` (V, peak to peak) and the screen for at least five periods of the lowest
    /// frequency, triggered by channel 1 rising through zero.
    ///
    /// # Errors
    /// When a setting does not hold.
    pub fn prepare(&mut self, lowest_hz: f64, vpp: f64) -> Result<(), InstrumentError> {
        let second_a_division = round_up(5.0 / lowest_hz / 12.0);
        self.scpi.send(&format!(":TIM:SCAL {second_a_division}"))?;
        self.scpi.send(":TIM:OFFS 0")?;
        for channel in 0..2 {
            let n = channel + 1;
            self.scpi.send(&format!(":CHAN{n}:DISP ON"))?;
            self.scpi.send(&format!(":CHAN{n}:COUP DC"))?;
            self.scale(channel, round_up(vpp / 7.0))?;
        }
        self.scpi.send(":TRIG:MODE EDGE")?;
        self.scpi.send(":TRIG:EDGE:SOUR CHAN1")?;
        self.scpi.send(":TRIG:EDGE:SLOP POS")?;
        self.scpi.send(":TRIG:EDGE:LEV 0")?;
        self.settled()?;
        let back = self.scpi.number(":TIM:SCAL?")?;
        if (back / second_a_division - 1.0).abs() > 0.01 {
            return Err(self.scpi.unexpected(
                ":TIM:SCAL?",
                &back.to_string(),
                format!("expected {second_a_division} s a division"),
            ));
        }
        Ok(())
    }

    fn scale(&mut self, channel: usize, volt_a_division: f64) -> Result<(), InstrumentError> {
        let n = channel + 1;
        self.scpi.send(&format!(":CHAN{n}:SCAL {volt_a_division}"))?;
        self.scpi.send(&format!(":CHAN{n}:OFFS 0"))?;
        // What it took, not what was asked for: the record is scaled by it.
        self.volt_a_division[channel] = self.scpi.number(&format!(":CHAN{n}:SCAL?"))?;
        Ok(())
    }

    fn settled(&mut self) -> Result<(), InstrumentError> {
        // The DS1052E has no *OPC?; its queries are answered in order, which serves.
        if self.family == Family::Ds1104z {
            self.scpi.wait("*OPC?", ACQUISITION, "the settings did not complete", |a| a.ends_with('1'))?;
        }
        Ok(())
    }

    /// One triggered acquisition of both channels; a channel that clips or uses under a third of its range is rescaled and
    /// taken again, at most four times.
    ///
    /// # Errors
    /// When no trigger comes, or a record is not what the settings say.
    pub fn acquire(&mut self) -> Result<[Record; 2], InstrumentError> {
        let mut last = None;
        for _ in 0..5 {
            self.single()?;
            let records = [self.read(0)?, self.read(1)?];
            let mut good = true;
            for (channel, record) in records.iter().enumerate() {
                let division = self.volt_a_division[channel];
                let wanted =
                    if record.clipped { round_up(division * 1.8) } else { round_up(division * record.used / 0.85) };
                if (record.clipped || record.used < 0.33) && (0.002..=10.0).contains(&wanted) && wanted != division {
                    self.scale(channel, wanted)?;
                    self.settled()?;
                    good = false;
                }
            }
            let done = good || records.iter().all(|r| !r.clipped && r.used > 0.9);
            last = Some(records);
            if done {
                break;
            }
        }
        // The loop runs at least once.
        last.filter(|records| records.iter().all(|r| !r.clipped)).ok_or_else(|| {
            self.scpi.unexpected(
                ":WAV:DATA?",
                "clipped record",
                "a channel clips at every scale: check probes and offset",
            )
        })
    }

    fn single(&mut self) -> Result<(), InstrumentError> {
        match self.family {
            Family::Ds1104z => self.scpi.send(":SING")?,
            Family::Ds1052e => {
                self.scpi.send(":TRIG:EDGE:SWE SING")?;
                self.scpi.send(":RUN")?;
            }
        }
        let expected = "no trigger: is the generator's output on, and channel 1 connected before the shunt?";
        self.scpi.wait(":TRIG:STAT?", ACQUISITION, expected, |a| a.to_ascii_uppercase().starts_with("STOP"))?;
        Ok(())
    }

    fn read(&mut self, channel: usize) -> Result<Record, InstrumentError> {
        match self.family {
            Family::Ds1052e => self.read_by_division(channel),
            Family::Ds1104z => self.read_by_preamble(channel),
        }
    }

    /// DS1052E: the screen spans 25 counts a division downwards from 240 at 4.6 divisions over the offset, 50 points a
    /// division in time. Scale and offset are each channel's own.
    fn read_by_division(&mut self, channel: usize) -> Result<Record, InstrumentError> {
        let n = channel + 1;
        let volt = self.scpi.number(&format!(":CHAN{n}:SCAL?"))?;
        let offset = self.scpi.number(&format!(":CHAN{n}:OFFS?"))?;
        let second = self.scpi.number(":TIM:SCAL?")?;
        let delay = self.scpi.number(":TIM:OFFS?")?;
        let raw = self.scpi.block(&format!(":WAV:DATA? CHAN{n}"))?;
        let value = |r: u8| (240.0 - f64::from(r)) * volt / 25.0 - (offset + 4.6 * volt);
        // The screen shows eight divisions: 200 counts about the one of zero volts.
        self.record(&raw, value, 125.0, 100.0, |i| i as f64 * second / 50.0 - (6.0 * second - delay))
    }

    /// DS1000Z: scaled by the preamble of the channel itself.
    fn read_by_preamble(&mut self, channel: usize) -> Result<Record, InstrumentError> {
        let n = channel + 1;
        for command in [format!(":WAV:SOUR CHAN{n}"), ":WAV:MODE NORM".to_owned(), ":WAV:FORM BYTE".to_owned()] {
            self.scpi.send(&command)?;
        }
        let preamble = self.scpi.query(":WAV:PRE?")?;
        let fields: Vec<f64> = preamble.split(',').filter_map(|f| f.trim().parse().ok()).collect();
        let [_, _, points, _, dt, t0, _, dv, origin, reference] = fields[..] else {
            return Err(self.scpi.unexpected(":WAV:PRE?", &preamble, "expected ten numbers"));
        };
        let raw = self.scpi.block(":WAV:DATA?")?;
        if raw.len() as f64 != points {
            let answer = format!("{} bytes", raw.len());
            return Err(self.scpi.unexpected(":WAV:DATA?", &answer, format!("the preamble says {points} points")));
        }
        let value = |r: u8| (f64::from(r) - origin - reference) * dv;
        self.record(&raw, value, 127.0, 100.0, |i| i as f64 * dt + t0)
    }

    fn record(
        &self,
        raw: &[u8],
        value: impl Fn(u8) -> f64,
        middle: f64,
        half: f64,
        time: impl Fn(usize) -> f64,
    ) -> Result<Record, InstrumentError> {
        if raw.len() < 16 {
            let answer = format!("{} bytes", raw.len());
            return Err(self.scpi.unexpected(":WAV:DATA?", &answer, "expected a screen of points"));
        }
        let largest = raw.iter().map(|r| (f64::from(*r) - middle).abs()).fold(0.0, f64::max);
        Ok(Record {
            time_s: (0..raw.len()).map(time).collect(),
            volt: raw.iter().map(|r| value(*r)).collect(),
            clipped: largest >= half,
            used: largest / half,
        })
    }
}

/// The next 1-2-5 step at or above a value.
fn round_up(value: f64) -> f64 {
    let decade = 10f64.powf(value.log10().floor());
    // A value a hair above a step is that step.
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|s| s * decade).find(|s| *s >= value * (1.0 - 1e-9)).unwrap_or(10.0 * decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_one_two_five() {
        for (value, expected) in [(0.857, 1.0), (1.0, 1.0), (1.01, 2.0), (0.023, 0.05), (13.9e-6, 20e-6)] {
            assert!((round_up(value) / expected - 1.0).abs() < 1e-12, "{value}");
        }
    }
}
