//! Admittance over frequency: what every identification of a stator starts from.

use nalgebra::Complex;

/// One frequency of a sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Frequency (Hz).
    pub frequency_hz: f64,
    /// Admittance (S).
    pub admittance_s: Complex<f64>,
    /// Standard deviation of each of its components (S), where the measurement tells.
    pub sigma_s: Option<f64>,
}

/// Two-channel waveforms at one frequency, as an oscilloscope gives them.
#[derive(Debug, Clone, PartialEq)]
pub struct Waveform {
    /// Generator frequency (Hz).
    pub frequency_hz: f64,
    /// Sample times (s).
    pub time_s: Vec<f64>,
    /// Generator side of the shunt (V).
    pub v1: Vec<f64>,
    /// Stator side of the shunt (V).
    pub v2: Vec<f64>,
}

/// A frequency sweep, sorted by frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    /// Where it came from, for messages and provenance.
    pub source: String,
    /// Points by rising frequency.
    pub points: Vec<Point>,
    /// The waveforms the points were computed from, by the same order; empty when the file held spectra.
    pub waveforms: Vec<Waveform>,
    /// Shunt resistance the waveforms were measured over (Ω).
    pub shunt_ohm: Option<f64>,
}

impl Sweep {
    /// Frequencies (Hz).
    pub fn frequencies(&self) -> Vec<f64> {
        self.points.iter().map(|p| p.frequency_hz).collect()
    }

    /// Admittances (S).
    pub fn admittances(&self) -> Vec<Complex<f64>> {
        self.points.iter().map(|p| p.admittance_s).collect()
    }

    /// Lowest and highest frequency (Hz).
    pub fn range_hz(&self) -> (f64, f64) {
        (self.points[0].frequency_hz, self.points[self.points.len() - 1].frequency_hz)
    }
}
