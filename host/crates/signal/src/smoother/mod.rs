//! Position and speed from edges by a smoother that takes each edge for what it is: a crossing within a known interval.
//!
//! The rotor's acceleration is a random walk, driven by a noise whose strength changes with time. Three steps, repeated
//! [`ROUNDS`] times, lead from the edges to position, speed and their standard deviations at any time:
//!
//! 1. **How fast does the speed change?** A bank of Kalman filters, one a strength, that mix as in the interacting
//!    multiple model filter (Blom and Bar-Shalom, IEEE Trans. Autom. Control 33, 1988) runs over the edges forwards and
//!    backwards; the product of both probabilities gives the expected strength between each two edges. A start or
//!    a reversal gets a short memory, steady running a long one.
//! 2. **Smoothing** with these strengths by the modified Bryson-Frazier recursion (Bierman, Automatica 9, 1973). An edge
//!    measures the angle of its boundary with the variance that the width of its interval has at the speed found, and
//!    that of the encoder's irregularity.
//! 3. **What no edge says.** In a long gap the rotor is known to lie between two boundaries. The Gaussian that stands
//!    for this statement at a time is found by expectation propagation (Minka, Uncertainty in Artificial
//!    Intelligence, 2001). So a rotor at rest is seen to rest.
//!
//! Between rounds the encoder's own errors are read off the residuals: how irregular its boundaries are, and by how much
//! odd boundaries are shifted against even ones (a line that is high for longer than it is low).

mod cell;
mod kalman;
mod strength;

use super::edges::EdgeTrain;
use super::{RAD_S_TO_RPM, SignalError};
use kalman::{Angle, Change, Gaussian, first_angle, smoothed};

/// Rounds of strength, smoothing and encoder errors.
pub const ROUNDS: usize = 3;
/// Within gaps between edges, a statement about the cell is made every this many seconds.
const CELL_EVERY_S: f64 = 0.02;
/// Sweeps of expectation propagation a round, and the share of each update that is taken over (all at once, neighbours
/// overshoot).
const SWEEPS: usize = 3;
const DAMPING: f64 = 0.6;
/// Standard deviation assumed of the boundaries from equal spacing in the first round, in pitches, rather too large (an
/// irregularity taken for a change of speed is not found again); bounds of what is
/// found after it.
const FIRST_IRREGULARITY: f64 = 0.03;
const IRREGULARITY_RANGE: (f64, f64) = (2e-4, 0.2);
/// Fewer edges do not show the encoder's errors.
const EDGES_FOR_ENCODER_ERRORS: usize = 40;

/// What the smoother found.
#[derive(Debug, Clone, PartialEq)]
pub struct Smoothed {
    /// The times asked for, in µs.
    pub time_us: Vec<f64>,
    /// Position from the boundary below the rotor at the start of the record, in rad.
    pub position_rad: Vec<f64>,
    /// Standard deviation of the position, in rad.
    pub position_sd_rad: Vec<f64>,
    /// Speed, in rpm, signed.
    pub speed_rpm: Vec<f64>,
    /// Standard deviation of the speed, in rpm.
    pub speed_sd_rpm: Vec<f64>,
    /// Standard deviation of the boundaries from equal spacing, in pitches.
    pub irregularity_pitch: f64,
    /// Shift of the odd boundaries against the even ones, in pitches.
    pub odd_shift_pitch: f64,
}

/// Smooths the edges and gives position and speed at `at_us` (ascending, in µs).
///
/// # Errors
/// [`SignalError::Time`] when `at_us` does not ascend.
pub fn smooth(train: &EdgeTrain, at_us: &[f64]) -> Result<Smoothed, SignalError> {
    let ascends = |w: &[f64]| w[0] <= w[1];
    if let Some(i) =
        at_us.windows(2).position(|w| !ascends(w)).map(|i| i + 1).or(at_us.iter().position(|t| !t.is_finite()))
    {
        return Err(SignalError::Time { index: i, time_us: at_us[i] });
    }
    let mut encoder = Encoder::guessed(train);
    let mut nodes = nodes(train, &encoder);
    let start = match train.rest_until_us {
        Some(_) => Gaussian::at_rest(first_angle(&nodes)),
        None => Gaussian::about(first_angle(&nodes)),
    };
    for round in 0..ROUNDS {
        strength::assign(&mut nodes, start);
        for _ in 0..SWEEPS {
            let states = smoothed(&nodes, start);
            update(&mut nodes, &states, &encoder);
        }
        if round + 1 < ROUNDS && train.edges.len() >= EDGES_FOR_ENCODER_ERRORS {
            encoder.learn(&nodes, &smoothed(&nodes, start));
        }
    }
    // A rotor known to stand still is where it is when the drive goes on.
    let resting = train.rest_until_us.map_or(0, |rest_us| at_us.partition_point(|t| *t <= rest_us));
    let (nodes, wanted) = with_times(nodes, &at_us[resting..]);
    let states = smoothed(&nodes, start);
    let at_rest = std::iter::repeat_n(&states[0], resting);
    let chosen: Vec<&Gaussian> = at_rest.chain(wanted.iter().map(|i| &states[*i])).collect();
    let rpm = train.pitch_rad * RAD_S_TO_RPM;
    let column = |f: &dyn Fn(&Gaussian) -> f64| chosen.iter().map(|g| f(g)).collect::<Vec<f64>>();
    Ok(Smoothed {
        time_us: at_us.to_vec(),
        position_rad: column(&|g| g.mean[0] * train.pitch_rad),
        position_sd_rad: column(&|g| g.cov[(0, 0)].max(0.0).sqrt() * train.pitch_rad),
        speed_rpm: column(&|g| g.mean[1] * rpm),
        speed_sd_rpm: column(&|g| g.cov[(1, 1)].max(0.0).sqrt() * rpm),
        irregularity_pitch: encoder.variance.sqrt(),
        odd_shift_pitch: encoder.odd_shift,
    })
}

