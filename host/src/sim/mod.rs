//! The simulated board: virtual clock, driver board, motor.
