//! How fast the motor models are: `cargo bench -p twum-host --bench model`.
//!
//! Times are processor times where the kernel tells them (Linux), so a busy machine does not count against the code.

use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::{Duration, Instant};
use twum_host::model::averaged::Averaged;
use twum_host::model::carrier::{Carrier, STEP_S, SideBySide};
use twum_host::model::closed_loop::{LoopProgram, run};
use twum_host::model::effects::EffectSet;
use twum_host::model::modulation::Modulation;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::{History, MotorPlant, Solver};
use twum_host::model::parameters::Flavour;
use twum_host::model::plant::{Direction, Drive};
use twum_host::model::simulate::{PlantModel, Program, Trace, simulate_into};
use twum_shared::reference::Reference;
use twum_shared::step::{Config, ConfigSpec};

/// Processor time of this thread; wall time where there is none to be had.
struct CpuTime {
    began: Instant,
    wall: WallTime,
}

impl CpuTime {
    fn now(&self) -> Duration {
        std::fs::read_to_string("/proc/thread-self/schedstat")
            .ok()
            .and_then(|text| text.split(' ').next()?.parse().ok())
            .map_or_else(|| self.began.elapsed(), Duration::from_nanos)
    }
}

impl Measurement for CpuTime {
    type Intermediate = Duration;
    type Value = Duration;

    fn start(&self) -> Duration {
        self.now()
    }

    fn end(&self, start: Duration) -> Duration {
        // The kernel counts in ticks: a short sample may see none.
        (self.now() - start).max(Duration::from_nanos(1))
    }

    fn add(&self, a: &Duration, b: &Duration) -> Duration {
        *a + *b
    }

    fn zero(&self) -> Duration {
        Duration::ZERO
    }

    fn to_f64(&self, value: &Duration) -> f64 {
        value.as_nanos() as f64
    }

    fn formatter(&self) -> &dyn ValueFormatter {
        self.wall.formatter()
    }
}

const FLAVOURS: [Flavour; 3] = Flavour::ALL;

/// RK4 steps a second at 0.1 µs, rotor turning.
fn carrier(criterion: &mut Criterion<CpuTime>) {
    let mut group = criterion.benchmark_group("carrier");
    let steps = 20_000;
    group.throughput(Throughput::Elements(steps)).sample_size(20);
    for flavour in FLAVOURS {
        let mut model = Carrier::new(Motor::pcbmotor_30mm().parameters(flavour), flavour);
        model.run(0.02, Drive::ON, &Modulation::NONE);
        group.bench_function(flavour.to_string(), |bencher| {
            bencher.iter(|| model.run(steps as f64 * STEP_S, black_box(Drive::ON), &Modulation::NONE));
        });
    }
    for flavour in FLAVOURS {
        let mut four = SideBySide::new([Motor::pcbmotor_30mm().parameters(flavour); 4], flavour);
        four.run(0.02, [Drive::ON; 4]);
        group.throughput(Throughput::Elements(4 * steps));
        group.bench_function(format!("{flavour}, four motors side by side"), |bencher| {
            bencher.iter(|| four.run(steps as f64 * STEP_S, black_box([Drive::ON; 4])));
        });
    }
    group.finish();
}

/// PWM periods of 20 ms a second, every one integrated: times 0.02 it is times real time.
fn averaged(criterion: &mut Criterion<CpuTime>) {
    let mut group = criterion.benchmark_group("averaged, every period integrated");
    group.throughput(Throughput::Elements(1)).sample_size(20);
    for flavour in FLAVOURS {
        let mut model = Averaged::new(Motor::pcbmotor_30mm().parameters(flavour), flavour);
        let off = Drive { duty: 0.5, ..Drive::OFF };
        let on = Drive { duty: 0.5, ..Drive::ON };
        group.bench_function(format!("{flavour}, duty 0.5"), |bencher| {
            bencher.iter(|| {
                let now = model.time_s();
                model.advance(now + 0.01, black_box(off), &mut |_| ());
                model.advance(now + 0.02, black_box(on), &mut |_| ());
            });
        });
    }
    group.finish();
}

/// A run of 5 s with encoder edges, as a search makes them.
fn runs(criterion: &mut Criterion<CpuTime>) {
    let mut group = criterion.benchmark_group("simulated run of 5 s");
    group.sample_size(20);
    let mut trace = Trace::default();
    for flavour in FLAVOURS {
        let parameters = Motor::pcbmotor_30mm().parameters(flavour);
        let model = PlantModel::Motor { parameters, flavour, solver: Solver::Averaged };
        for duty in [0.5, 1.0] {
            let program = Program::constant(duty, Direction::Cw, 5.0, 5.0);
            group.bench_function(format!("{flavour}, duty {duty}"), |bencher| {
                bencher.iter(|| simulate_into(&program, &model, &EffectSet::default(), History::default(), &mut trace));
            });
        }
        let mut effects = EffectSet::default();
        effects.set("preload-runout", &[0.1, 0.0]).expect("inside its bounds");
        let program = Program::constant(0.5, Direction::Cw, 5.0, 5.0);
        group.bench_function(format!("{flavour}, duty 0.5, preload-runout"), |bencher| {
            bencher.iter(|| simulate_into(&program, &model, &effects, History::default(), &mut trace));
        });
    }
    group.finish();
}

/// The thesis's closed-loop test of 10 s under both controllers.
fn loops(criterion: &mut Criterion<CpuTime>) {
    let mut group = criterion.benchmark_group("closed loop of 10 s");
    group.sample_size(10);
    for flavour in FLAVOURS {
        let parameters = Motor::pcbmotor_30mm().parameters(flavour);
        for (name, spec) in [("thesis", ConfigSpec::THESIS), ("default", ConfigSpec::DEFAULT)] {
            let program = LoopProgram {
                config: Config::try_from(spec).expect("a named controller runs"),
                reference: Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 },
                pwm_hz: 50.0,
                edges_per_rev: 400,
                encoder_phase_rad: 0.0,
                end_s: 10.0,
                true_sense: false,
            };
            let none = EffectSet::default();
            group.bench_function(format!("{flavour}, {name} controller"), |bencher| {
                bencher.iter(|| {
                    let mut plant = MotorPlant::new(parameters, flavour, Solver::Averaged, &none, History::default());
                    run(black_box(&program), &mut plant, &none).expect("the controller runs")
                });
            });
        }
    }
    group.finish();
}

fn processor_time() -> Criterion<CpuTime> {
    Criterion::default().with_measurement(CpuTime { began: Instant::now(), wall: WallTime })
}

criterion_group! {
    name = benches;
    config = processor_time();
    targets = carrier, averaged, runs, loops
}
criterion_main!(benches);
