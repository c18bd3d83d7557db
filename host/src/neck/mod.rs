//! The neck manipulator: exercises, kinematics, three loops.
