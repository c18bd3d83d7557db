//! One data set from one seed: motor, bench, what every motor has a little of, what is hidden; then the folder.

use super::acting::{Acting, Moment, Past};
use super::bench::Bench;
use super::effects::{Effect, LIBRARY, OUTSIDE, names};
use super::encoder::{Edges, Recorder, Wheel, edge_times};
use super::loops;
use super::motor::{Motor, Rotor, Step};
use crate::folder::{Folder, Record, Run};
use crate::profile::random::Dice;
use crate::strength::{Floor, GRID_S, Refit, Traces, at};
use crate::truth::{Hidden, Kind, Made, Request, Truth};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Benches drawn until one shows what is wanted.
const DRAWS: usize = 60;
/// Runs from which sizes are found; strengths are then read from all.
const PROBED: usize = 10;
/// Strength that nobody would overlook.
const STRONGEST: f64 = 12.0;
/// What every motor has a little of, and the form in which it acts alike on all.
const NUISANCES: [(&str, &str); 3] =
    [("preload-runout", "all"), ("encoder-eccentricity", "off centre"), ("direction-asymmetry", "speed")];
/// How strong that is, at least and at most: a hundredth of the error goes with it.
const NUISANCE_RHO: [f64; 2] = [0.02, 0.12];

/// Makes the data set of a seed.
///
/// # Errors
/// An effect this generator does not know, or one that shows on none of the benches drawn.
pub fn make(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return loops::make(seed, request);
    }
    drawn(seed, request, false)
}

/// The same with nothing hidden: same motor, bench and noise.
///
/// # Errors
/// As [`make`].
pub fn without(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return loops::make(seed, &Request { effects: vec!["none".to_owned()], ..request.clone() });
    }
    drawn(seed, request, true)
}

/// Effects that can do the same to the same data: together they are no pair.
const ALIKE: [&[&str]; 5] = [
    &["dead-zone", "start-delay", "high-duty-saturation", "supply-sag", "duty-quantisation"],
    &["start-delay", "stribeck-friction", "contact-stiffening", "dead-zone"],
    &["preload-runout", "encoder-eccentricity"],
    &["resonance-heating", "run-in-wear"],
    &["resonance-heating", "supply-sag"],
];

/// What a seed stands for.
fn wanted(seed: u64, request: &Request) -> Result<Vec<&'static str>, String> {
    if !request.effects.is_empty() {
        let known = |asked: &String| {
            let all = || names().collect::<Vec<&str>>().join(", ");
            names().find(|n| n == asked).ok_or_else(|| format!("no effect {asked}: one of {}", all()))
        };
        return request.effects.iter().map(known).collect();
    }
    // Every one comes equally often, whatever the seeds.
    let library = |k: u64| LIBRARY[(k % LIBRARY.len() as u64) as usize].0;
    Ok(match request.kind {
        Kind::Null | Kind::Closed => Vec::new(),
        Kind::Single | Kind::Removed => vec![library(seed)],
        Kind::Outside => vec![OUTSIDE[(seed % OUTSIDE.len() as u64) as usize].0],
        Kind::Pair => {
            let first = library(seed);
            let alike = |name: &str| ALIKE.iter().any(|set| set.contains(&first) && set.contains(&name));
            let others: Vec<&str> = LIBRARY.iter().map(|e| e.0).filter(|n| *n != first && !alike(n)).collect();
            vec![first, Dice::new(seed, "second of a pair").pick(&others)]
        }
    })
}

fn drawn(seed: u64, request: &Request, clean: bool) -> Result<Made, String> {
    let wanted = wanted(seed, request)?;
    let just_that = request.rho.is_some();
    for draw in 0..DRAWS {
        let mut dice = Dice::new(seed, &format!("d {} {draw}", request.kind.word()));
        let motor = Motor::draw(&mut dice);
        let bench = Bench::draw(&mut dice, motor.full(), motor.wave_s[0]);
        if !wanted.iter().all(|n| bench.could_show(n)) {
            continue;
        }
        let scene = Scene { motor, bench, nuisances: Vec::new(), seed: dice.whole(0, usize::MAX - 1) as u64 };
        let scene = scene.with_nuisances(&mut dice);
        if wanted.is_empty() {
            return Ok(scene.made(seed, Kind::Null, &[], &scene.view(&scene.bench.kept(), 0)));
        }
        let probe = scene.view(&scene.probed(), Motor::PARAMETERS);
        let mut near = Vec::new();
        for name in &wanted {
            let effect = Effect::draw(name, &mut dice).ok_or_else(|| format!("no effect {name}"))?;
            let rho = dice.decade(1.05, 5.0);
            let rho = request.rho.unwrap_or(rho);
            near.extend(probe.sized(effect, rho, just_that).map(|e| (e, rho)));
        }
        if near.len() < wanted.len() {
            continue;
        }
        // A few runs say about how large; all of them say it.
        let view = scene.view(&scene.bench.kept(), Motor::PARAMETERS);
        let hidden: Vec<Effect> = near.into_iter().filter_map(|(e, rho)| view.sized(e, rho, just_that)).collect();
        if hidden.len() == wanted.len() {
            let (kind, hidden) = if clean { (Kind::Null, &[][..]) } else { (request.kind, &hidden[..]) };
            return Ok(scene.made(seed, kind, hidden, &view));
        }
    }
    Err(format!("seed {seed}: {} shows on none of {DRAWS} benches", wanted.join(" and ")))
}

