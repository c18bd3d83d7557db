//! References the loop tracks, in integer arithmetic: the same target on the chip, on the simulated board and in the
//! neck simulator. Time is µs since the reference started, positions are counts, rates counts/s.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Most way points a path may have.
pub const MAX_WAY_POINTS: usize = 16;

/// Where a path has to be, and how long it takes to get there from the way point before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WayPoint {
    /// Position at the way point, counts.
    pub position: i32,
    /// Time from the way point before (from the start, for the first), µs. Equal positions make a hold.
    pub duration_us: u32,
}

/// A wanted motion.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reference {
    /// `amplitude · sin(ω·t)`, truncated towards zero as the thesis's test does (C.2: 89 counts, 1.257 rad/s).
    Sine {
        /// Amplitude, counts.
        amplitude: i32,
        /// Angular frequency, µrad/s.
        omega_urad_s: u32,
    },
    /// Zero until `at_us`, then `position`.
    Step {
        /// Position after the step, counts.
        position: i32,
        /// When the step comes, µs.
        at_us: u32,
    },
    /// A constant rate up to a limit, then rest.
    Ramp {
        /// Rate, counts/s; its sign is the direction.
        rate: i32,
        /// Where the ramp ends: counts from zero, without sign.
        limit: u32,
    },
    /// Quintics through way points, with zero velocity and acceleration at each; starts at position zero unless `start`
    /// says otherwise and rests at the last way point.
    Path {
        /// Position at t = 0, counts.
        start: i32,
        /// The way points, in order.
        way_points: Vec<WayPoint, MAX_WAY_POINTS>,
    },
}

/// Why a reference cannot be tracked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum ReferenceError {
    /// Positions beyond ±2^24 counts.
    #[error("reference position is beyond 16777216 counts")]
    Position,
    /// Faster than 100 rad/s of phase.
    #[error("reference frequency is above 100 rad/s")]
    Frequency,
    /// A path without way points.
    #[error("a path needs at least one way point")]
    Empty,
    /// A move that takes no time.
    #[error("way point {0} moves in no time; give it a duration")]
    NoTime(u8),
}

/// Position and rate wanted at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Target {
    /// Wanted position, counts.
    pub position: i32,
    /// What it lies beyond that, 1/128 count: between one count less and one more, cut towards zero.
    pub fraction: i8,
    /// Wanted rate, counts/s.
    pub rate: i32,
}

const POSITION_LIMIT: u32 = 1 << 24;
const OMEGA_LIMIT_URAD_S: u32 = 100_000_000;

impl Reference {
    /// Checks the bounds within which [`Reference::at`] is exact.
    ///
    /// # Errors
    /// Says which bound is broken.
    pub fn validate(&self) -> Result<(), ReferenceError> {
        let inside = |position: u32| if position <= POSITION_LIMIT { Ok(()) } else { Err(ReferenceError::Position) };
        match self {
            Self::Sine { amplitude, omega_urad_s } => {
                inside(amplitude.unsigned_abs())?;
                if *omega_urad_s > OMEGA_LIMIT_URAD_S { Err(ReferenceError::Frequency) } else { Ok(()) }
            }
            Self::Step { position, .. } => inside(position.unsigned_abs()),
            Self::Ramp { limit, .. } => inside(*limit),
            Self::Path { start, way_points } => {
                inside(start.unsigned_abs())?;
                if way_points.is_empty() {
                    return Err(ReferenceError::Empty);
                }
                let mut from = *start;
                for (index, point) in way_points.iter().enumerate() {
                    inside(point.position.unsigned_abs())?;
                    if point.duration_us == 0 && point.position != from {
                        return Err(ReferenceError::NoTime(index as u8));
                    }
                    from = point.position;
                }
                Ok(())
            }
        }
    }

    /// The target `elapsed_us` after the start. Total: an unvalidated reference gives a saturated target, never a panic.
    pub fn at(&self, elapsed_us: u64) -> Target {
        match self {
            Self::Sine { amplitude, omega_urad_s } => sine(*amplitude, *omega_urad_s, elapsed_us),
            Self::Step { position, at_us } => {
                Target { position: if elapsed_us >= u64::from(*at_us) { *position } else { 0 }, fraction: 0, rate: 0 }
            }
            Self::Ramp { rate, limit } => ramp(*rate, *limit, elapsed_us),
            Self::Path { start, way_points } => path(*start, way_points, elapsed_us),
        }
    }
}

fn saturated(value: i64) -> i32 {
    value.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
}

