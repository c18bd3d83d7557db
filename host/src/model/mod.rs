//! The motor: parameters, carrier and averaged models, effects.
//!
//! ```no_run
//! use twum_host::model::effects::EffectSet;
//! use twum_host::model::motor::Motor;
//! use twum_host::model::motor_plant::{History, Solver};
//! use twum_host::model::parameters::Flavour;
//! use twum_host::model::plant::Direction;
//! use twum_host::model::simulate::{PlantModel, Program, simulate};
//!
//! let motor = Motor::load("pcbmotor-30mm")?;
//! let parameters = motor.parameters(Flavour::Physical).assign(&["eta=0.08"])?;
//! let mut effects = EffectSet::default();
//! effects.set("dead-zone", &[0.05])?;
//! let model = PlantModel::Motor { parameters, flavour: Flavour::Physical, solver: Solver::Averaged };
//! let trace = simulate(&Program::constant(0.5, Direction::Cw, 5.0, 5.2), &model, &effects, History::default());
//! println!("{} edges", trace.edges.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! From the bottom up: [`motor`] reads motor files into [`parameters`]; [`carrier`] and [`averaged`] integrate them;
//! [`plant`] is the seam behind which [`motor_plant`] (either model, with the [`effects`] that live in a motor) and
//! [`inertial`] (an ordinary motor) look alike; [`actuator`] is the PWM in front of a plant, [`sensor`] the encoder behind
//! it, and [`simulate`] the three together. `docs/model.md` has the equations, what was corrected, and how far the models are apart.

pub mod actuator;
mod arccosine;
pub mod averaged;
mod blend;
pub mod braking;
pub mod carrier;
pub mod check;
pub mod closed_loop;
pub mod contact;
pub mod effects;
mod half_contact_table;
pub mod inertial;
mod lanes;
pub mod modulation;
pub mod motor;
pub mod motor_plant;
pub mod parameters;
pub mod plant;
pub mod sensor;
pub mod simulate;
mod stretches;
pub mod study;

#[cfg(test)]
mod tests;
