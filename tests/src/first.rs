//! Generator A as the suite asks for it: its one design and motor family, through a folder and a truth like the others'.

use crate::experiment::{DataSet, Design, PWM_HZ, Sealed};
use crate::folder::{Folder, Record, Run, Tick};
use crate::hidden::{Hidden as Effect, OPEN_LOOP, OUTSIDE};
use crate::trace::EDGES;
use crate::tracking::{HiddenInLoop, sines};
use crate::truth::{Hidden, Kind, Made, Request, Truth};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// Motors tried for one seed until the wanted strength is reached in one.
const ATTEMPTS: u64 = 12;

/// Makes the data set of a seed.
///
/// # Errors
/// An effect this generator does not know, or one that reaches too little strength in every motor tried.
pub fn make(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return Ok(closed(seed, false));
    }
    let (sealed, hidden) = found(seed, request)?;
    Ok(finished(&sealed, seed, request.kind, &hidden))
}

/// The same with nothing hidden.
///
/// # Errors
/// As [`make`].
pub fn without(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return Ok(closed(seed, true));
    }
    let (sealed, _) = found(seed, request)?;
    Ok(finished(&sealed, seed, Kind::Null, &[]))
}

fn found(seed: u64, request: &Request) -> Result<(Sealed, Vec<(Effect, f64)>), String> {
    let all: Vec<&'static str> = OPEN_LOOP.iter().chain(&OUTSIDE).copied().chain(["dropped-samples"]).collect();
    let library = OPEN_LOOP.len() as u64;
    let drawn = |k: u64| OPEN_LOOP[(k % library) as usize].to_owned();
    let names = match request.kind {
        _ if !request.effects.is_empty() => request.effects.clone(),
        Kind::Null | Kind::Closed => Vec::new(),
        Kind::Single | Kind::Removed => vec![drawn(seed)],
        Kind::Outside => vec![OUTSIDE[(seed % OUTSIDE.len() as u64) as usize].to_owned()],
        Kind::Pair => vec![drawn(seed), drawn(seed + 1 + (seed / library) % (library - 1))],
    };
    let known = |name: &String| all.iter().find(|n| *n == name).copied().ok_or_else(|| format!("no effect {name}"));
    let names: Vec<&'static str> = names.iter().map(known).collect::<Result<_, _>>()?;
    for attempt in 0..ATTEMPTS {
        let sealed = Sealed::new(Design::small(), seed.wrapping_mul(1000) + attempt);
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ (attempt << 40));
        let hide = |name: &&'static str| {
            let mut effect = Effect::draw(name, &mut rng);
            let rho = request.rho.unwrap_or_else(|| 4f64.powf(rng.random()) * 1.05);
            // How many words are lost is no matter of strength.
            let reached = if *name == "dropped-samples" { rho } else { sealed.scale_to(&mut effect, rho) };
            (reached >= if request.rho.is_some() { 0.8 * rho } else { 1.0 }).then_some((effect, reached))
        };
        let hidden: Vec<(Effect, f64)> = names.iter().filter_map(hide).collect();
        if hidden.len() == names.len() {
            return Ok((sealed, hidden));
        }
    }
    Err(format!("seed {seed}: {} reaches no strength of 1 in {ATTEMPTS} motors", names.join(" and ")))
}

/// The number that the library calls an effect's size.
fn parameter(name: &str) -> Option<&'static str> {
    Some(match name {
        "dead-zone" => "threshold_duty",
        "start-delay" => "delay_s",
        "direction-asymmetry" => "speed_asymmetry",
        "unequal-edges" => "high_slot_excess",
        "clock-error" => "relative_clock_error",
        "supply-sag" => "speed_lost_at_full_duty",
        "encoder-eccentricity" => "eccentricity_rad",
        _ => return None,
    })
}