/// What lies between a position in 2^-30 counts and its whole counts, less than one away, in 1/128.
fn fraction(exact: i64, whole: i64) -> i8 {
    (exact.wrapping_sub(whole << 30) / (1 << 23)) as i8
}

fn ramp(rate: i32, limit: u32, elapsed_us: u64) -> Target {
    let travelled = u64::from(rate.unsigned_abs()).saturating_mul(elapsed_us);
    let done = travelled / 1_000_000 >= u64::from(limit);
    let distance = (travelled / 1_000_000).min(u64::from(limit)) as i64;
    let fraction = if done { 0 } else { (travelled % 1_000_000 * 128 / 1_000_000) as i32 * rate.signum() };
    Target {
        position: saturated(distance * i64::from(rate.signum())),
        fraction: fraction as i8,
        rate: if done { 0 } else { rate },
    }
}

/// 2^64 / (2π·10^12) × 10^4: what one (µrad/s)·µs adds to a phase of 2^64 a turn, scaled to keep its digits.
const PHASE_PER_URAD_S_US_1E4: u64 = 29_358_905_033;

fn sine(amplitude: i32, omega_urad_s: u32, elapsed_us: u64) -> Target {
    // The phase is a fraction of a turn in 64 bits, so its product with time wraps exactly where the sine does.
    let omega = u64::from(omega_urad_s.min(OMEGA_LIMIT_URAD_S));
    let increment = omega * PHASE_PER_URAD_S_US_1E4 / 10_000;
    let phase = increment.wrapping_mul(elapsed_us);
    let amplitude_wide = i64::from(amplitude);
    let exact = amplitude_wide * sin_q30(phase);
    let position = exact / (1 << 30);
    let cosine = sin_q30(phase.wrapping_add(1 << 62));
    // Three factors overflow 64 bits: the peak rate first, in counts/s.
    let peak_rate = saturated(amplitude_wide * omega as i64 / 1_000_000);
    let rate = i64::from(peak_rate) * cosine / (1 << 30);
    Target { position: saturated(position), fraction: fraction(exact, position), rate: saturated(rate) }
}

/// `sin(2π·phase/2^64)` in Q30, to 4e-9: the odd polynomial of degree 9 that fits `sin(x·π/2)` on [0, 1] in the
/// least-squares sense at Chebyshev nodes, with its value at 1 held at 1.
fn sin_q30(phase: u64) -> i64 {
    let quarter = phase >> 62;
    let within = ((phase << 2) >> 34) as i64;
    let x = if quarter & 1 == 0 { within } else { (1 << 30) - within };
    let square = (x * x) >> 30;
    let mut sum = SINE[4];
    for coefficient in [SINE[3], SINE[2], SINE[1], SINE[0]] {
        sum = coefficient + ((sum * square) >> 30);
    }
    let magnitude = ((sum * x) >> 30).clamp(0, 1 << 30);
    if quarter & 2 == 0 { magnitude } else { -magnitude }
}

/// Q30 coefficients of x, x³, x⁵, x⁷, x⁹; `shared/scripts/sine_coefficients.py` prints them.
const SINE: [i64; 5] = [1_686_629_678, -693_597_909, 85_564_899, -5_016_746, 161_902];

fn path(start: i32, way_points: &[WayPoint], elapsed_us: u64) -> Target {
    let mut from = start;
    let mut begin = 0u64;
    for point in way_points {
        let end = begin.saturating_add(u64::from(point.duration_us));
        if elapsed_us < end {
            return quintic(from, point.position, (elapsed_us - begin) as u32, point.duration_us);
        }
        (from, begin) = (point.position, end);
    }
    Target { position: from, fraction: 0, rate: 0 }
}

