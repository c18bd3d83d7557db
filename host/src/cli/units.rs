//! Quantities as people write them: `90deg`, `0.25turn` or counts; `50%` or `0.5`; `30rpm`, `180deg/s` or counts/s.

use anyhow::{Context, Result, bail};
use twum_shared::reference::Reference;

fn number(text: &str, unit: &str, kinds: &str) -> Result<f64> {
    let word = text.strip_suffix(unit).unwrap_or(text).trim();
    word.parse().with_context(|| format!("`{text}` is not {kinds}"))
}

/// The value of a text in the first unit that it ends in, times that unit's factor; without a unit as it is.
fn scaled(text: &str, units: &[(&str, f64)], kinds: &str) -> Result<f64> {
    let text = text.trim();
    for (unit, factor) in units {
        if text.ends_with(unit) {
            return Ok(number(text, unit, kinds)? * factor);
        }
    }
    number(text, "", kinds)
}

fn finite(text: &str, value: f64) -> Result<f64> {
    if !value.is_finite() {
        bail!("`{text}` is not finite");
    }
    Ok(value)
}

/// An angle, in counts.
pub fn counts(text: &str, edges_per_rev: u16) -> Result<f64> {
    let turn = f64::from(edges_per_rev);
    let units = [("turn", turn), ("deg", turn / 360.0), ("\u{b0}", turn / 360.0), ("counts", 1.0)];
    finite(text, scaled(text, &units, "an angle: counts, or such as 90deg or 0.25turn")?)
}

/// An angular speed, in counts/s.
pub fn counts_s(text: &str, edges_per_rev: u16) -> Result<f64> {
    let turn = f64::from(edges_per_rev);
    let units = [("rpm", turn / 60.0), ("deg/s", turn / 360.0), ("\u{b0}/s", turn / 360.0), ("counts/s", 1.0)];
    finite(text, scaled(text, &units, "a speed: counts/s, or such as 30rpm or 180deg/s")?)
}

/// A quantity in whole counts.
pub fn whole(value: Result<f64>) -> Result<i32> {
    let value = value?.round();
    if value.abs() > f64::from(i32::MAX) {
        bail!("{value} counts are more than the board can count");
    }
    Ok(value as i32)
}

/// An amount in whole counts, which has no sign.
pub fn amount(value: Result<f64>) -> Result<u32> {
    let value = value?.round();
    if !(0.0..=f64::from(u32::MAX)).contains(&value) {
        bail!("{value} counts: an amount is neither negative nor beyond what the board can count");
    }
    Ok(value as u32)
}

/// A sine to follow, of an amplitude in counts and an angular frequency in rad/s.
pub fn sine(amplitude: i32, omega_rad_s: f64) -> Result<Reference> {
    let omega_urad_s = (omega_rad_s * 1e6).round();
    if !(0.0..=f64::from(u32::MAX)).contains(&omega_urad_s) {
        bail!("{omega_rad_s} rad/s: an angular frequency is neither negative nor beyond 100 rad/s");
    }
    let reference = Reference::Sine { amplitude, omega_urad_s: omega_urad_s as u32 };
    reference.validate()?;
    Ok(reference)
}

/// A duty, as a fraction.
pub fn duty(text: &str) -> Result<f64> {
    let value = scaled(text, &[("%", 0.01)], "a duty: a fraction such as 0.5, or 50%")?;
    if !(0.0..=1.0).contains(&value) {
        bail!("duty {text} is outside 0 to 1: it is the fraction of the PWM period with the drive on");
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_and_none_are_read() {
        for (text, expected) in
            [("100", 100.0), ("90deg", 100.0), ("-0.25turn", -100.0), ("9 deg", 10.0), ("7counts", 7.0)]
        {
            assert!((counts(text, 400).unwrap() - expected).abs() < 1e-9, "{text}");
        }
        for (text, expected) in [("210", 210.0), ("30rpm", 200.0), ("180deg/s", 200.0), ("-3 counts/s", -3.0)] {
            assert!((counts_s(text, 400).unwrap() - expected).abs() < 1e-9, "{text}");
        }
        assert_eq!((duty("50%").unwrap(), duty("0.5").unwrap()), (0.5, 0.5));
        for wrong in ["", "deg", "1e999", "ten", "nan"] {
            assert!(counts(wrong, 400).is_err() && duty(wrong).is_err(), "{wrong}");
        }
        assert!(duty("150%").is_err() && duty("-0.1").is_err());
    }
}
