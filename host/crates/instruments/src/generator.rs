//! Rigol DG1022 two-channel generator.
//!
//! It has no `*OPC?`, so each setting is read back until it holds. Amplitude and offset go out as separate, checked
//! numbers: the thesis's listing leaves out the comma between them for the second channel and so asks for 60 Vpp.

use super::scpi::{InstrumentError, Scpi};
use std::io::Write;
use std::time::Duration;

/// How long a setting may take to show when read back.
const SETTING: Duration = Duration::from_secs(3);
/// Largest amplitude of the second channel into an open end (Vpp); the first reaches 20.
pub const LARGEST_VPP: f64 = 6.0;

/// Which outputs a sweep uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phases {
    /// Channel 1 alone.
    One,
    /// Channel 2 a quarter period ahead, as a travelling wave needs it.
    Two,
}

/// A generator whose outputs go off when it is dropped.
#[derive(Debug)]
pub struct Generator {
    scpi: Scpi,
    phases: Phases,
    off: bool,
}

impl Generator {
    /// Takes over a generator and switches its outputs off.
    ///
    /// # Errors
    /// When it is no DG1022 or does not answer.
    pub fn new(mut scpi: Scpi, phases: Phases) -> Result<Self, InstrumentError> {
        let identity = scpi.query("*IDN?")?;
        if !identity.to_ascii_uppercase().contains("DG10") {
            return Err(scpi.unexpected("*IDN?", &identity, "expected a Rigol DG1022"));
        }
        let mut generator = Self { scpi, phases, off: false };
        generator.off()?;
        Ok(generator)
    }

    /// Sets a sine of `vpp` (V, peak to peak) without offset at `frequency_hz` on the outputs used, still off.
    ///
    /// # Errors
    /// When a setting read back is not what was asked for.
    pub fn prepare(&mut self, frequency_hz: f64, vpp: f64) -> Result<(), InstrumentError> {
        for channel in self.channels() {
            self.scpi.send(&format!("VOLT:UNIT{channel} VPP"))?;
            self.scpi.send(&format!("APPL:SIN{channel} {frequency_hz},{vpp},0"))?;
        }
        if self.phases == Phases::Two {
            self.scpi.send("PHAS:CH2 90")?;
        }
        for channel in self.channels() {
            self.confirm(&format!("VOLT{channel}?"), vpp, 0.01)?;
            self.confirm(&format!("FREQ{channel}?"), frequency_hz, 1e-6)?;
        }
        Ok(())
    }

    /// Switches the outputs on, their phases aligned.
    ///
    /// # Errors
    /// When one does not report itself on.
    pub fn on(&mut self) -> Result<(), InstrumentError> {
        self.off = false;
        for channel in self.channels() {
            self.scpi.send(&format!("OUTP{channel} ON"))?;
            self.scpi.wait(&format!("OUTP{channel}?"), SETTING, "the output did not switch on", is_on)?;
        }
        self.align()
    }

    /// Moves to another frequency, the outputs on.
    ///
    /// # Errors
    /// When the frequency read back is not the one asked for.
    pub fn tune(&mut self, frequency_hz: f64) -> Result<(), InstrumentError> {
        for channel in self.channels() {
            self.scpi.send(&format!("FREQ{channel} {frequency_hz}"))?;
        }
        for channel in self.channels() {
            self.confirm(&format!("FREQ{channel}?"), frequency_hz, 1e-6)?;
        }
        self.align()
    }

    /// Switches both outputs off and makes sure of it; a broken line is opened once more for that.
    ///
    /// # Errors
    /// When an output does not report itself off.
    pub fn off(&mut self) -> Result<(), InstrumentError> {
        let first = self.try_off();
        if first.is_err() {
            self.scpi.reopen()?;
            self.try_off()?;
        }
        self.off = true;
        Ok(())
    }

    fn try_off(&mut self) -> Result<(), InstrumentError> {
        // Both are told before either is asked: a refused answer must not keep the other on.
        self.scpi.send("OUTP OFF")?;
        self.scpi.send("OUTP:CH2 OFF")?;
        for query in ["OUTP?", "OUTP:CH2?"] {
            self.scpi.wait(query, SETTING, "the output does not switch off: switch it off by hand", is_off)?;
        }
        Ok(())
    }

    fn align(&mut self) -> Result<(), InstrumentError> {
        if self.phases == Phases::Two { self.scpi.send("PHAS:ALIGN") } else { Ok(()) }
    }

    fn channels(&self) -> Vec<&'static str> {
        match self.phases {
            Phases::One => vec![""],
            Phases::Two => vec!["", ":CH2"],
        }
    }

    fn confirm(&mut self, query: &str, value: f64, relative: f64) -> Result<(), InstrumentError> {
        let close = |answer: &str| {
            answer
                .rsplit([':', ' '])
                .next()
                .and_then(|v| v.parse::<f64>().ok())
                .is_some_and(|v| (v - value).abs() <= relative * value.abs())
        };
        self.scpi.wait(query, SETTING, &format!("expected {value}: the generator did not take the setting"), close)?;
        Ok(())
    }
}

fn is_on(answer: &str) -> bool {
    let answer = answer.to_ascii_uppercase();
    answer.ends_with("ON") || answer.ends_with('1')
}

/// Whether an answer says that an output is off, and nothing else: a mere echo or noise switches nothing off.
fn is_off(answer: &str) -> bool {
    let value = answer.rsplit([':', ' ']).next().unwrap_or_default();
    value.eq_ignore_ascii_case("OFF") || value == "0"
}

impl Drop for Generator {
    fn drop(&mut self) {
        if !self.off
            && let Err(error) = self.off()
        {
            // A message that nobody can read must not end the program in the middle of its end.
            let _ = writeln!(
                std::io::stderr(),
                "warning: the generator's outputs could not be confirmed off ({error}): switch them off by hand"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_off_or_0_is_believed_to_be_off() {
        for (answer, off) in [
            ("OFF", true),
            ("off", true),
            ("0", true),
            ("CH2:OFF", true),
            ("OUTP 0", true),
            ("ON", false),
            ("1", false),
            ("", false),
            ("OUTP?", false),
            ("RIGOL TECHNOLOGIES,DG1022", false),
            ("0.000000e+00", false),
            ("-113,\"Undefined header\"", false),
        ] {
            assert_eq!(is_off(answer), off, "{answer:?}");
        }
    }
}