fn finished(sealed: &Sealed, seed: u64, kind: Kind, hidden: &[(Effect, f64)]) -> Made {
    let effects: Vec<Effect> = hidden.iter().map(|(e, _)| e.clone()).collect();
    let data = sealed.make(&effects);
    let told = hidden.iter().map(|(e, rho)| Hidden {
        name: e.name.to_owned(),
        form: "formula".to_owned(),
        size: e.size,
        rho: *rho,
        parameters: parameter(e.name).and_then(|p| Some((p.to_owned(), e.comparable()?))).into_iter().collect(),
        coordinate: coordinate(e.name).map(str::to_owned),
    });
    let floor = sealed.floor(&[]);
    let square: f64 = hidden.iter().map(|(_, rho)| (rho * floor).powi(2)).sum();
    let gain = 1.0 - floor / (floor * floor + square).sqrt();
    let truth = Truth {
        effects: told.collect(),
        floor_rpm: [floor; 2],
        effect_rpm: [square.sqrt(); 2],
        oracle_gain: [gain; 2],
        ..nothing(seed, kind)
    };
    Made { folder: folder(&data, seed), truth }
}

fn coordinate(name: &str) -> Option<&'static str> {
    match name {
        "outside-cogging" => Some("angle"),
        "outside-rhythm" => Some("time"),
        "outside-notch" => Some("duty"),
        _ => None,
    }
}

fn nothing(seed: u64, kind: Kind) -> Truth {
    Truth {
        generator: "a".to_owned(),
        seed,
        kind,
        effects: Vec::new(),
        floor_rpm: [0.0; 2],
        effect_rpm: [0.0; 2],
        oracle_gain: [0.0; 2],
        motor: BTreeMap::new(),
        design: BTreeMap::new(),
    }
}

fn folder(data: &DataSet, seed: u64) -> Folder {
    let runs = data.runs.iter().map(|r| Run {
        id: r.id.clone(),
        duty: r.duty,
        sign: r.sign,
        pwm_hz: r.pwm_hz,
        drive_on_s: r.seconds,
        order: r.order,
        aligned: false,
        record: Record::Levels { period_us: 1000, levels: r.levels.clone() },
    });
    Folder { name: format!("sealed {seed}"), edges_per_rev: EDGES as u32, runs: runs.collect() }
}

/// Eight sines of 6 s with one thing wrong in the loop, or nothing.
fn closed(seed: u64, clean: bool) -> Made {
    let none = HiddenInLoop::default();
    let (name, fault, number) = match if clean { 0 } else { seed % 5 } {
        0 => ("nothing", none, None),
        1 => ("loop-delay", HiddenInLoop { delay_ticks: 3, ..none }, Some(("delay_ticks", 3.0))),
        2 => ("controller-mismatch", HiddenInLoop { gain_error: [0.3, 0.0], ..none }, None),
        3 => ("backlash", HiddenInLoop { gap_rad: 0.06, ..none }, Some(("gap_rad", 0.06))),
        _ => ("reversal-miscount", HiddenInLoop { miscount: 2, ..none }, Some(("counts_per_reversal", 2.0))),
    };
    let tick = |r: &crate::tracking::Row| Tick {
        time_us: r.time_us,
        target: r.target,
        position: r.position,
        u: r.u,
        duty: r.duty,
        direction: r.direction,
    };
    let run = |(k, rows): (usize, Vec<crate::tracking::Row>)| Run {
        id: format!("sine{k}"),
        duty: 0.0,
        sign: 0.0,
        pwm_hz: PWM_HZ,
        drive_on_s: 6.0,
        order: k,
        aligned: false,
        record: Record::Control { law: "\"thesis\"".to_owned(), ticks: rows.iter().map(tick).collect() },
    };
    let runs = sines(&fault, seed).into_iter().enumerate().map(run).collect();
    let told = Hidden {
        name: name.to_owned(),
        form: "formula".to_owned(),
        size: number.map_or(0.0, |(_, v)| v),
        rho: 0.0,
        parameters: number.into_iter().map(|(k, v)| (k.to_owned(), v)).collect(),
        coordinate: None,
    };
    let effects = if name == "nothing" { Vec::new() } else { vec![told] };
    let truth = Truth { effects, ..nothing(seed, Kind::Closed) };
    Made { folder: Folder { name: format!("sines {seed}"), edges_per_rev: EDGES as u32, runs }, truth }
}
