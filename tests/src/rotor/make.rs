//! One data set from one seed: motor, experiment, nuisances, what is hidden, how strongly; then the folder.

use super::design::Design;
use super::effects::{Acting, Effect, LIBRARY, OUTSIDE, OUTSIDE_BOTH, Past};
use super::loops;
use super::motion::{Motion, Rotor};
use super::recorder::{Clock, Crossings, Grid, Nuisance, Wheel, edge_times, record};
use super::shape::{between, log_between, normal};
use crate::folder::{Folder, Record, Run};
use crate::strength::{Floor, Refit, Traces, at};
use crate::truth::{Hidden, Kind, Made, Request, Truth};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Experiments drawn for one seed until the wanted effect shows in one.
const ATTEMPTS: u64 = 40;
/// Strength that nobody would overlook: an effect whose smallest size is stronger is not hidden there.
const STRONGEST: f64 = 12.0;
/// Runs from which sizes are found; strengths are then read from all.
const PROBED: usize = 14;

/// Makes the data set of a seed.
///
/// # Errors
/// An effect this generator does not know, or one that reaches no strength of 1 in any experiment drawn.
pub fn make(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return loops::make(seed, request);
    }
    let (case, hidden) = found(seed, request)?;
    Ok(case.finish(seed, request.kind, &hidden))
}

/// The same data set with nothing hidden: same motor, experiment and noise. For the oracle.
///
/// # Errors
/// As [`make`].
pub fn without(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return loops::make(seed, &Request { effects: vec!["none".to_owned()], ..request.clone() });
    }
    let (case, _) = found(seed, request)?;
    Ok(case.finish(seed, Kind::Null, &[]))
}

fn found(seed: u64, request: &Request) -> Result<(Case, Vec<Effect>), String> {
    let names = names(seed, request)?;
    // Kinds are other motors and experiments, too.
    let own = 0xb0b + request.kind as u64;
    for attempt in 0..ATTEMPTS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (attempt << 32) ^ own);
        let case = Case::draw(&mut rng);
        if !names.iter().all(|n| case.design.shows(n)) {
            continue;
        }
        let mut hidden = Vec::new();
        for name in &names {
            let effect = Effect::draw(name, &mut rng).ok_or_else(|| format!("no effect {name}"))?;
            let drawn = log_between(&mut rng, 1.1, 8.0);
            hidden.push((effect, request.rho.unwrap_or(drawn)));
        }
        if let Some(hidden) = case.sized(hidden, request.rho.is_some()) {
            return Ok((case, hidden));
        }
    }
    Err(format!("seed {seed}: {} reaches no strength of 1 in {ATTEMPTS} experiments", names.join(" and ")))
}

/// Twins as the library declares them are no pair: together they are one effect.
const TWINS: [[&str; 2]; 6] = [
    ["dead-zone", "start-delay"],
    ["dead-zone", "high-duty-saturation"],
    ["supply-sag", "high-duty-saturation"],
    ["preload-runout", "encoder-eccentricity"],
    ["resonance-heating", "run-in-wear"],
    ["dead-zone", "duty-quantisation"],
];

fn names(seed: u64, request: &Request) -> Result<Vec<&'static str>, String> {
    let all: Vec<&'static str> = LIBRARY.iter().chain(&OUTSIDE).chain([&OUTSIDE_BOTH]).map(|e| e.0).collect();
    if !request.effects.is_empty() {
        let known = |name: &String| all.iter().find(|n| *n == name).copied();
        return request
            .effects
            .iter()
            .map(|n| known(n).ok_or_else(|| format!("no effect {n}: one of {}", all.join(", "))))
            .collect();
    }
    let library = LIBRARY.len() as u64;
    Ok(match request.kind {
        Kind::Null | Kind::Closed => Vec::new(),
        // Every effect comes equally often, whatever the seeds.
        Kind::Single | Kind::Removed => vec![all[(seed % library) as usize]],
        Kind::Outside => vec![all[(library + seed % (OUTSIDE.len() as u64 + 1)) as usize]],
        Kind::Pair => {
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x2);
            let first = all[(seed % library) as usize];
            loop {
                let second = all[rng.random_range(0..LIBRARY.len())];
                let twins = TWINS.iter().any(|t| t.contains(&first) && t.contains(&second));
                if second != first && !twins {
                    break vec![first, second];
                }
            }
        }
    })
}

/// One motor on one bench.
#[derive(Debug, Clone)]
struct Case {
    rotor: Rotor,
    design: Design,
    nuisance: Nuisance,
    seed: u64,
}

impl Case {
    fn draw(rng: &mut ChaCha8Rng) -> Self {
        let rotor = Rotor::draw(rng);
        let design = Design::draw(rng, rotor.crest * 60.0 / TAU);
        let nuisance = Nuisance::draw(rng, design.sample_us.is_some());
        Self { rotor, design, nuisance, seed: rng.random() }
    }