/// An instant at which something is known, or wanted.
#[derive(Debug, Clone)]
struct Node {
    /// In s.
    time_s: f64,
    statement: Statement,
    /// The Gaussian that stands for the statement.
    angle: Angle,
    /// How the speed changes between the node before and this one.
    change: Change,
}

/// What the line says about the angle, in pitches.
#[derive(Debug, Clone, Copy)]
enum Statement {
    Nothing,
    /// It crosses this boundary within `half_width_s` of the node's time.
    Crosses {
        boundary: i64,
        half_width_s: f64,
    },
    /// It lies between this boundary and the next.
    InCell(i64),
}

/// The encoder's own errors.
struct Encoder {
    /// Of the boundaries from equal spacing, in pitch².
    variance: f64,
    /// Of the odd boundaries against the even ones, in pitches.
    odd_shift: f64,
}

impl Encoder {
    /// The shift by which each edge comes later than the middle of its neighbours, in their mean interval, and an assumed
    /// irregularity. A fifth of the edges at either extreme, where the speed changes, is left out.
    fn guessed(train: &EdgeTrain) -> Self {
        let mut late = [Vec::new(), Vec::new()];
        for w in train.edges.windows(3).filter(|w| w[0].step == w[1].step && w[1].step == w[2].step) {
            let half_us = 0.5 * (w[2].middle_us() - w[0].middle_us());
            let by = w[1].middle_us() - w[0].middle_us() - half_us;
            late[w[1].boundary.rem_euclid(2) as usize].push(f64::from(w[1].step) * by / half_us);
        }
        let trimmed_mean = |late: &mut Vec<f64>| {
            late.sort_by(f64::total_cmp);
            let kept = &late[late.len() / 5..late.len() - late.len() / 5];
            kept.iter().sum::<f64>() / kept.len().max(1) as f64
        };
        let enough = train.edges.len() >= EDGES_FOR_ENCODER_ERRORS;
        let odd_shift = if enough { 0.5 * (trimmed_mean(&mut late[1]) - trimmed_mean(&mut late[0])) } else { 0.0 };
        Self { variance: FIRST_IRREGULARITY.powi(2), odd_shift: odd_shift.clamp(-0.5, 0.5) }
    }

    /// Where a boundary lies, in pitches.
    fn place(&self, boundary: i64) -> f64 {
        let side = if boundary.rem_euclid(2) == 1 { 0.5 } else { -0.5 };
        boundary as f64 + side * self.odd_shift
    }

    /// The measurement that a crossing makes at a speed, in pitch/s.
    fn crossing(&self, boundary: i64, half_width_s: f64, speed: f64) -> Angle {
        // Variance of what is uniform within ± h: h²/3.
        Angle::new(self.place(boundary), (speed * half_width_s).powi(2) / 3.0 + self.variance)
    }

    /// Reads irregularity and odd shift off what is left between the crossings and the smoothed angle.
    fn learn(&mut self, nodes: &[Node], states: &[Gaussian]) {
        let mut sums = [(0.0, 0.0); 2];
        let (mut square, mut timing, mut count) = (0.0, 0.0, 0.0);
        for (node, g) in nodes.iter().zip(states) {
            let Statement::Crosses { boundary, half_width_s } = node.statement else { continue };
            let residual = self.place(boundary) - g.mean[0];
            let side = &mut sums[boundary.rem_euclid(2) as usize];
            *side = (side.0 + residual, side.1 + 1.0);
            square += residual * residual + g.cov[(0, 0)];
            timing += (g.mean[1] * half_width_s).powi(2) / 3.0;
            count += 1.0;
        }
        let [(even, evens), (odd, odds)] = sums;
        let shift = odd / f64::max(odds, 1.0) - even / f64::max(evens, 1.0);
        // What is left is what the assumed shift has too much.
        self.odd_shift = (self.odd_shift - shift).clamp(-0.5, 0.5);
        let (low, high) = IRREGULARITY_RANGE;
        self.variance = ((square - timing) / count - 0.25 * shift * shift).clamp(low * low, high * high);
    }
}

