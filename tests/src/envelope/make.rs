//! One data set from one seed.

use super::bench::Bench;
use super::effects::{Effect, LIBRARY, OUTSIDE};
use super::loops;
use super::motor::Motor;
use super::scene::{LEAST_RHO, Scene, View};
use crate::profile::random::Dice;
use crate::truth::{Kind, Made, Request};
use crate::twins::twins;

/// Motors and benches drawn until one shows what is wanted.
const DRAWS: u64 = 50;

/// Makes the data set of a seed.
///
/// # Errors
/// An effect this generator does not know, or one that shows on none of the benches drawn.
pub fn make(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return loops::make(seed, request);
    }
    let (scene, view, hidden) = arranged(seed, request)?;
    Ok(scene.made(seed, request.kind, &hidden, &view))
}

/// The same with nothing hidden: same motor, bench and noise.
///
/// # Errors
/// As [`make`].
pub fn without(seed: u64, request: &Request) -> Result<Made, String> {
    if request.kind == Kind::Closed {
        return loops::make(seed, &Request { effects: vec!["none".to_owned()], ..request.clone() });
    }
    let (scene, view, _) = arranged(seed, request)?;
    Ok(scene.made(seed, Kind::Null, &[], &view))
}

/// Which effects a seed stands for.
fn wanted(seed: u64, request: &Request) -> Vec<String> {
    let library = LIBRARY.len() as u64;
    let name = |k: u64| LIBRARY[(k % library) as usize].0;
    match request.kind {
        _ if !request.effects.is_empty() => request.effects.clone(),
        Kind::Null | Kind::Closed => Vec::new(),
        Kind::Single | Kind::Removed => vec![name(seed).to_owned()],
        Kind::Outside => vec![OUTSIDE[(seed % OUTSIDE.len() as u64) as usize].0.to_owned()],
        Kind::Pair => {
            // The second stands 1 to 15 places further on, at the next that does not do the same to the data.
            let mut far = 1 + (seed / library) % (library - 1);
            while name(seed) == name(seed + far) || twins(name(seed), name(seed + far)) {
                far += 1;
            }
            vec![name(seed).to_owned(), name(seed + far).to_owned()]
        }
    }
}

fn arranged(seed: u64, request: &Request) -> Result<(Scene, View, Vec<Effect>), String> {
    let names = wanted(seed, request);
    let kind = request.kind.word();
    let mut strengths = Dice::new(seed, "e strengths");
    for draw in 0..DRAWS {
        let mut dice = Dice::new(seed, &format!("e {kind} {draw}"));
        let motor = Motor::draw(&mut dice);
        let bench = Bench::draw(&mut dice, motor.full);
        let noise = Dice::new(seed, &format!("e {kind} {draw} noise")).whole(0, u32::MAX as usize);
        let scene = Scene { motor, bench, seed: noise as u64 };
        if names.is_empty() {
            let view = scene.view(&scene.kept(), 0);
            return Ok((scene, view, Vec::new()));
        }
        if !names.iter().all(|n| scene.bench.could_show(n)) {
            continue;
        }
        if let Some((view, hidden)) = hidden(&scene, &names, request.rho, &mut dice, &mut strengths)? {
            return Ok((scene, view, hidden));
        }
    }
    Err(format!("seed {seed}: {} shows on none of {DRAWS} benches", names.join(" and ")))
}

/// Effects of the names as strong as drawn, or as `asked`, and all runs of the scene refitted; nothing where one does not show.
fn hidden(
    scene: &Scene,
    names: &[String],
    asked: Option<f64>,
    dice: &mut Dice,
    strengths: &mut Dice,
) -> Result<Option<(View, Vec<Effect>)>, String> {
    let some = scene.view(&scene.some(), Motor::PARAMETERS);
    let mut found = Vec::new();
    for name in names {
        let effect = Effect::draw(name, dice).ok_or_else(|| format!("no effect {name}"))?;
        // Evenly in the logarithm, from what is just beyond the noise to what nobody would overlook.
        let rho = asked.unwrap_or_else(|| strengths.decade(1.1, 8.0));
        let Some(fitted) = some.fitted(scene, effect, rho, asked.is_some()) else { return Ok(None) };
        found.push(fitted);
    }
    // Some runs are not all: what is too weak in all of them is not hidden, and what is far too strong is another case.
    let all = scene.view(&scene.kept(), Motor::PARAMETERS);
    let bounds = asked.map_or([LEAST_RHO, 12.0], |rho| [0.8 * rho, 1.5 * rho]);
    let shown = found.iter().all(|e| (bounds[0]..bounds[1]).contains(&all.rho(scene, e)));
    Ok(shown.then_some((all, found)))
}
