//! Known motions to try estimators on: what a sampled and a timestamping encoder would have seen of them.

use super::edges::{Directions, EdgeTrain};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use twum_record::measurement::{Direction, LevelEdge};

/// Edges a revolution of the trials' encoder.
pub const EDGES_PER_REV: u32 = 400;
/// Sampling period of the trials' level records, in µs.
pub const PERIOD_US: f64 = 1000.0;
/// Uncertainty of the trials' edge times, in µs: a 1 µs timer.
pub const TIME_UNCERTAINTY_US: f64 = 0.5;
/// Step of the integration, in s.
const STEP_S: f64 = 2e-5;
/// When a motion from rest starts, in s.
const START_S: f64 = 0.02;

/// A motion with a known speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// Constant speed.
    Steady {
        /// Speed.
        rpm: f64,
    },
    /// From standstill at 20 ms, past the final speed and down to it, as the real motor starts: rise in some 5 ms, 40 %
    /// over, settled after some 100 ms.
    StartUp {
        /// Final speed.
        rpm: f64,
    },
    /// A speed that varies twice a turn by ±15 %, a slower fall within the record of 3 %.
    Ripple {
        /// Mean speed.
        rpm: f64,
    },
    /// From `rpm` to `-rpm` in the middle of the record, with a time constant of 5 ms.
    Reversal {
        /// Speed before.
        rpm: f64,
    },
}

impl Motion {
    /// The motions of the table in `docs/signals.md`.
    pub fn all() -> Vec<Self> {
        let steady = [2.03, 5.07, 10.3, 20.7, 30.9, 45.4, 59.3].map(|rpm| Self::Steady { rpm });
        let start = [15.0, 35.0, 50.0].map(|rpm| Self::StartUp { rpm });
        let ripple = [10.0, 35.0, 50.0].map(|rpm| Self::Ripple { rpm });
        let reversal = [15.0, 35.0, 50.0].map(|rpm| Self::Reversal { rpm });
        steady.into_iter().chain(start).chain(ripple).chain(reversal).collect()
    }

    /// Speed in rpm at a time (s) and an angle (rad).
    fn rpm(self, time_s: f64, angle_rad: f64, length_s: f64, phase_rad: f64) -> f64 {
        match self {
            Self::Steady { rpm } => rpm,
            Self::StartUp { rpm } => {
                let t = time_s - START_S;
                if t <= 0.0 { 0.0 } else { rpm * (1.0 - (-t / 0.004).exp()) * (1.0 + 0.6 * (-t / 0.03).exp()) }
            }
            Self::Ripple { rpm } => {
                rpm * (1.0 + 0.15 * (2.0 * angle_rad - phase_rad).cos()) * (1.0 - 0.03 * time_s / length_s)
            }
            Self::Reversal { rpm } => {
                let t = time_s - length_s / 2.0;
                if t <= 0.0 { rpm } else { rpm * (2.0 * (-t / 0.005).exp() - 1.0) }
            }
        }
    }
}

impl std::fmt::Display for Motion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Steady { rpm } => write!(f, "steady {rpm} rpm"),
            Self::StartUp { rpm } => write!(f, "start-up to {rpm} rpm"),
            Self::Ripple { rpm } => write!(f, "ripple about {rpm} rpm"),
            Self::Reversal { rpm } => write!(f, "reversal at {rpm} rpm"),
        }
    }
}

/// How an encoder and its capture depart from equal spacing and exact times.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Encoder {
    /// Standard deviation of each boundary from equal spacing, the same every turn, in pitches.
    pub irregularity_pitch: f64,
    /// Shift of the odd boundaries against the even ones, in pitches.
    pub odd_shift_pitch: f64,
    /// Samples are taken up to this early or late, in µs.
    pub sample_jitter_us: f64,
    /// Edges are stamped up to this late or early, in µs.
    pub time_jitter_us: f64,
}

impl Encoder {
    /// Without a fault.
    pub const IDEAL: Self =
        Self { irregularity_pitch: 0.0, odd_shift_pitch: 0.0, sample_jitter_us: 0.0, time_jitter_us: 0.0 };
    /// Worse than a good one: 2 % of a pitch irregular, the line high for 54 % of the time, samples 50 µs and edges 5 µs
    /// off.
    pub const ROUGH: Self =
        Self { irregularity_pitch: 0.02, odd_shift_pitch: 0.08, sample_jitter_us: 50.0, time_jitter_us: 5.0 };

