//! Parameters from measurements: stator circuit, friction, force factor.
//!
//! ```
//! use twum_identify::circuit::{Circuit, Mode};
//! use twum_identify::stator::{Options, identify, synthetic};
//!
//! // A stator that resonates at 44 kHz, swept around it.
//! let stator = Circuit::single(6.0e-9, 5.0e6, Mode::from_elements(2.11, 6.2e-12, 18_500.0));
//! let sweep = synthetic(&stator, (0..400).map(|i| 42_500.0 + 8.0 * f64::from(i)));
//! let found = identify(&sweep, &Options::default()).expect("a sweep of 400 points");
//! let (is, was) = (found.report.fs_hz.expect("a resonance"), stator.modes[0].fs_hz);
//! assert!((is - was).abs() < 1.0, "{is} for {was}");
//! ```

pub mod circuit;
pub mod fit;
pub mod follow;
pub mod force_factor;
pub mod friction;
pub mod modes;
pub mod read;
pub mod save;
pub mod sine;
pub mod stator;
pub mod sweep;
pub mod thesis;
