//! Touchstone files of one port, versions 1 and 2.

use super::{Point, ReadError, Sweep, file, line, positive, text};
use nalgebra::Complex;
use std::path::Path;

/// What the option line says of the numbers.
struct Format {
    /// Hz in the unit of the frequencies.
    unit_hz: f64,
    /// Scattering parameter, admittance or impedance.
    kind: char,
    /// Real and imaginary part, magnitude and angle, or dB and angle.
    form: String,
    /// Reference resistance (ohm).
    reference_ohm: f64,
}

impl Default for Format {
    /// What holds without an option line.
    fn default() -> Self {
        Self { unit_hz: 1e9, kind: 'S', form: "MA".to_owned(), reference_ohm: 50.0 }
    }
}

impl Format {
    /// Reads the option line, after its `#`.
    fn parse(option: &str) -> Result<Self, String> {
        let mut format = Self::default();
        let mut words = option.split_whitespace();
        while let Some(word) = words.next() {
            match word.to_ascii_uppercase().as_str() {
                "HZ" => format.unit_hz = 1.0,
                "KHZ" => format.unit_hz = 1e3,
                "MHZ" => format.unit_hz = 1e6,
                "GHZ" => format.unit_hz = 1e9,
                w @ ("S" | "Y" | "Z") => format.kind = w.chars().next().unwrap_or('S'),
                w @ ("RI" | "MA" | "DB") => format.form = w.to_owned(),
                "R" => {
                    let value = words.next().and_then(|r| r.parse::<f64>().ok()).filter(|r| *r > 0.0);
                    format.reference_ohm = value.ok_or("`R` needs a positive reference resistance in ohm")?;
                }
                other => return Err(format!("unknown Touchstone option `{other}`")),
            }
        }
        Ok(format)
    }

    /// The admittance (S) that two numbers stand for. Version 1 gives Y and Z relative to the reference resistance.
    fn admittance(&self, a: f64, b: f64, version_two: bool) -> Complex<f64> {
        let value = match self.form.as_str() {
            "RI" => Complex::new(a, b),
            "DB" => Complex::from_polar(10f64.powf(a / 20.0), b.to_radians()),
            _ => Complex::from_polar(a, b.to_radians()),
        };
        let normal = if version_two { 1.0 } else { self.reference_ohm };
        match self.kind {
            'S' => (Complex::new(1.0, 0.0) - value) / (value + 1.0) / self.reference_ohm,
            'Y' => value / normal,
            _ => Complex::new(1.0, 0.0) / (value * normal),
        }
    }
}

/// The numbers of a line.
fn cells(content: &str) -> Result<[f64; 3], String> {
    let number = |c: &str| {
        c.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(|| format!("`{c}` is not a finite number"))
    };
    let cells: Vec<f64> = content.split_whitespace().map(number).collect::<Result<_, _>>()?;
    <[f64; 3]>::try_from(cells).map_err(|cells| format!("{} numbers; a one-port has three a line", cells.len()))
}

/// Reads a sweep.
pub(super) fn read(path: &Path) -> Result<Sweep, ReadError> {
    let text = text(path)?;
    let (mut format, mut version_two) = (None, false);
    let mut points = Vec::new();
    for (index, raw) in text.lines().enumerate() {
        let number = index + 1;
        let wrong = |message: String| line(path, number, message);
        let content = raw.split('!').next().unwrap_or_default().trim();
        if content.is_empty() {
            continue;
        }
        if content.starts_with('[') {
            let keyword = content.to_ascii_lowercase();
            version_two |= keyword.starts_with("[version]");
            if keyword.starts_with("[number of ports]") && !keyword.ends_with(" 1") {
                return Err(wrong("a stator is a one-port: [Number of Ports] must be 1".to_owned()));
            }
            if keyword.starts_with("[end]") {
                break;
            }
            continue;
        }
        if let Some(option) = content.strip_prefix('#') {
            // Only the first counts.
            if format.is_none() {
                format = Some(Format::parse(option).map_err(wrong)?);
            }
            continue;
        }
        let [f, a, b] = cells(content).map_err(wrong)?;
        let format = format.get_or_insert_default();
        let y = format.admittance(a, b, version_two);
        if !(y.re.is_finite() && y.im.is_finite()) || y.norm() == 0.0 {
            return Err(wrong("the admittance here is zero or infinite: an open or a short was measured".to_owned()));
        }
        let frequency_hz = positive(path, number, f * format.unit_hz)?;
        points.push(Point { frequency_hz, admittance_s: y, sigma_s: None });
    }
    if points.is_empty() {
        return Err(file(path, "holds no data"));
    }
    Ok(Sweep { source: path.display().to_string(), points, waveforms: Vec::new(), shunt_ohm: None })
}