    fn total_revolutions(&self) -> f64 {
        self.design.runs.iter().map(|r| r.drive.duty * r.drive.seconds * self.rotor.crest / TAU).sum()
    }

    /// What each run starts from.
    fn pasts(&self, hidden: &[Effect]) -> Vec<Past> {
        let mut past = Past::default();
        let next = |r: &super::design::Planned| {
            let before = past;
            past = past.after(&r.drive, self.rotor.crest, r.rest_s, hidden);
            before
        };
        self.design.runs.iter().map(next).collect()
    }

    fn run_rng(&self, k: usize, what: u64) -> u64 {
        self.seed.wrapping_add((k as u64 + 1).wrapping_mul(0x2545_f491_4f6c_dd1d)) ^ what
    }

    fn wheel(&self, hidden: &[Effect]) -> Wheel {
        Wheel::new(self.design.edges, self.nuisance.irregular, self.seed ^ 0x33, hidden)
    }

    /// Where run `k` starts, its own gain, and how much of it was recorded in s.
    fn circumstances(&self, k: usize, wheel: &Wheel) -> (f64, f64, f64) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.run_rng(k, 1));
        let anywhere = between(&mut rng, 0.0, TAU);
        let gain = 1.0 + self.nuisance.gain_spread * normal(&mut rng).clamp(-3.0, 3.0);
        let [share, most] = self.nuisance.truncated;
        let cut = if rng.random::<f64>() < share { most * rng.random::<f64>() } else { 0.0 };
        let seconds = (self.design.runs[k].drive.seconds + between(&mut rng, 0.05, 0.3)) * (1.0 - cut);
        (if self.design.aligned { wheel.pulse_start() } else { anywhere }, gain, seconds)
    }

    fn motion<'a>(
        &self,
        rotor: &'a Rotor,
        k: usize,
        past: Past,
        hidden: &'a [Effect],
        zero: f64,
        gain: f64,
    ) -> Motion<'a> {
        let drive = self.design.runs[k].drive;
        let (total, seed) = (self.total_revolutions(), self.run_rng(k, 2));
        let acting = Acting::new(hidden, drive, past, zero, total, [rotor.crest, rotor.contact], seed);
        Motion::new(rotor, drive, acting, gain)
    }

    /// The noise-free trace of run `k` as it would be read.
    fn trace(&self, rotor: &Rotor, k: usize, past: Past, hidden: &[Effect]) -> Vec<f64> {
        let wheel = self.wheel(hidden);
        let (zero, _, record_s) = self.circumstances(k, &wheel);
        let drive = self.design.runs[k].drive;
        let clock = Clock::new(drive.seconds, &self.nuisance, hidden, self.run_rng(k, 3));
        let word_s = self.design.sample_us.unwrap_or(0) as f64 * 32e-6;
        let mut grid = Grid::default();
        self.motion(rotor, k, past, hidden, zero, 1.0).run(clock.shown(record_s, word_s) + 0.05, &mut |s| grid.step(s));
        let points = (record_s / crate::strength::GRID_S) as usize;
        let start = wheel.read(zero);
        (0..points)
            .map(|n| {
                let t = clock.shown(n as f64 * crate::strength::GRID_S, word_s);
                drive.sign * (wheel.read(zero + drive.sign * at(&grid.angles, t)) - start)
            })
            .collect()
    }

    /// The record of run `k`.
    fn record(&self, k: usize, past: Past, hidden: &[Effect]) -> Record {
        let wheel = self.wheel(hidden);
        let (zero, gain, record_s) = self.circumstances(k, &wheel);
        let drive = self.design.runs[k].drive;
        let clock = Clock::new(drive.seconds, &self.nuisance, hidden, self.run_rng(k, 3));
        let mut crossings = Crossings::new(&wheel, zero, drive.sign);
        self.motion(&self.rotor, k, past, hidden, zero, gain).run(1.06 * record_s + 0.3, &mut |s| crossings.step(s));
        record(&crossings, &clock, &self.nuisance, self.design.sample_us, record_s, self.run_rng(k, 4))
    }

    /// Some runs with nothing hidden; without their refit where nothing will be held against them.
    fn bench(&self, runs: &[usize], parameters: usize) -> Bench<'_> {
        let pasts = self.pasts(&[]);
        let traces: Vec<(Traces, Floor)> = runs
            .par_iter()
            .map(|k| {
                let plain = self.trace(&self.rotor, *k, pasts[*k], &[]);
                let nudge = |p: usize| self.trace(&self.rotor.nudged(p), *k, pasts[*k], &[]);
                let (period_s, pitch) = (1.0 / self.design.runs[*k].drive.pwm_hz, TAU / f64::from(self.design.edges));
                let mut floor = Floor::default();
                floor.add(&edge_times(&self.record(*k, pasts[*k], &[])), &plain, pitch, period_s);
                (Traces { nudged: (0..parameters).map(nudge).collect(), plain, period_s, pitch }, floor)
            })
            .collect();
        let (traces, floors): (Vec<Traces>, Vec<Floor>) = traces.into_iter().unzip();
        let floor = floors.into_iter().fold(Floor::default(), Floor::with).rpm();
        Bench { case: self, runs: runs.to_vec(), refit: Refit::new(&traces), floor }
    }

    /// The runs that sizes are found from: one of every kind, spread over the order.
    fn probe(&self) -> Vec<usize> {
        let kept: Vec<usize> = (0..self.design.runs.len()).filter(|k| !self.design.runs[*k].missing).collect();
        let step = (kept.len() as f64 / PROBED as f64).max(1.0);
        (0..PROBED.min(kept.len())).map(|k| kept[(k as f64 * step) as usize]).collect()
    }

    /// Sizes at which each effect alone has the wanted strength, or `None` if one of them shows too little here.
    fn sized(&self, wanted: Vec<(Effect, f64)>, exactly: bool) -> Option<Vec<Effect>> {
        if wanted.is_empty() {
            return Some(Vec::new());
        }
        let bench = self.bench(&self.probe(), Rotor::PARAMETERS);
        wanted.into_iter().map(|(effect, rho)| bench.sized(effect, rho, exactly)).collect()
    }

    fn finish(&self, seed: u64, kind: Kind, hidden: &[Effect]) -> Made {
        let kept: Vec<usize> = (0..self.design.runs.len()).filter(|k| !self.design.runs[*k].missing).collect();
        let bench = self.bench(&kept, if hidden.is_empty() { 0 } else { Rotor::PARAMETERS });
        let pasts = self.pasts(hidden);
        let runs = kept
            .par_iter()
            .map(|k| {
                let planned = &self.design.runs[*k];
                Run {
                    id: format!("r{:03}", planned.order),
                    duty: planned.drive.duty,
                    sign: planned.drive.sign,
                    pwm_hz: planned.drive.pwm_hz,
                    drive_on_s: planned.drive.seconds,
                    order: planned.order,
                    aligned: self.design.aligned,
                    record: self.record(*k, pasts[*k], hidden),
                }
            })
            .collect();
        let effects = hidden
            .iter()
            .map(|e| Hidden {
                name: e.name.to_owned(),
                form: e.form.to_owned(),
                size: e.size,
                rho: bench.rho(std::slice::from_ref(e)),
                parameters: e.parameters(),
                coordinate: e.name.starts_with("outside").then(|| e.form.to_owned()),
            })
            .collect();
        let effect_rpm = bench.beyond(hidden);
        let gain = |k: usize| 1.0 - bench.floor[k] / bench.floor[k].hypot(effect_rpm[k]);
        let truth = Truth {
            generator: "b".to_owned(),
            seed,
            kind,
            effects,
            floor_rpm: bench.floor,
            effect_rpm,
            oracle_gain: [gain(0), gain(1)],
            motor: self.rotor.numbers(),
            design: self.design.numbers(),
        };
        Made { folder: Folder { name: format!("bench {seed}"), edges_per_rev: self.design.edges, runs }, truth }
    }
}