/// A motor on a bench.
#[derive(Debug, Clone)]
struct Scene {
    motor: Motor,
    bench: Bench,
    nuisances: Vec<Effect>,
    seed: u64,
}

impl Scene {
    fn dice(&self, k: usize, purpose: &str) -> Dice {
        Dice::new(self.seed.wrapping_add(0x9e37_79b9 * (k as u64 + 1)), purpose)
    }

    /// With what every motor has a little of.
    fn with_nuisances(mut self, dice: &mut Dice) -> Self {
        let bare = self.view(&self.probed(), 1);
        let quiet = self.quiet_floor(&bare.runs);
        let mut nuisances = Vec::new();
        for (name, form) in NUISANCES {
            let effect = Effect::draw(name, dice).expect("it is in the library").in_form(form);
            let rho = dice.decade(NUISANCE_RHO[0], NUISANCE_RHO[1]);
            if self.bench.could_show(name) {
                // A run's own gain hides an asymmetry, and nothing that turns with the shaft.
                let floor = if name == "direction-asymmetry" { bare.floor } else { quiet };
                nuisances.push(bare.slight(effect, rho, floor));
            }
        }
        self.nuisances = nuisances;
        self
    }

    /// What acts in all: what every motor has a little of, and what is hidden.
    fn all(&self, hidden: &[Effect]) -> Vec<Effect> {
        [&self.nuisances, hidden].concat()
    }

    fn pasts(&self, acting: &[Effect]) -> Vec<Past> {
        let runs: Vec<_> = self.bench.plan.iter().map(|r| (r.drive, r.pause_s)).collect();
        Past::of(&runs, acting)
    }

    fn wheel(&self, acting: &[Effect]) -> Wheel {
        Wheel::new(&self.bench, acting, &mut Dice::new(self.seed, "wheel"))
    }

    fn start(&self, k: usize) -> f64 {
        self.dice(k, "start").even(0.0, TAU)
    }

    fn recorder<'a>(&'a self, k: usize, acting: &'a [Effect]) -> Recorder<'a> {
        Recorder::new(&self.bench, acting, self.bench.plan[k].drive.seconds, &mut self.dice(k, "recorder"))
    }

    /// Run `k` to `until` in s, step by step.
    fn ride(
        &self,
        motor: &Motor,
        (k, past): (usize, Past),
        all: &[Effect],
        gain: f64,
        until: f64,
        sink: &mut dyn FnMut(&Step),
    ) {
        let drive = self.bench.plan[k].drive;
        let mut acting = Acting::new(all, motor, drive, past, gain, self.seed ^ k as u64);
        let mut rotor = Rotor::at(motor, self.start(k));
        let mut now = Moment { t: 0.0, on: false, driven_s: 0.0, pulse: 0, angle: rotor.angle, speed: 0.0 };
        let mut go = |to: f64, on: bool, pulse: usize, acting: &mut Acting| {
            let from = rotor.t;
            while rotor.t < to - 1e-10 {
                now =
                    Moment { t: rotor.t, on, driven_s: rotor.t - from, pulse, angle: rotor.angle, speed: rotor.speed };
                let step = rotor.step(on, drive.sign, &acting.factors(&now), to - rotor.t);
                acting.pass(on, step.t[1] - step.t[0]);
                sink(&step);
            }
        };
        let period = 1.0 / drive.pwm_hz;
        let pause_s = (1.0 - acting.duty(drive.duty)) * period;
        let end = drive.seconds.min(until);
        let pulses = (end / period).ceil() as usize;
        for pulse in 0..pulses {
            let start = pulse as f64 * period;
            let begins = pulse == 0 || pause_s > 1e-9;
            let late = if begins { acting.delay(if pulse == 0 { 1.0 } else { pause_s }) } else { 0.0 };
            let stop = (start + period).min(end);
            go((start + pause_s + late).min(stop), false, pulse, &mut acting);
            go(stop, true, pulse, &mut acting);
        }
        go(until, false, pulses, &mut acting);
    }

