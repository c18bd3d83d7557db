//! Bench instruments over SCPI, the frequency sweep of a stator, and a simulated bench to try both on.
//!
//! Equipment and wiring are the thesis's (sections A.1.1 and B.1): a two-channel generator drives the stator's phases, a
//! shunt carries the current of the first, an oscilloscope sees both ends of the shunt.
//!
//! ```
//! use std::sync::atomic::AtomicBool;
//! use twum_identify::circuit::{Circuit, Mode};
//! use twum_instruments::generator::{Generator, Phases};
//! use twum_instruments::oscilloscope::{Family, Oscilloscope};
//! use twum_instruments::scpi::Scpi;
//! use twum_instruments::simulate::{Bench, Setup};
//! use twum_instruments::sweep::{Plan, run};
//!
//! let circuit = Circuit::single(150e-12, 2e6, Mode::from_elements(2.1094, 6.1653e-12, 18_488.0));
//! let bench =
//!     Bench::start(Setup { circuit, shunt_ohm: 2000.0, noise_v: 0.01, family: Family::Ds1104z, seed: 3, ports: (0, 0) })?;
//! let generator = Generator::new(Scpi::open(&bench.generator.to_string())?, Phases::Two)?;
//! let mut scope = Oscilloscope::new(Scpi::open(&bench.scope.to_string())?)?;
//! let plan = Plan { from_hz: 44_000.0, to_hz: 44_200.0, step_hz: 100.0, ..Plan::default() };
//! let folder = tempfile::tempdir()?;
//! assert_eq!(run(&plan, &folder.path().join("sweep.csv"), generator, &mut scope, &AtomicBool::new(false), |_, _| ())?, 3);
//! assert!(bench.outputs().iter().all(|output| !output.on), "off when it is done");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod generator;
pub mod oscilloscope;
pub mod scpi;
pub mod simulate;
pub mod sweep;