/// Some runs of a case with nothing hidden, refitted, against which effects are held.
struct Bench<'a> {
    case: &'a Case,
    runs: Vec<usize>,
    refit: Refit,
    floor: [f64; 2],
}

impl Bench<'_> {
    fn beyond(&self, hidden: &[Effect]) -> [f64; 2] {
        if hidden.is_empty() {
            return [0.0; 2];
        }
        let pasts = self.case.pasts(hidden);
        let with: Vec<Vec<f64>> =
            self.runs.par_iter().map(|k| self.case.trace(&self.case.rotor, *k, pasts[*k], hidden)).collect();
        self.refit.beyond(&with)
    }

    fn rho(&self, hidden: &[Effect]) -> f64 {
        let beyond = self.beyond(hidden);
        (beyond[0] / self.floor[0]).max(beyond[1] / self.floor[1])
    }

    /// The effect at a size of strength `rho`, or, unless it must be met exactly, of what it can reach beyond 1.
    fn sized(&self, mut effect: Effect, rho: f64, exactly: bool) -> Option<Effect> {
        let largest = effect.largest();
        let mut reached = 0.0;
        for _ in 0..7 {
            reached = self.rho(std::slice::from_ref(&effect));
            let short = reached < 0.93 * rho;
            if !short && reached < 1.08 * rho || short && effect.size >= largest {
                break;
            }
            let step = (rho / reached.max(1e-3)).powf(0.9).clamp(0.2, 4.0);
            effect.size = (effect.size * step).min(largest);
        }
        if effect.size < effect.least() {
            effect.size = effect.least();
            reached = self.rho(std::slice::from_ref(&effect));
            return (reached < STRONGEST).then_some(effect);
        }
        let least = if exactly { 0.8 * rho } else { 1.05 };
        (reached >= least && reached < 1.5 * rho.max(1.0)).then_some(effect)
    }
}