    /// Run `k` without noise, as it would be read.
    fn trace(&self, motor: &Motor, k: usize, past: Past, all: &[Effect]) -> Vec<f64> {
        let (wheel, recorder) = (self.wheel(all), self.recorder(k, all));
        let mut angles = Vec::new();
        let until = recorder.seen(recorder.record_s) + 0.01;
        self.ride(motor, (k, past), all, 1.0, until, &mut |step| {
            let dt = step.t[1] - step.t[0];
            while angles.len() as f64 * GRID_S <= step.t[1] {
                angles.push(step.angle_at(((angles.len() as f64 * GRID_S - step.t[0]) / dt).clamp(0.0, 1.0)));
            }
        });
        let (sign, rest) = (self.bench.plan[k].drive.sign, wheel.read(self.start(k)));
        let points = (recorder.record_s / GRID_S) as usize;
        (0..points).map(|n| sign * (wheel.read(at(&angles, recorder.seen(n as f64 * GRID_S))) - rest)).collect()
    }

    /// The file of run `k`.
    fn record(&self, k: usize, past: Past, all: &[Effect], spread: f64) -> Record {
        let (wheel, recorder) = (self.wheel(all), self.recorder(k, all));
        let gain = 1.0 + spread * super::smooth::normal(&mut self.dice(k, "gain")).clamp(-3.0, 3.0);
        let mut edges = Edges::new(&wheel, self.start(k));
        self.ride(&self.motor, (k, past), all, gain, 1.06 * recorder.record_s + 0.3, &mut |step| edges.step(step));
        recorder.write(edges.first, &edges.times, &mut self.dice(k, "samples"))
    }

    /// The runs that sizes are found from, spread over the order.
    fn probed(&self) -> Vec<usize> {
        let kept = self.bench.kept();
        let count = PROBED.min(kept.len());
        // Not in even steps: a plan in rounds would give the same duties again and again.
        let mut dice = Dice::new(self.seed, "probed");
        let part = kept.len() as f64 / count as f64;
        (0..count).map(|n| kept[((n as f64 + dice.even(0.0, 0.999)) * part) as usize]).collect()
    }