    /// The boundaries of one turn, from their equally spaced places, in pitches.
    fn boundaries(&self, random: &mut ChaCha8Rng) -> Vec<f64> {
        (0..EDGES_PER_REV)
            .map(|b| {
                // Twelve uniform numbers make a normal one, within six deviations.
                let normal: f64 = (0..12).map(|_| random.random_range(-0.5..0.5)).sum();
                let side = if b % 2 == 1 { 0.5 } else { -0.5 };
                self.irregularity_pitch * normal + side * self.odd_shift_pitch
            })
            .collect()
    }
}

/// A motion carried out once, at a phase of the encoder and of the ripple drawn from a seed.
#[derive(Debug, Clone)]
pub struct Trial {
    length_s: f64,
    speed_rpm: Vec<f64>,
    position_rad: Vec<f64>,
    levels: Vec<bool>,
    edges: Vec<LevelEdge>,
    directions: Directions,
    /// When the drive of a motion from rest went on.
    drive_on_us: Option<f64>,
}

impl Trial {
    /// Carries out `motion` before an ideal encoder: 3 s, and 10 s below 10 rpm.
    pub fn new(motion: Motion, seed: u64) -> Self {
        Self::before(Encoder::IDEAL, motion, seed)
    }

    /// Carries out `motion` before an encoder: 3 s, and 10 s below 10 rpm.
    pub fn before(encoder: Encoder, motion: Motion, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let pitch_rad = std::f64::consts::TAU / f64::from(EDGES_PER_REV);
        let start_rad = random.random_range(0.0..1.0) * pitch_rad;
        let phase_rad = random.random_range(0.0..std::f64::consts::TAU);
        let sample_offset_s = random.random_range(0.0..1e-3);
        let length_s = if matches!(motion, Motion::Steady { rpm } if rpm < 10.0) { 10.0 } else { 3.0 };
        let rpm_at = |t: f64, angle: f64| motion.rpm(t, angle, length_s, phase_rad);
        let speed_at = |t: f64, angle: f64| rpm_at(t, angle) / super::RAD_S_TO_RPM;
        // The record's clock starts with its first sample.
        let record_us = |t: f64| (t - sample_offset_s) * 1e6;
        let offsets = encoder.boundaries(&mut random);
        let place = |b: i64| (b as f64 + offsets[b.rem_euclid(i64::from(EDGES_PER_REV)) as usize]) * pitch_rad;
        let cell = |angle: f64| {
            let mut cell = (angle / pitch_rad).floor() as i64;
            while angle >= place(cell + 1) {
                cell += 1;
            }
            while angle < place(cell) {
                cell -= 1;
            }
            cell
        };
        let mut late = |most_us: f64| if most_us > 0.0 { random.random_range(-most_us..most_us) } else { 0.0 };

        let mut trial = Self {
            length_s,
            speed_rpm: Vec::new(),
            position_rad: Vec::new(),
            levels: Vec::new(),
            edges: Vec::new(),
            directions: Directions::constant(Direction::Cw),
            drive_on_us: matches!(motion, Motion::StartUp { .. }).then(|| record_us(START_S)),
        };
        let (mut angle, mut next_sample_s) = (start_rad, sample_offset_s);
        for i in 0..(length_s / STEP_S).round() as usize {
            let t = i as f64 * STEP_S;
            // Midpoint rule: its error over a step is far below a millionth of a pitch.
            let half = angle + 0.5 * STEP_S * speed_at(t, angle);
            let next = angle + STEP_S * speed_at(t + 0.5 * STEP_S, half);
            let turned_back = rpm_at(t + STEP_S, next) < 0.0;
            if turned_back && rpm_at(t, angle) >= 0.0 {
                trial.directions = Directions::changing(Direction::Cw, &[(record_us(t), Direction::Ccw)]);
            }
            if next_sample_s < t + STEP_S {
                let at = angle + (next_sample_s - t) / STEP_S * (next - angle);
                let sampled_at = at + late(encoder.sample_jitter_us) * 1e-6 * (next - angle) / STEP_S;
                trial.levels.push(cell(sampled_at).rem_euclid(2) == 1);
                trial.position_rad.push(at);
                trial.speed_rpm.push(rpm_at(next_sample_s, at));
                next_sample_s = sample_offset_s + trial.levels.len() as f64 * PERIOD_US * 1e-6;
            }
            if cell(next) != cell(angle) {
                let boundary = place(cell(next).max(cell(angle)));
                let at_s = t + STEP_S * (boundary - angle) / (next - angle);
                let time_us = (record_us(at_s) + late(encoder.time_jitter_us)).round();
                trial.edges.push(LevelEdge { time_us, level: cell(next).rem_euclid(2) == 1 });
            }
            angle = next;
        }
        trial.edges.retain(|e| e.time_us > 0.0);
        trial
    }

