//! One data set from one seed.

use super::bench::{Bench, Disc, Recorder};
use super::course::{CELL_S, Motor, follow};
use super::effects::{Before, Effect, LIBRARY, OUTSIDE, Work};
use super::loops;
use super::random::Dice;
use crate::folder::{Folder, Record, Run};
use crate::strength::{Floor, GRID_S, Refit, Traces};
use crate::truth::{Hidden, Kind, Made, Request, Truth};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Benches drawn until one shows what is wanted.
const DRAWS: usize = 40;

/// Smallest error of a clock that is hidden.
const CLOCK_LEAST: f64 = 3e-3;

/// Makes the data set of a seed.
///
/// # Errors
/// An effect this generator does not know, or one that shows on none of the benches drawn.
pub fn make(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return loops::make(seed, request);
    }
    let (scene, hidden) = arranged(seed, request)?;
    Ok(scene.made(seed, request.kind, &hidden))
}

/// The same with nothing hidden: same motor, bench and noise.
///
/// # Errors
/// As [`make`].
pub fn without(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return loops::make(seed, &Request { effects: vec!["none".to_owned()], ..request.clone() });
    }
    let (scene, _) = arranged(seed, request)?;
    Ok(scene.made(seed, Kind::Null, &[]))
}

/// Which effects a seed stands for.
fn wanted(seed: u64, request: &Request) -> Vec<String> {
    let library = LIBRARY.len() as u64;
    let name = |k: u64| LIBRARY[(k % library) as usize].0.to_owned();
    match request.kind {
        _ if !request.effects.is_empty() => request.effects.clone(),
        Kind::Null | Kind::Closed => Vec::new(),
        Kind::Single | Kind::Removed => vec![name(seed)],
        Kind::Outside => vec![OUTSIDE[(seed % OUTSIDE.len() as u64) as usize].0.to_owned()],
        // The second stands 1 to 15 places further on, no two of the same part of the motor.
        Kind::Pair => {
            let of = |k: u64| part(LIBRARY[(k % library) as usize].0);
            let mut far = 1 + (seed / library) % (library - 1);
            while of(seed) == of(seed + far) || far.is_multiple_of(library) {
                far += 1;
            }
            vec![name(seed), name(seed + far)]
        }
    }
}

/// The part of the motor an effect belongs to: two of one part may do the same to the data.
fn part(name: &str) -> &str {
    match name {
        "encoder-eccentricity" | "preload-runout" => "turning",
        "dead-zone" | "start-delay" | "duty-quantisation" | "high-duty-saturation" | "supply-sag" => "drive",
        "resonance-heating" | "run-in-wear" => "ageing",
        "stribeck-friction" | "contact-stiffening" => "contact",
        other => other,
    }
}

fn arranged(seed: u64, request: &Request) -> Result<(Scene, Vec<Effect>), String> {
    let names = wanted(seed, request);
    let mut dice = Dice::new(seed, "scene");
    for draw in 0..DRAWS {
        let mut own = Dice::new(seed, &format!("{} {draw}", request.kind.word()));
        let motor = Motor::draw(&mut own);
        let bench = Bench::draw(&mut own, motor.full);
        let scene = Scene { motor, bench, seed: seed ^ ((draw as u64) << 40) ^ ((request.kind as u64) << 48) };
        if !names.iter().all(|n| scene.bench.could_show(n)) {
            continue;
        }
        let mut hidden = Vec::new();
        let view = (!names.is_empty()).then(|| scene.view(&scene.some(), Motor::PARAMETERS));
        for name in &names {
            let effect = Effect::draw(name, &mut own).ok_or_else(|| format!("no effect {name}"))?;
            let drawn = dice.decade(1.1, 8.0);
            let fitted =
                view.as_ref().and_then(|v| v.fitted(effect, request.rho.unwrap_or(drawn), request.rho.is_some()));
            hidden.extend(fitted);
        }
        if hidden.len() == names.len() {
            return Ok((scene, hidden));
        }
    }
    Err(format!("seed {seed}: {} shows on none of {DRAWS} benches", names.join(" and ")))
}

/// A motor on a bench.
#[derive(Debug, Clone)]
struct Scene {
    motor: Motor,
    bench: Bench,
    seed: u64,
}

impl Scene {
    fn dice(&self, k: usize, purpose: &str) -> Dice {
        Dice::new(self.seed.wrapping_add(7919 * k as u64), purpose)
    }

    fn disc(&self, hidden: &[Effect]) -> Disc {
        Disc::new(&self.bench, hidden, &mut Dice::new(self.seed, "disc"))
    }