fn seconds(us: f64) -> f64 {
    us * 1e-6
}

/// The edges, and the cells in the gaps between them.
fn nodes(train: &EdgeTrain, encoder: &Encoder) -> Vec<Node> {
    let edges = &train.edges;
    // The faster of both neighbouring intervals; refined by the first sweep.
    let speed_between = |i: usize| {
        let pair = edges.get(i..i + 2)?;
        let turned = (pair[1].boundary - pair[0].boundary).abs() as f64;
        Some(turned / seconds(pair[1].middle_us() - pair[0].middle_us()))
    };
    // Hours in which nothing moves need no statement every so often: their number is bounded by that of the edges.
    let most = 100_000.0 + 50.0 * edges.len() as f64;
    let every_s = CELL_EVERY_S.max(seconds(train.end_us - train.start_us) / most);
    let mut nodes = Vec::new();
    let (mut from_s, mut cell) = (seconds(train.rest_until_us.unwrap_or(train.start_us)), 0);
    for (i, edge) in edges.iter().enumerate() {
        let half_width_s = 0.5 * seconds(edge.before_us - edge.after_us);
        let time_s = seconds(edge.middle_us());
        add_cells(&mut nodes, cell, (from_s, time_s - half_width_s, every_s), i == 0, false);
        let before = i.checked_sub(1).and_then(speed_between).unwrap_or(0.0);
        let speed = before.max(speed_between(i).unwrap_or(0.0));
        let statement = Statement::Crosses { boundary: edge.boundary, half_width_s };
        let angle = encoder.crossing(edge.boundary, half_width_s, speed);
        nodes.push(Node { time_s, statement, angle, change: Change::Jerk(strength::WEAKEST) });
        (from_s, cell) = (time_s + half_width_s, edge.count_after());
    }
    add_cells(&mut nodes, cell, (from_s, seconds(train.end_us), every_s), edges.is_empty(), true);
    if train.rest_until_us.is_some() {
        nodes[1].change = Change::Kick;
    }
    nodes
}

/// States the cell between two times, so often, and at the ends only if asked for.
fn add_cells(nodes: &mut Vec<Node>, cell: i64, (from_s, to_s, every_s): (f64, f64, f64), at_start: bool, at_end: bool) {
    let parts = ((to_s - from_s) / every_s).ceil().max(1.0) as usize;
    for part in 0..=parts {
        if (part == 0 && at_start) || (part == parts && at_end) || (0 < part && part < parts) {
            let time_s = from_s + (to_s - from_s) * part as f64 / parts as f64;
            // The first state is centred on its cell; later ones start unsaid.
            let angle = if nodes.is_empty() { Angle::new(cell as f64 + 0.5, 1.0 / 12.0) } else { Angle::UNKNOWN };
            nodes.push(Node {
                time_s,
                statement: Statement::InCell(cell),
                angle,
                change: Change::Jerk(strength::WEAKEST),
            });
        }
    }
}

/// Refines the Gaussian of each statement by what all others say.
fn update(nodes: &mut [Node], states: &[Gaussian], encoder: &Encoder) {
    for (node, g) in nodes.iter_mut().zip(states) {
        match node.statement {
            Statement::Nothing => {}
            Statement::Crosses { boundary, half_width_s } => {
                node.angle = encoder.crossing(boundary, half_width_s, g.mean[1]);
            }
            Statement::InCell(cell) => {
                let bounds = (encoder.place(cell), encoder.place(cell + 1));
                if let Some(new) = cell::moments(g.mean[0], g.cov[(0, 0)], node.angle, bounds, encoder.variance) {
                    node.angle = node.angle.towards(new, DAMPING);
                }
            }
        }
    }
}