/// `s(τ) = 10τ³ - 15τ⁴ + 6τ⁵`, the quintic with zero velocity and acceleration at both ends (thesis A.8.1 with V = A = 0).
fn quintic(from: i32, to: i32, elapsed_us: u32, duration_us: u32) -> Target {
    let tau = ((u64::from(elapsed_us) << 30) / u64::from(duration_us.max(1))) as i64;
    let times = |a: i64, b: i64| (a * b) >> 30;
    let square = times(tau, tau);
    let cube = times(square, tau);
    let shape = times(cube, (10 << 30) - 15 * tau + 6 * square);
    // s'(τ) = 30 τ² (1-τ)²
    let rest = (1 << 30) - tau;
    let slope = 30 * times(square, times(rest, rest));
    let distance = i64::from(to) - i64::from(from);
    let exact = distance * shape;
    let rounded = (exact + (1 << 29)) >> 30;
    // Q30 slope over the duration: through counts/s·µs, to stay inside 64 bits for moves below 2^25 counts.
    let rate = ((distance * slope) >> 30) * 1_000_000 / i64::from(duration_us.max(1));
    Target { position: saturated(i64::from(from) + rounded), fraction: fraction(exact, rounded), rate: saturated(rate) }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    /// An interpreter (Miri) looks at every 97th point of a long row only.
    const STRIDE: usize = if cfg!(miri) { 97 } else { 1 };

    #[test]
    fn sine_is_the_thesis_test_within_the_last_count() {
        let reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
        let mut different = 0;
        for millisecond in (0..60_000u64).step_by(STRIDE) {
            let exact = (89.0 * (1.257 * millisecond as f64 / 1e3).sin()) as i32;
            let ours = reference.at(millisecond * 1000);
            assert!((ours.position - exact).abs() <= 1);
            different += i32::from(ours.position != exact);
            let rate = 89.0 * 1.257 * (1.257 * millisecond as f64 / 1e3).cos();
            assert!((f64::from(ours.rate) - rate).abs() < 2.0, "{millisecond} ms: {} against {rate}", ours.rate);
        }
        assert!(different <= 6, "{different} of 60000 milliseconds truncate the other way");
    }

    #[test]
    fn sine_keeps_its_phase_for_days() {
        let reference = Reference::Sine { amplitude: 1 << 24, omega_urad_s: 1_257_000 };
        let seconds = 3.0 * 86_400.0;
        let exact = f64::from(1 << 24) * (1.257f64 * seconds).sin();
        let ours = reference.at((seconds * 1e6) as u64).position;
        assert!((f64::from(ours) - exact).abs() < 2.0 + f64::from(1 << 24) * 1e-5, "{ours} against {exact}");
    }

    #[test]
    fn sine_is_accurate_to_four_billionths() {
        for index in (0..100_000u64).step_by(STRIDE) {
            let phase = index.wrapping_mul(u64::MAX / 100_000);
            let exact = (core::f64::consts::TAU * phase as f64 / 2f64.powi(64)).sin();
            let ours = sin_q30(phase) as f64 / f64::from(1 << 30);
            assert!((ours - exact).abs() < 1.2e-8, "phase {phase}: {ours} against {exact}");
        }
    }

    #[test]
    fn path_meets_its_way_points_at_rest() {
        let way_points = Vec::from_slice(&[
            WayPoint { position: 100, duration_us: 3_000_000 },
            WayPoint { position: 100, duration_us: 5_000_000 },
            WayPoint { position: -50, duration_us: 3_000_000 },
        ])
        .unwrap();
        let path = Reference::Path { start: 20, way_points };
        assert_eq!(path.validate(), Ok(()));
        assert_eq!(path.at(0), Target { position: 20, fraction: 0, rate: 0 });
        assert_eq!(path.at(3_000_000), Target { position: 100, fraction: 0, rate: 0 });
        assert_eq!(path.at(6_000_000), Target { position: 100, fraction: 0, rate: 0 });
        assert_eq!(path.at(11_000_000), Target { position: -50, fraction: 0, rate: 0 });
        assert_eq!(path.at(1_500_000), Target { position: 60, fraction: 0, rate: 50 });
    }

    /// Fails when a way point is still under way at the instant at which it is reached (`<=` for `<` in `path`): one that
    /// takes no time would then not be passed. Only a path that was not validated can jump there.
    #[test]
    fn a_way_point_that_takes_no_time_is_passed_at_once() {
        let way_points = Vec::from_slice(&[
            WayPoint { position: 7, duration_us: 0 },
            WayPoint { position: 7, duration_us: 1_000 },
            WayPoint { position: 9, duration_us: 0 },
        ])
        .unwrap();
        let path = Reference::Path { start: 3, way_points };
        assert_eq!(path.validate(), Err(ReferenceError::NoTime(0)));
        let at = [0, 1, 999, 1_000, 1_001].map(|elapsed_us| path.at(elapsed_us).position);
        assert_eq!(at, [7, 7, 7, 9, 9]);
        let hold = Vec::from_slice(&[WayPoint { position: 3, duration_us: 0 }]).unwrap();
        assert_eq!(Reference::Path { start: 3, way_points: hold }.validate(), Ok(()));
    }

    #[test]
    fn step_and_ramp_end_where_they_say() {
        let step = Reference::Step { position: -7, at_us: 1000 };
        assert_eq!((step.at(999).position, step.at(1000).position), (0, -7));
        let ramp = Reference::Ramp { rate: -100, limit: 50 };
        assert_eq!(ramp.at(250_000), Target { position: -25, fraction: 0, rate: -100 });
        assert_eq!(ramp.at(500_000), Target { position: -50, fraction: 0, rate: 0 });
        assert_eq!(ramp.at(9_000_000), Target { position: -50, fraction: 0, rate: 0 });
    }

    /// Fails when the whole counts and the fraction do not make the wanted position: a sign lost below zero, where both are cut
    /// towards it.
    #[test]
    fn the_fraction_goes_on_where_whole_counts_end() {
        let finely = |target: Target| f64::from(target.position) + f64::from(target.fraction) / 128.0;
        let sine = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
        let ramp = Reference::Ramp { rate: -33, limit: 100 };
        for ms in 0..5_000u32 {
            let (us, s) = (u64::from(ms) * 1_000, f64::from(ms) * 1e-3);
            let exact = 89.0 * (1.257 * s).sin();
            assert!((finely(sine.at(us)) - exact).abs() < 1.0 / 127.0, "sine at {s}");
            let exact = (-33.0 * s).max(-100.0);
            assert!((finely(ramp.at(us)) - exact).abs() < 1.0 / 127.0, "ramp at {s}");
        }
    }

    #[test]
    fn references_out_of_bounds_are_refused() {
        assert_eq!(Reference::Sine { amplitude: i32::MIN, omega_urad_s: 1 }.validate(), Err(ReferenceError::Position));
        let fast = Reference::Sine { amplitude: 1, omega_urad_s: 100_000_001 };
        assert_eq!(fast.validate(), Err(ReferenceError::Frequency));
        let fastest = Reference::Sine { amplitude: 1 << 24, omega_urad_s: 100_000_000 };
        assert_eq!(fastest.validate(), Ok(()));
        assert_eq!(Reference::Ramp { rate: 0, limit: 9 }.at(1_000_000), Target { position: 0, fraction: 0, rate: 0 });
        assert_eq!(Reference::Path { start: 0, way_points: Vec::new() }.validate(), Err(ReferenceError::Empty));
        let jump = Vec::from_slice(&[WayPoint { position: 1, duration_us: 0 }]).unwrap();
        assert_eq!(Reference::Path { start: 0, way_points: jump }.validate(), Err(ReferenceError::NoTime(0)));
    }

    proptest! {
        /// The quintic against doubles, for moves a motor can make.
        #[test]
        fn quintic_matches_doubles(from in -100_000i32..100_000, to in -100_000i32..100_000,
                                   duration_us in 1_000u32..60_000_000, share in 0.0f64..1.0) {
            let elapsed = (share * f64::from(duration_us)) as u32;
            let tau = f64::from(elapsed) / f64::from(duration_us);
            let shape = tau.powi(3) * (10.0 - 15.0 * tau + 6.0 * tau * tau);
            let exact = f64::from(from) + f64::from(to - from) * shape;
            let ours = quintic(from, to, elapsed, duration_us);
            prop_assert!((f64::from(ours.position) - exact).abs() <= 0.6, "{} against {exact}", ours.position);
            let finely = f64::from(ours.position) + f64::from(ours.fraction) / 128.0;
            prop_assert!((finely - exact).abs() <= 0.02 + f64::from(to - from).abs() * 1e-8, "{finely} against {exact}");
            let rate = f64::from(to - from) * 30.0 * (tau * (1.0 - tau)).powi(2) * 1e6 / f64::from(duration_us);
            prop_assert!((f64::from(ours.rate) - rate).abs() <= 1.1 + 1e6 / f64::from(duration_us) + rate.abs() * 1e-6);
        }

        #[test]
        fn no_reference_panics(amplitude in any::<i32>(), omega in any::<u32>(), t in any::<u64>(), rate in any::<i32>(),
                               limit in any::<u32>(), a in any::<i32>(), b in any::<i32>(), d in any::<u32>()) {
            Reference::Sine { amplitude, omega_urad_s: omega }.at(t);
            Reference::Step { position: a, at_us: d }.at(t);
            Reference::Ramp { rate, limit }.at(t);
            let way_points = Vec::from_slice(&[WayPoint { position: b, duration_us: d }]).unwrap();
            let path = Reference::Path { start: a, way_points };
            path.at(t);
            path.at(u64::from(d / 2));
        }
    }
}