    /// Number of level samples.
    pub fn samples(&self) -> usize {
        self.levels.len()
    }

    /// The true speed at each sample, in rpm.
    pub fn speed_rpm(&self) -> &[f64] {
        &self.speed_rpm
    }

    /// The true position at each sample, in rad.
    pub fn position_rad(&self) -> &[f64] {
        &self.position_rad
    }

    /// The encoder line, sampled every [`PERIOD_US`] from time 0.
    pub fn levels(&self) -> &[bool] {
        &self.levels
    }

    /// The direction pin; it changes when the rotor does.
    pub fn directions(&self) -> &Directions {
        &self.directions
    }

    /// The edges as [`Trial::levels`] shows them.
    pub fn sampled(&self) -> EdgeTrain {
        let train = EdgeTrain::from_levels(0.0, PERIOD_US, &self.levels, EDGES_PER_REV, &self.directions)
            .expect("period and edges are constants above zero");
        self.started_from_rest(train)
    }

    /// The edges with times of their own, to 1 µs.
    pub fn timestamped(&self) -> EdgeTrain {
        let end_us = self.length_s * 1e6;
        let train =
            EdgeTrain::from_times(0.0, end_us, &self.edges, TIME_UNCERTAINTY_US, EDGES_PER_REV, &self.directions)
                .expect("the motions leave whole microseconds between edges");
        self.started_from_rest(train)
    }

    /// A bench knows when it switched the drive on.
    fn started_from_rest(&self, train: EdgeTrain) -> EdgeTrain {
        match self.drive_on_us {
            Some(time_us) => train.at_rest_until(time_us),
            None => train,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steady motion has a closed form: edge n at (n − phase) pitch / speed, so equal intervals.
    #[test]
    fn a_steady_motion_has_equal_intervals() {
        let trial = Trial::new(Motion::Steady { rpm: 30.9 }, 3);
        let interval_us = 60e6 / 30.9 / f64::from(EDGES_PER_REV);
        let train = trial.timestamped();
        for (n, edge) in train.edges.iter().enumerate() {
            let due = train.edges[0].middle_us() + n as f64 * interval_us;
            assert!((edge.middle_us() - due).abs() <= 1.01, "edge {n}");
        }
    }

    /// The ripple's angle has a closed form without the slow fall: a turn takes 60 / (rpm √(1 − 0.15²)) s.
    #[test]
    fn a_rippling_turn_takes_its_time() {
        let trial = Trial::new(Motion::Ripple { rpm: 35.0 }, 5);
        let turned = trial.position_rad()[trial.samples() - 1] - trial.position_rad()[0];
        let mean_rpm = 35.0 * (1.0 - 0.15_f64 * 0.15).sqrt() * (1.0 - 0.015);
        let turns = turned / std::f64::consts::TAU;
        assert!((turns - mean_rpm / 60.0 * 3.0).abs() < 0.03, "{turns}");
    }

    #[test]
    fn sampled_and_timestamped_edges_are_the_same_crossings() {
        for motion in Motion::all() {
            let trial = Trial::new(motion, 11);
            let (sampled, timed) = (trial.sampled(), trial.timestamped());
            for (s, t) in sampled.edges.iter().zip(&timed.edges) {
                assert!((s.middle_us() - t.middle_us()).abs() <= 501.0, "{motion}");
                assert_eq!(s.boundary, t.boundary, "{motion}");
            }
            assert!(timed.edges.len() - sampled.edges.len() <= 1, "{motion}");
        }
    }
}