/// Adds nodes at the times wanted, and says where they are.
fn with_times(nodes: Vec<Node>, at_us: &[f64]) -> (Vec<Node>, Vec<usize>) {
    let mut all = Vec::with_capacity(nodes.len() + at_us.len());
    let mut wanted = Vec::with_capacity(at_us.len());
    let mut times = at_us.iter().map(|us| seconds(*us)).peekable();
    let last_change = nodes.last().map_or(Change::Jerk(strength::WEAKEST), |n| n.change);
    let nothing = |time_s, change| Node { time_s, statement: Statement::Nothing, angle: Angle::UNKNOWN, change };
    for node in nodes {
        while let Some(time_s) = times.next_if(|t| *t < node.time_s) {
            wanted.push(all.len());
            all.push(nothing(time_s, node.change));
        }
        all.push(node);
    }
    for time_s in times {
        wanted.push(all.len());
        all.push(nothing(time_s, last_change));
    }
    (all, wanted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edges::Directions;
    use crate::trial::{Motion, PERIOD_US, Trial};
    use twum_record::measurement::{Direction, LevelEdge};

    fn grid(n: usize) -> Vec<f64> {
        (0..n).map(|i| i as f64 * PERIOD_US).collect()
    }

    fn cw() -> Directions {
        Directions::constant(Direction::Cw)
    }

    #[test]
    fn the_band_holds_the_truth_about_as_often_as_it_says() {
        let (mut inside, mut all) = (0.0, 0.0);
        for motion in [35.3, 12.1].map(|rpm| Motion::Ripple { rpm }).into_iter().chain([Motion::Steady { rpm: 23.7 }]) {
            for seed in 0..3 {
                let trial = Trial::new(motion, seed);
                let got = smooth(&trial.sampled(), &grid(trial.samples())).unwrap();
                for i in 0..trial.samples() {
                    let error = got.speed_rpm[i] - trial.speed_rpm()[i];
                    inside += f64::from(error.abs() <= 1.96 * got.speed_sd_rpm[i]);
                    all += 1.0;
                }
            }
        }
        let share: f64 = inside / all;
        assert!((0.90..=1.0).contains(&share), "95 % band holds {share}");
    }

    #[test]
    fn a_rotor_at_rest_is_seen_to_rest() {
        let quiet = EdgeTrain::from_levels(0.0, 1000.0, &[true; 2000], 400, &cw()).unwrap();
        let got = smooth(&quiet, &grid(2000)).unwrap();
        assert!(got.speed_rpm.iter().all(|v| v.abs() < 0.1));
        // 1 s at 30 rpm, then a second of rest.
        let levels: Vec<bool> = (0..2000).map(|i| (f64::from(i.min(1000)) * 0.2) as i64 % 2 == 1).collect();
        let stopped = EdgeTrain::from_levels(0.0, 1000.0, &levels, 400, &cw()).unwrap();
        let got = smooth(&stopped, &grid(2000)).unwrap();
        assert!((got.speed_rpm[500] - 30.0).abs() < 0.1, "{}", got.speed_rpm[500]);
        assert!(got.speed_rpm[1200..].iter().all(|v| v.abs() < 1.0));
        assert!(got.speed_rpm[1900].abs() < 0.1);
    }

    #[test]
    fn a_lopsided_line_is_recognised_and_does_not_ripple() {
        // 30 rpm with a line that is high for 60 % of its pitch pair.
        let time = |n: f64| (n * 5000.0).round();
        let edges: Vec<LevelEdge> = (1..600)
            .map(|n| LevelEdge { time_us: time(f64::from(n) + if n % 2 == 1 { 0.2 } else { 0.0 }), level: n % 2 == 1 })
            .collect();
        let train = EdgeTrain::from_times(0.0, 3e6, &edges, 0.5, 400, &cw()).unwrap();
        let got = smooth(&train, &grid(3000)).unwrap();
        assert!((got.odd_shift_pitch - 0.2).abs() < 0.01, "{}", got.odd_shift_pitch);
        let worst = got.speed_rpm[100..2900].iter().map(|v| (v - 30.0).abs()).fold(0.0, f64::max);
        assert!(worst < 0.1, "{worst}");
    }

    #[test]
    fn few_edges_and_no_times_are_answered() {
        for count in 0..4 {
            let edges: Vec<LevelEdge> =
                (0..count).map(|i| LevelEdge { time_us: 1e4 * f64::from(i + 1), level: i % 2 == 0 }).collect();
            let train = EdgeTrain::from_times(0.0, 5e4, &edges, 0.5, 400, &cw()).unwrap();
            let got = smooth(&train, &[0.0, 1e4, 1e4, 5e4, 9e4]).unwrap();
            assert!(got.speed_rpm.iter().chain(&got.speed_sd_rpm).all(|v| v.is_finite()), "{count} edges: {got:?}");
            assert!(smooth(&train, &[]).unwrap().speed_rpm.is_empty());
        }
    }

    #[test]
    fn times_out_of_order_are_refused() {
        let train = EdgeTrain::from_levels(0.0, 1000.0, &[true, false], 400, &cw()).unwrap();
        assert!(matches!(smooth(&train, &[1.0, 0.0]), Err(SignalError::Time { index: 1, .. })));
        assert!(matches!(smooth(&train, &[f64::NAN]), Err(SignalError::Time { .. })));
    }
}
