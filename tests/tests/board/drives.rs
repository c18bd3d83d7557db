//! What a motor is asked to do where its encoder is judged: every duty and every reference.

use crate::bench::{Bench, speed};
use twum_shared::message::{Configuration, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::safety::Limits;
use twum_shared::step::ConfigSpec;
use twum_shared::{Direction, Duty};

#[derive(Clone)]
pub enum Run {
    Duty(u16, u16),
    Track(Box<ConfigSpec>, Reference),
}

pub fn runs() -> Vec<(String, Run)> {
    let mut runs: Vec<(String, Run)> = [(1, 32), (5, 100), (10, 100), (249, 1_000), (50, 100), (100, 100)]
        .into_iter()
        .map(|(on, of)| (format!("duty {:.3}", f64::from(on) / f64::from(of)), Run::Duty(on, of)))
        .collect();
    let references = [
        ("sine of 10 counts", Reference::Sine { amplitude: 10, omega_urad_s: 1_257_000 }),
        ("sine of 89 counts", Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 }),
        ("step of 3 counts", Reference::Step { position: 3, at_us: 0 }),
        ("step of 100 counts", Reference::Step { position: 100, at_us: 0 }),
        ("ramp of 5 counts/s", Reference::Ramp { rate: 5, limit: 1_000 }),
    ];
    for (controller, spec) in ConfigSpec::NAMED {
        for (name, reference) in &references {
            runs.push((format!("{name}, {controller} controller"), Run::Track(Box::new(spec), reference.clone())));
        }
    }
    runs
}

impl Run {
    /// Configures the aligned board of `bench`, arms it and starts.
    pub fn start(&self, bench: &mut Bench, limits: Limits, duration_ms: u32) {
        let spec = match self {
            Self::Duty(..) => ConfigSpec::DEFAULT,
            Self::Track(spec, _) => **spec,
        };
        let configuration = Configuration { limits, ..Configuration::with_control(spec) };
        bench.session.configure(configuration).expect("configuration");
        bench.session.arm().expect("arming");
        match self {
            Self::Duty(on, of) => {
                let duty = Duty::from_ratio(*on, *of);
                bench.session.start_speed(speed(duty, Direction::Cw, duration_ms)).expect("run");
            }
            Self::Track(_, reference) => {
                bench.session.start_track(TrackRun { reference: reference.clone(), duration_ms }).expect("run");
            }
        }
    }
}
