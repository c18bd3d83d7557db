//! The motor: parameters, carrier and averaged models, effects.
//!
//! ```
//! use twum_motor::effects::EffectSet;
//! use twum_motor::motor::Motor;
//! use twum_motor::motor_plant::{History, Solver};
//! use twum_motor::parameters::Flavour;
//! use twum_motor::plant::Direction;
//! use twum_motor::simulate::{PlantModel, Program, simulate};
//!
//! let motor = Motor::load("pcbmotor-30mm")?;
//! let parameters = motor.parameters(Flavour::Physical).assign(&["eta=0.08"])?;
//! let mut effects = EffectSet::default();
//! effects.set("dead-zone", &[0.05])?;
//! let model = PlantModel::Motor { parameters, flavour: Flavour::Physical, solver: Solver::Averaged };
//! let trace = simulate(&Program::constant(0.5, Direction::Cw, 0.5, 0.6), &model, &effects, History::default());
//! assert!(trace.edges.len() > 10, "it turns: {} edges", trace.edges.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! From the bottom up: [`motor`] reads motor files into [`parameters`]; [`carrier`] and [`averaged`] integrate them;
//! [`plant`] is the seam behind which [`motor_plant`] (either model, with the [`effects`] that live in a motor) and
//! [`inertial`] (an ordinary motor) look alike; [`actuator`] is the PWM in front of a plant, [`sensor`] the encoder behind
//! it, and [`simulate`] the three together; [`closed_loop`] puts the control step round them, [`tracking`] says how well it followed, and [`guidance`]
//! how well it felt a hand;
//! [`robust`] asks that of motors that differ, [`uncertainty`] draws those a motor file leaves possible. `docs/model.md` has the equations, what was corrected, and how far the models are apart.

pub mod actuator;
mod arccosine;
pub mod averaged;
mod blend;
pub mod braking;
pub mod carrier;
pub mod check;
pub mod closed_loop;
pub mod contact;
mod effect_info;
pub mod effects;
pub mod formula_file;
pub mod guidance;
mod half_contact_table;
pub mod hypothesis;
pub mod inertial;
mod lanes;
pub mod modulation;
mod momentary;
pub mod motor;
pub mod motor_plant;
pub mod parameters;
pub mod plant;
pub mod reader;
pub mod robust;
pub mod sensor;
pub mod simulate;
mod stretches;
pub mod study;
pub mod tracking;
pub mod uncertainty;

#[cfg(test)]
mod tests;
