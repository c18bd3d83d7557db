//! The motor: parameters, carrier and averaged models, effects.

pub mod actuator;
pub mod averaged;
pub mod carrier;
pub mod contact;
pub mod effects;
mod half_contact_table;
pub mod inertial;
pub mod modulation;
pub mod motor;
pub mod motor_plant;
pub mod parameters;
pub mod plant;
pub mod sensor;
pub mod simulate;
mod anchor_tmp;
