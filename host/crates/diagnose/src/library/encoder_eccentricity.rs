//! `encoder-eccentricity`.

use super::{Coordinate, Effect, Need, phased};
use crate::library::Phased;

pub(super) fn effect() -> Effect {
    let up_to = |n: usize| phased((0..n).map(Phased::Eccentricity).collect());
    Effect {
        name: "encoder-eccentricity".into(),
        says: "the encoder wheel is not centred: its angle errs once a turn, the same at every duty".into(),
        equation: "θ_measured = θ + Σ e_k·sin(kθ − φ_k)".into(),
        coordinate: Coordinate::Angle,
        needs: &[Need::ThirdOfATurn, Need::Edges],
        forms: vec![up_to(1), up_to(2), up_to(3), up_to(4)],
        reported: Vec::new(),
        conflicts: &["preload-runout"],
        next_experiment: "re-seat the rotor by 90° against the encoder wheel and repeat one run: runout turns with the rotor, eccentricity stays with the wheel",
    }
}
