//! The generator against itself: bulk equations against carrier resolution, strengths, determinism.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use twum_tests::carrier::{Carrier, CarrierState, reduced_angle};
use twum_tests::experiment::{Design, Sealed};
use twum_tests::hidden::Hidden;
use twum_tests::solver::integrate;

/// Fails if the Dormand–Prince table is mistyped: a harmonic oscillator over one period has a closed form.
#[test]
fn solver_follows_an_oscillator() {
    let (mut t, mut y, mut step) = (0.0, [1.0, 0.0], 1e-3);
    let mut f = |_: f64, y: &[f64; 2]| [y[1], -y[0]];
    integrate(&mut f, &mut t, &mut y, std::f64::consts::TAU, &mut step, &[1.0, 1.0], 1e-10);
    assert!((y[0] - 1.0).abs() < 1e-7 && y[1].abs() < 1e-7, "{y:?}");
}

/// Fails if the bulk equations (wave lag, contact table, braking) do not follow the carrier-resolution motor.
#[test]
fn bulk_equations_follow_the_carrier() {
    let carrier = Carrier::default();
    let mut state = CarrierState::default();
    carrier.run(&mut state, 10e-3, true);
    let motor = carrier.reduced(&state);
    let driven = state.y[6];
    carrier.run(&mut state, 15e-3, false);
    let stopped = state.y[6];
    let (bulk_driven, bulk_stopped) = (reduced_angle(&motor, 10e-3, 0.0), reduced_angle(&motor, 10e-3, 5e-3));
    println!(
        "driven {driven:.5} against {bulk_driven:.5} rad, after braking {stopped:.5} against {bulk_stopped:.5} rad"
    );
    assert!(
        (bulk_driven / driven - 1.0).abs() < 0.03,
        "10 ms of drive: {driven} rad at carrier resolution, {bulk_driven} in bulk"
    );
    assert!((bulk_stopped / stopped - 1.0).abs() < 0.05, "after braking: {stopped} rad, {bulk_stopped} in bulk");
}

/// Fails if the seed does not decide everything.
#[test]
fn equal_seeds_make_equal_data() {
    let design = Design { trials: 1, seconds: 0.5, ..Design::small() };
    let make = |seed| Sealed::new(design.clone(), seed).make(&[]);
    assert_eq!(make(5), make(5));
    assert_ne!(make(5).runs[0].levels, make(6).runs[0].levels);
}

/// Fails if the strength is read wrongly: a wider encoder error must read stronger, and the wanted strength be met.
#[test]
fn strengths_are_met() {
    let design = Design { trials: 1, seconds: 1.0, ..Design::small() };
    let sealed = Sealed::new(design, 3);
    let mut hidden = Hidden::draw("unequal-edges", &mut ChaCha8Rng::seed_from_u64(3));
    let weak = sealed.scale_to(&mut hidden, 0.5);
    let size = hidden.size;
    let strong = sealed.scale_to(&mut hidden, 1.0);
    assert!((weak - 0.5).abs() < 0.06 && (strong - 1.0).abs() < 0.1, "{weak} {strong}");
    assert!(hidden.size > 1.5 * size, "{} against {size}", hidden.size);
}
