//! Hides one effect and shows what the search makes of it: `probe EFFECT RHO SEED [COUNT] [without]`.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::time::Instant;
use twum_host::diagnose::observe::{Observed, observe};
use twum_host::diagnose::problem::Problem;
use twum_host::diagnose::rotor::Parameters;
use twum_host::diagnose::search::{Settings, Status, search};
use twum_host::record::measurement::{Direction, Format, Run, RunData, RunKind};
use twum_tests::experiment::{DataSet, Design, Sealed};
use twum_tests::hidden::{Hidden, OPEN_LOOP, OUTSIDE};

fn runs(data: &DataSet) -> Vec<Observed> {
    data.runs
        .iter()
        .map(|r| {
            let run = Run {
                id: r.id.clone(),
                kind: RunKind::Speed,
                file: String::new(),
                format: Format::Levels,
                duty: Some(r.duty),
                direction: Some(if r.sign > 0.0 { Direction::Cw } else { Direction::Ccw }),
                pwm_hz: r.pwm_hz,
                drive_on_s: Some(r.seconds),
                pwm_phase_s: 0.0,
                aligned: false,
                order: Some(r.order as u32),
                control: None,
                data: RunData::Levels { start_us: 0.0, period_us: 1000.0, levels: r.levels.clone() },
            };
            observe(&run, 400).expect("generated runs are usable")
        })
        .collect()
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let rho: f64 = args.get(2).map_or(1.0, |s| s.parse().expect("rho"));
    let first: u64 = args.get(3).map_or(1, |s| s.parse().expect("seed"));
    let count: u64 = args.get(4).map_or(1, |s| s.parse().expect("count"));
    let remove = args.get(5).is_some_and(|s| s == "without");
    let names: Vec<&'static str> = OPEN_LOOP
        .iter()
        .chain(&OUTSIDE)
        .copied()
        .chain(["null", "dropped-samples"])
        .filter(|n| args[1] == "all" || *n == args[1])
        .collect();
    for name in names {
        for seed in first..first + count {
            let t0 = Instant::now();
            let sealed = Sealed::new(Design::small(), seed);
            let mut hidden = Vec::new();
            let mut achieved = 0.0;
            if name != "null" {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let mut one = Hidden::draw(name, &mut rng);
                achieved = sealed.scale_to(&mut one, rho);
                hidden.push(one);
            }
            let data = sealed.make(&hidden);
            let t1 = Instant::now();
            let problem = Problem::new(runs(&data));
            let mut settings = Settings { seed, repetitions: 200, ..Settings::default() };
            if remove {
                settings.without.push(name.to_owned());
            }
            let out = search(&problem, Parameters::new(3.6, 1890.0, 1890.0, 0.26, 0.02), &settings, &|_, _| {});
            let took = t1.elapsed().as_secs_f64();
            println!(
                "{name} seed {seed} rho {achieved:.2} size {:.3}: floor {:.2} held {:.3} -> {:.3} (made {:.1} s, searched {took:.1} s) unknown {:?}",
                hidden.first().map_or(0.0, |h| h.size),
                out.noise_floor,
                out.held_out.rmse(0),
                out.held_out.rmse(1),
                (t1 - t0).as_secs_f64(),
                out.unknown.iter().map(|u| format!("{} {:.3}", u.lives_in, u.gain)).collect::<Vec<_>>()
            );
            for f in out.findings.iter().filter(|f| f.status != Status::Rejected || f.p_null < 0.02) {
                let p: Vec<String> = f
                    .parameters
                    .iter()
                    .map(|p| format!("{}={:.4} [{:.4},{:.4}]", p.name, p.value, p.interval[0], p.interval[1]))
                    .collect();
                println!(
                    "    {:?} {} gain {:.3} [{:.3},{:.3}] p {:.3} {:?} {} (true {:?})",
                    f.status,
                    f.name,
                    f.gain,
                    f.gain_interval[0],
                    f.gain_interval[1],
                    f.p_null,
                    p,
                    f.note,
                    hidden.first().and_then(|h| h.comparable())
                );
            }
        }
    }
}