    fn before(&self, hidden: &[Effect]) -> Vec<Before> {
        let way: f64 = self.bench.plan.iter().map(|r| r.drive.duty * r.drive.seconds).sum();
        let runs = self.bench.plan.len().max(2) - 1;
        let mut now = Before::default();
        let mut all = Vec::new();
        for (k, r) in self.bench.plan.iter().enumerate() {
            now.travel[1] = r.drive.duty * r.drive.seconds / way;
            now.done = k as f64 / runs as f64;
            all.push(now);
            now.travel[0] += now.travel[1];
            now.warm = Before::warmed(now.warm, &r.drive, r.pause_s, hidden);
            now.sign = r.drive.sign;
        }
        all
    }

    fn zero(&self, k: usize) -> f64 {
        self.dice(k, "zero").even(0.0, TAU)
    }

    /// Angles of run `k`, cell by cell.
    fn angles(&self, motor: &Motor, k: usize, before: Before, hidden: &[Effect], gain: f64, until: f64) -> Vec<f64> {
        let drive = self.bench.plan[k].drive;
        let mut work = Work::new(hidden, drive, before, self.zero(k), self.seed ^ k as u64);
        follow(motor, drive, &mut work, gain, until)
    }

    fn recorder<'a>(&'a self, k: usize, hidden: &'a [Effect]) -> Recorder<'a> {
        Recorder::new(&self.bench, hidden, self.bench.plan[k].drive.seconds, &mut self.dice(k, "recorder"))
    }

    /// Run `k` without noise, as it would be read.
    fn trace(&self, motor: &Motor, k: usize, before: Before, hidden: &[Effect]) -> Vec<f64> {
        let (disc, recorder) = (self.disc(hidden), self.recorder(k, hidden));
        let angles = self.angles(motor, k, before, hidden, 1.0, recorder.seen(recorder.record_s) + 0.05);
        let (zero, sign) = (self.zero(k), self.bench.plan[k].drive.sign);
        let rest = disc.read(zero);
        let points = (recorder.record_s / GRID_S) as usize;
        let travelled = |t: f64| {
            let x = (t / CELL_S).max(0.0);
            let n = (x as usize).min(angles.len() - 2);
            angles[n] + (x - n as f64).min(1.0) * (angles[n + 1] - angles[n])
        };
        let seen = |n: usize| recorder.seen(n as f64 * GRID_S);
        (0..points).map(|n| sign * (disc.read(zero + sign * travelled(seen(n))) - rest)).collect()
    }

    fn record(&self, k: usize, before: Before, hidden: &[Effect]) -> Record {
        let recorder = self.recorder(k, hidden);
        let mut dice = self.dice(k, "gain");
        let thrown = if self.bench.heavy { dice.laplace().clamp(-3.5, 3.5) } else { dice.box_shaped() };
        let gain = 1.0 + self.bench.spread * thrown;
        let angles = self.angles(&self.motor, k, before, hidden, gain, 1.06 * recorder.record_s + 0.3);
        let (first, times) = self.disc(hidden).passed(&angles, self.zero(k), self.bench.plan[k].drive.sign);
        recorder.write(first, &times, &mut self.dice(k, "samples"))
    }

    fn kept(&self) -> Vec<usize> {
        (0..self.bench.plan.len()).filter(|k| self.bench.plan[*k].kept).collect()
    }

    /// Every so manieth run, a dozen in all: enough to find sizes.
    fn some(&self) -> Vec<usize> {
        let kept = self.kept();
        let every = kept.len().div_ceil(12);
        // A step that shares no factor with the order of the plan would be luck: shift it every round.
        (0..kept.len()).step_by(every).enumerate().map(|(n, k)| kept[(k + n % every).min(kept.len() - 1)]).collect()
    }

