//! No sound encoder is taken for one that fails: every flavour of the motor, without and with each effect that a simulated board can
//! have, under every drive.

use crate::bench::Bench;
use crate::drives::{Run, runs};
use rayon::prelude::*;
use std::fmt::Write;
use twum_host::link::LinkError;
use twum_host::model::effects::{EffectSet, catalogue};
use twum_host::model::motor::Motor;
use twum_host::model::parameters::Flavour;
use twum_host::sim::Setup;
use twum_shared::Fault;
use twum_shared::message::Mode;
use twum_shared::safety::Limits;

/// A motor of which a person may say that it is sound.
struct Sound {
    flavour: Flavour,
    effects: EffectSet,
    name: &'static str,
}

impl Sound {
    /// Its board, aligned; none where no edge can be confirmed by a microstep back, such as behind a gap.
    fn bench(&self) -> Option<Bench> {
        let setup = Setup::hybrid(&Motor::pcbmotor_30mm(), self.flavour, &self.effects).expect("an effect on a board");
        let mut bench = Bench::new(setup);
        match bench.session.align() {
            Err(LinkError::Fault(Fault::AlignFailed)) => None,
            aligned => aligned.map(|()| Some(bench)).expect("alignment"),
        }
    }
}

/// Each flavour, without and with each effect at its typical size.
fn motors() -> Vec<Sound> {
    let with = |flavour: Flavour| {
        let alone = Sound { flavour, effects: EffectSet::default(), name: "no effect" };
        let each = catalogue().iter().filter_map(move |info| {
            let mut effects = EffectSet::default();
            let typical: Vec<f64> = info.parameters.iter().map(|parameter| parameter.typical).collect();
            effects.set(info.name, &typical).expect("a typical size is within its bounds");
            let possible = Setup::hybrid(&Motor::pcbmotor_30mm(), flavour, &effects).is_ok();
            possible.then_some(Sound { flavour, effects, name: info.name })
        });
        std::iter::once(alone).chain(each)
    };
    Flavour::ALL.into_iter().flat_map(with).collect()
}

#[derive(Debug, PartialEq)]
enum Came {
    NotAligned,
    RanToItsEnd,
    /// It was stopped while it stood: a motor in its dead zone looks like one whose encoder is dead.
    Stood,
    /// It was stopped while it turned.
    Stopped(Fault),
}

/// Length of a run: nothing is forgiven with time, so a motor that is too slow by a little trips late.
const RUN_S: u32 = 10;
/// The rotor of a motor that stands under its drive keeps within a pitch of the encoder.
const PITCH_RAD: f64 = std::f64::consts::TAU / 400.0;

fn came(sound: &Sound, run: &Run, limits: Limits, run_s: u32) -> Came {
    let Some(mut bench) = sound.bench() else { return Came::NotAligned };
    run.start(&mut bench, limits, run_s * 1_000);
    // Where the rotor was last a pitch away from, and since when it keeps within one, ms.
    let (mut from_rad, mut stands_ms) = (bench.board().angle_rad(), 0);
    for _ in 0..u64::from(run_s) * 10 - 2 {
        bench.wait(100);
        if bench.board().mode() != Mode::Running {
            let fault = bench.session.hello().expect("the board answers").fault.expect("a run ends by a fault");
            return if fault == Fault::EncoderStall && stands_ms >= 800 { Came::Stood } else { Came::Stopped(fault) };
        }
        stands_ms += 100;
        if (bench.board().angle_rad() - from_rad).abs() > PITCH_RAD {
            (from_rad, stands_ms) = (bench.board().angle_rad(), 0);
        }
    }
    Came::RanToItsEnd
}

/// Every motor under every drive: prints how many ran to their end and how many stood, by flavour.
fn sweep(motors: &[Sound], limits: Limits, run_s: u32) {
    let runs = runs();
    let cases: Vec<(&Sound, &(String, Run))> =
        motors.iter().flat_map(|sound| runs.iter().map(move |run| (sound, run))).collect();
    let came: Vec<Came> = cases.par_iter().map(|(sound, (_, run))| came(sound, run, limits, run_s)).collect();
    let mut table = String::from(
        "| flavour | runs | cannot be aligned | ran to their end | stood under their drive, and stopped | turned, and stopped |\n\
         |---|---:|---:|---:|---:|---:|\n",
    );
    let mut stopped = Vec::new();
    for flavour in Flavour::ALL {
        let of = || cases.iter().zip(&came).filter(|((sound, _), _)| sound.flavour == flavour);
        let count = |wanted: fn(&Came) -> bool| of().filter(|(_, came)| wanted(came)).count();
        writeln!(
            table,
            "| {flavour} | {} | {} | {} | {} | {} |",
            of().count(),
            count(|came| *came == Came::NotAligned),
            count(|came| *came == Came::RanToItsEnd),
            count(|came| *came == Came::Stood),
            count(|came| matches!(came, Came::Stopped(_)))
        )
        .unwrap();
        for ((sound, (run, _)), came) in of().filter(|(_, came)| **came != Came::RanToItsEnd) {
            println!("{flavour}, {}: {run}: {came:?}", sound.name);
            if let Came::Stopped(fault) = came {
                stopped.push(format!("{flavour}, {}: {run}: {fault:?}", sound.name));
            }
        }
    }
    println!("{table}");
    assert!(stopped.is_empty(), "{stopped:#?}");
}

#[test]
fn a_sound_motor_of_any_flavour_is_stopped_by_no_default_limit() {
    let plain: Vec<Sound> = motors().into_iter().filter(|sound| sound.name == "no effect").collect();
    sweep(&plain, Limits::DEFAULT, RUN_S);
}

/// `cargo test --release -p twum-tests --test board -- --ignored --nocapture sound_motor_with_any_effect`
#[test]
#[ignore = "minutes: every effect"]
fn a_sound_motor_with_any_effect_is_stopped_by_no_default_limit() {
    // In the other flavours the typical Stribeck friction holds the rotor, and a weight turns it.
    let physical: Vec<Sound> = motors().into_iter().filter(|sound| sound.flavour == Flavour::Physical).collect();
    sweep(&physical, Limits::DEFAULT, RUN_S);
}
