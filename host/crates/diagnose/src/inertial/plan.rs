//! The next runs of an ordinary motor, as inputs in its own unit.

use super::conclude::InertialOutcome;
use super::effects::{Coordinate, EFFECTS};
use crate::finding::Status;

/// Straight piece of an input.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Piece {
    /// Input at its beginning, in the record's unit.
    pub from: f64,
    /// Input at its end.
    pub to: f64,
    /// Length in s.
    pub seconds: f64,
}

/// A run worth making.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct InputRun {
    /// Identifier.
    pub id: &'static str,
    /// What it decides.
    pub why: String,
    /// Time between samples in s that shows it.
    pub sample_s: f64,
    /// Its input, one piece after another.
    pub pieces: Vec<Piece>,
}

impl InputRun {
    /// In words.
    pub fn text(&self) -> String {
        let piece = |p: &Piece| match p.from == p.to {
            true => format!("{:.4} for {:.3} s", p.to, p.seconds),
            false => format!("{:.4} to {:.4} in {:.3} s", p.from, p.to, p.seconds),
        };
        let pieces: Vec<String> = self.pieces.iter().map(piece).collect();
        format!("{}: input {}; a sample every {:.5} s\n  {}", self.id, pieces.join(", "), self.sample_s, self.why)
    }
}

/// Lags of a piece in which a motor comes to its speed, and in which a sweep is slow.
const SETTLED: f64 = 6.0;
const SLOW: f64 = 100.0;
/// Samples a lag that show how a motor stops, and how a step begins.
const FINE: f64 = 50.0;
const FINEST: f64 = 200.0;

/// The runs that would decide what is open.
pub fn next_inputs(outcome: &InertialOutcome, replicated: bool) -> Vec<InputRun> {
    let lag = outcome.fitted.as_ref().map_or(0.1, |f| f.plant.lag_s());
    let run = |id, why: &str, samples: f64, lags: f64, levels: &[[f64; 2]]| InputRun {
        id,
        why: why.to_owned(),
        sample_s: lag / samples,
        pieces: levels
            .iter()
            .map(|[from, to]| {
                let [from, to] = [from, to].map(|v| v * outcome.data.largest_input);
                Piece { from, to, seconds: lags * lag }
            })
            .collect(),
    };
    let open = |at: Coordinate| {
        let effects = EFFECTS.iter().filter(|e| e.coordinate == at);
        let mut names = effects.map(|e| e.name);
        names.any(|n| {
            outcome.findings.iter().any(|f| f.name == n && f.status == Status::Ambiguous)
                || outcome.not_judged.iter().any(|j| j.0 == n)
        })
    };
    let mut plan = Vec::new();
    if open(Coordinate::Rest) {
        let levels = [[1.0, 1.0], [0.0, 0.0], [-1.0, -1.0], [0.0, 0.0]];
        let why =
            "friction brakes a motor to a stop in a straight line, a dead zone lets it coast along an exponential";
        plan.push(run("run-down", why, FINE, SETTLED, &levels));
        let levels = [[0.0, 0.5], [0.5, 0.0], [0.0, -0.5], [-0.5, 0.0]];
        let why = "friction with a peak at rest lets the motor start later than it stops";
        plan.push(run("slow-sweep", why, FINE / 10.0, SLOW, &levels));
    }
    if open(Coordinate::Direction) {
        let why =
            "then the same with the motor mounted the other way round: a load changes sides, an asymmetry does not";
        plan.push(run("both-ways", why, FINE / 10.0, SLOW, &[[0.0, 1.0], [1.0, -1.0], [-1.0, 0.0]]));
    }
    if open(Coordinate::Top) {
        let why = "with the supply's voltage logged beside it: a sag is in the supply, a saturation is not";
        plan.push(run("to-the-top", why, FINE / 10.0, SLOW, &[[0.0, 1.0], [1.0, 0.0]]));
    }
    if open(Coordinate::Time) {
        let levels = [[0.0, 0.0], [0.6, 0.6], [0.0, 0.0], [-0.6, -0.6]];
        let why =
            "a dead time shows a flat beginning, a second lag a rounded one, a load on a coupling swings after it";
        plan.push(run("fast-steps", why, FINEST, SETTLED, &levels));
    }
    if outcome.unknown.iter().any(|u| u.lives_in.starts_with("angle")) {
        let why =
            "slowly through some turns each way, with the angle recorded: what belongs to the angle comes back at it";
        plan.push(run("slow-turns", why, FINE, SLOW, &[[0.2, 0.2], [-0.2, -0.2]]));
    }
    if !replicated {
        let levels = [0.4, 1.0, -0.3, 0.7, -1.0, 0.2, -0.6, 0.0].map(|v| [v, v]);
        let why = "three times the same: what is found in one run only is not replicated";
        plan.push(run("levels", why, FINE / 2.0, SETTLED, &levels));
    }
    plan
}