    /// Some runs with nothing hidden, `nudges` of the motor's parameters for the refit.
    fn view(&self, runs: &[usize], nudges: usize) -> View<'_> {
        let before = self.before(&[]);
        let seen: Vec<(Traces, Floor)> = runs
            .par_iter()
            .map(|k| {
                let plain = self.trace(&self.motor, *k, before[*k], &[]);
                let nudged = (0..nudges).map(|p| self.trace(&self.motor.nudged(p), *k, before[*k], &[])).collect();
                let (period_s, pitch) = (1.0 / self.bench.plan[*k].drive.pwm_hz, TAU / self.bench.edges as f64);
                let edges: Vec<f64> = match self.record(*k, before[*k], &[]) {
                    Record::Levels { levels, .. } => {
                        let changes = (1..levels.len()).filter(|n| levels[*n] != levels[n - 1]);
                        changes.map(|n| (n as f64 - 0.5) * 1e-3).collect()
                    }
                    Record::Edges { times_us, .. } => times_us.iter().map(|t| *t as f64 * 1e-6).collect(),
                    Record::Control { .. } => Vec::new(),
                };
                let mut floor = Floor::default();
                floor.add(&edges, &plain, pitch, period_s);
                (Traces { plain, nudged, period_s, pitch }, floor)
            })
            .collect();
        let (traces, floors): (Vec<Traces>, Vec<Floor>) = seen.into_iter().unzip();
        let floor = floors.into_iter().fold(Floor::default(), Floor::with).rpm();
        View { scene: self, runs: runs.to_vec(), refit: Refit::new(&traces), floor }
    }

    fn made(&self, seed: u64, kind: Kind, hidden: &[Effect]) -> Made {
        let kept = self.kept();
        let view = self.view(&kept, if hidden.is_empty() { 0 } else { Motor::PARAMETERS });
        let before = self.before(hidden);
        let run = |k: &usize| {
            let drive = self.bench.plan[*k].drive;
            Run {
                id: format!("{:02}-{}", k, if drive.sign > 0.0 { "cw" } else { "ccw" }),
                duty: drive.duty,
                sign: drive.sign,
                pwm_hz: drive.pwm_hz,
                drive_on_s: drive.seconds,
                order: *k,
                aligned: false,
                record: self.record(*k, before[*k], hidden),
            }
        };
        let effects = hidden.iter().map(|e| Hidden {
            name: e.name.to_owned(),
            form: e.variant.to_owned(),
            size: e.size,
            rho: view.rho(std::slice::from_ref(e)),
            parameters: e.parameters(),
            coordinate: e.name.starts_with("outside").then(|| e.variant.to_owned()),
        });
        let effect_rpm = if hidden.is_empty() { [0.0; 2] } else { view.left_by(hidden) };
        let truth = Truth {
            generator: "c".to_owned(),
            seed,
            kind,
            effects: effects.collect(),
            floor_rpm: view.floor,
            effect_rpm,
            oracle_gain: [0, 1].map(|k| 1.0 - view.floor[k] / view.floor[k].hypot(effect_rpm[k])),
            motor: self.motor.numbers(),
            design: self.bench.numbers(),
        };
        let runs = kept.par_iter().map(run).collect();
        Made { folder: Folder { name: format!("series {seed}"), edges_per_rev: self.bench.edges as u32, runs }, truth }
    }
}

/// Some runs of a scene, refitted.
struct View<'a> {
    scene: &'a Scene,
    runs: Vec<usize>,
    refit: Refit,
    floor: [f64; 2],
}

impl View<'_> {
    fn left_by(&self, hidden: &[Effect]) -> [f64; 2] {
        let before = self.scene.before(hidden);
        let motor = &self.scene.motor;
        let with: Vec<Vec<f64>> =
            self.runs.par_iter().map(|k| self.scene.trace(motor, *k, before[*k], hidden)).collect();
        self.refit.beyond(&with)
    }

    fn rho(&self, hidden: &[Effect]) -> f64 {
        let [fine, coarse] = self.left_by(hidden);
        (fine / self.floor[0]).max(coarse / self.floor[1])
    }

    /// The effect as strong as `rho`; unless it must be just that, as strong as it gets beyond 1.
    fn fitted(&self, mut effect: Effect, rho: f64, just_that: bool) -> Option<Effect> {
        let (mut below, mut above) = (0.0, effect.largest());
        let sign = effect.size.signum();
        for _ in 0..8 {
            let now = self.rho(std::slice::from_ref(&effect));
            let size = effect.size.abs();
            if (0.93..1.08).contains(&(now / rho)) {
                break;
            }
            if now < rho {
                if size >= effect.largest() {
                    break;
                }
                below = size;
            } else {
                above = size;
            }
            let aimed = size * (rho / now.max(1e-2)).clamp(0.25, 4.0);
            let inside = aimed > below && aimed < above;
            effect.size = sign
                * if inside {
                    aimed
                } else if above >= effect.largest() {
                    above
                } else {
                    0.5 * (below + above)
                };
        }
        // A clock is a ten-thousandth wrong anyway: what is called an error of it is larger.
        if effect.name == "clock-error" && effect.size.abs() < CLOCK_LEAST {
            effect.size = sign * CLOCK_LEAST;
            return (self.rho(std::slice::from_ref(&effect)) < 12.0).then_some(effect);
        }
        let now = self.rho(std::slice::from_ref(&effect));
        let least = if just_that { 0.8 * rho } else { 1.05 };
        (now >= least && now < 1.5 * rho.max(1.0)).then_some(effect)
    }
}
