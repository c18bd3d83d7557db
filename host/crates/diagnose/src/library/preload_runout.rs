//! `preload-runout`.

use super::{Coordinate, Effect, Form, Need, phased};
use crate::library::Phased;
use crate::rotor::P;

pub(super) fn effect() -> Effect {
    let turns = |harmonics: &[usize]| phased(harmonics.iter().map(|h| Phased::Runout(*h)).collect());
    let acting = |form: Form, speed: f64, torque: f64, brake: f64| {
        form.pinned(P::RunoutSpeed, speed).pinned(P::RunoutTorque, torque).pinned(P::RunoutBrake, brake)
    };
    let harmonics: [&[usize]; 4] = [&[0], &[1], &[0, 1], &[0, 1, 2, 3]];
    // What presses more rubs more, with a wave and without one.
    let on_all = harmonics.into_iter().map(|h| acting(turns(h), 1.0, 1.0, 1.0));
    let on_speed = harmonics.into_iter().map(|h| acting(turns(h), 1.0, 0.0, 0.0));
    let on_torque = harmonics[..3].iter().map(|h| acting(turns(h), 0.0, 1.0, 0.0));
    let on_friction = harmonics[..3].iter().map(|h| acting(turns(h), 0.0, 1.0, 1.0));
    Effect {
        name: "preload-runout".into(),
        says: "the drive changes with the rotor's angle: the preload is not the same all round".into(),
        equation: "drive·(1 + Σ a_k·cos(kθ − φ_k)), on the wave's speed, its torque or the friction".into(),
        coordinate: Coordinate::Angle,
        needs: &[Need::ThirdOfATurn],
        forms: on_all.chain(on_speed).chain(on_torque).chain(on_friction).collect(),
        reported: Vec::new(),
        conflicts: &["encoder-eccentricity"],
        next_experiment: "re-seat the rotor by 90° against the encoder wheel and repeat one run: runout turns with the rotor, eccentricity stays with the wheel",
    }
}
