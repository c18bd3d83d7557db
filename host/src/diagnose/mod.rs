//! What the simulation gets wrong, and why.