    /// Some runs with nothing hidden, with their refit where something will be held against them.
    fn view(&self, runs: &[usize], parameters: usize) -> View<'_> {
        let all = self.all(&[]);
        let pasts = self.pasts(&all);
        let seen: Vec<(Traces, Floor)> = runs
            .par_iter()
            .map(|k| {
                let trace = |motor: &Motor| self.trace(motor, *k, pasts[*k], &all);
                let plain = trace(&self.motor);
                let nudged = (0..parameters).map(|p| trace(&self.motor.nudged(p))).collect();
                let (period_s, pitch) = (1.0 / self.bench.plan[*k].drive.pwm_hz, TAU / self.bench.edges as f64);
                let mut floor = Floor::default();
                floor.add(&edge_times(&self.record(*k, pasts[*k], &all, self.bench.spread)), &plain, pitch, period_s);
                (Traces { plain, nudged, period_s, pitch }, floor)
            })
            .collect();
        let (traces, floors): (Vec<Traces>, Vec<Floor>) = seen.into_iter().unzip();
        let floor = floors.into_iter().fold(Floor::default(), Floor::with).rpm();
        View { scene: self, runs: runs.to_vec(), refit: Refit::new(&traces), floor }
    }

    /// The noise floor without the runs' own gains.
    fn quiet_floor(&self, runs: &[usize]) -> [f64; 2] {
        let pasts = self.pasts(&[]);
        let floor = |k: &usize| {
            let mut floor = Floor::default();
            let edges = edge_times(&self.record(*k, pasts[*k], &[], 0.0));
            let plain = self.trace(&self.motor, *k, pasts[*k], &[]);
            floor.add(&edges, &plain, TAU / self.bench.edges as f64, 1.0 / self.bench.plan[*k].drive.pwm_hz);
            floor
        };
        runs.par_iter().map(floor).collect::<Vec<Floor>>().into_iter().fold(Floor::default(), Floor::with).rpm()
    }

    fn made(&self, seed: u64, kind: Kind, hidden: &[Effect], view: &View) -> Made {
        let all = self.all(hidden);
        let pasts = self.pasts(&all);
        let run = |k: &usize| {
            let drive = self.bench.plan[*k].drive;
            Run {
                id: format!("run-{k:02}"),
                duty: drive.duty,
                sign: drive.sign,
                pwm_hz: drive.pwm_hz,
                drive_on_s: drive.seconds,
                order: *k,
                aligned: false,
                record: self.record(*k, pasts[*k], &all, self.bench.spread),
            }
        };
        let runs = view.runs.par_iter().map(run).collect();
        let effects = hidden.iter().map(|e| Hidden {
            name: e.name.to_owned(),
            form: e.form.to_owned(),
            size: e.size,
            rho: view.rho(std::slice::from_ref(e)),
            parameters: e.parameters(),
            coordinate: e.name.starts_with("outside").then(|| e.form.to_owned()),
        });
        let effect_rpm = if hidden.is_empty() { [0.0; 2] } else { view.beyond(hidden) };
        let mut design = self.bench.numbers();
        design.extend(self.nuisances.iter().map(|e| (format!("slight_{}", e.name.replace('-', "_")), e.size)));
        let truth = Truth {
            generator: "d".to_owned(),
            seed,
            kind,
            effects: effects.collect(),
            floor_rpm: view.floor,
            effect_rpm,
            oracle_gain: [0, 1].map(|k| 1.0 - view.floor[k] / view.floor[k].hypot(effect_rpm[k])),
            motor: self.motor.numbers(),
            design,
        };
        Made {
            folder: Folder { name: format!("measured {seed}"), edges_per_rev: self.bench.edges as u32, runs },
            truth,
        }
    }
}

/// Some runs of a scene with nothing hidden, refitted, against which effects are held.
struct View<'a> {
    scene: &'a Scene,
    runs: Vec<usize>,
    refit: Refit,
    floor: [f64; 2],
}

impl View<'_> {
    fn beyond(&self, hidden: &[Effect]) -> [f64; 2] {
        let all = self.scene.all(hidden);
        let pasts = self.scene.pasts(&all);
        let with: Vec<Vec<f64>> =
            self.runs.par_iter().map(|k| self.scene.trace(&self.scene.motor, *k, pasts[*k], &all)).collect();
        self.refit.beyond(&with)
    }

    fn over(&self, hidden: &[Effect], floor: [f64; 2]) -> f64 {
        let [fine, coarse] = self.beyond(hidden);
        (fine / floor[0]).max(coarse / floor[1])
    }

    fn rho(&self, hidden: &[Effect]) -> f64 {
        self.over(hidden, self.floor)
    }

    /// The effect so small that its strength is `rho`: by proportion, which small ones keep to.
    fn slight(&self, mut effect: Effect, rho: f64, floor: [f64; 2]) -> Effect {
        effect.size = 0.01_f64.copysign(effect.size);
        effect.size *= (rho / self.over(std::slice::from_ref(&effect), floor).max(1e-3)).min(3.0);
        effect
    }

    /// The effect as strong as `rho`; unless it must be just that, as strong as it gets beyond 1.
    fn sized(&self, mut effect: Effect, rho: f64, just_that: bool) -> Option<Effect> {
        let (largest, least, sign) = (effect.largest(), effect.least(), effect.size.signum());
        let (mut below, mut above) = (least, largest);
        let mut size = effect.size.abs();
        let mut now = 0.0;
        for _ in 0..8 {
            effect.size = sign * size;
            now = self.rho(std::slice::from_ref(&effect));
            if (0.94..1.07).contains(&(now / rho)) || (now < rho && size >= largest) || (now > rho && size <= least) {
                break;
            }
            if now < rho {
                below = size
            } else {
                above = size
            }
            let aimed = size * (rho / now.max(1e-2)).clamp(0.2, 5.0);
            size = if aimed > below && aimed < above {
                aimed
            } else if now < rho && above >= largest {
                largest
            } else if now > rho && below <= least {
                least.max(0.2 * size)
            } else {
                0.5 * (below + above)
            };
        }
        let most = if effect.size.abs() <= least { STRONGEST } else { 1.4 * rho.max(1.0) };
        (now >= if just_that { 0.85 * rho } else { 1.0 } && now < most).then_some(effect)
    }
}
