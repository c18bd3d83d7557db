//! The motor: parameters, carrier and averaged models, effects.
