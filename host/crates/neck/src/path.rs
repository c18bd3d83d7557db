//! Joint paths: quintics between way points with zero velocity and acceleration at each (thesis, section A.8.1).

use super::exercise::Exercise;
use super::kinematics::{JOINTS, Wrist};
use serde::Serialize;
use twum_shared::reference::{Reference, WayPoint};

/// Where a joint has to be at one instant, and how it moves there.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Motion {
    /// Angle, °.
    pub deg: f64,
    /// Velocity, °/s.
    pub deg_s: f64,
    /// Acceleration, °/s².
    pub deg_s2: f64,
}

/// The motion of all joints `time_s` after the start; before it and after the end they rest.
pub fn motion(exercise: &Exercise, time_s: f64) -> [Motion; JOINTS] {
    let mut from = exercise.start_deg;
    let mut begin_s = 0.0;
    for segment in &exercise.segments {
        let elapsed_s = time_s - begin_s;
        if elapsed_s < segment.seconds {
            return std::array::from_fn(|joint| {
                quintic(from[joint], segment.to_deg[joint], elapsed_s.max(0.0), segment.seconds)
            });
        }
        (from, begin_s) = (segment.to_deg, begin_s + segment.seconds);
    }
    from.map(|deg| Motion { deg, ..Motion::default() })
}

fn quintic(from_deg: f64, to_deg: f64, elapsed_s: f64, duration_s: f64) -> Motion {
    let tau = elapsed_s / duration_s;
    let distance = to_deg - from_deg;
    Motion {
        deg: from_deg + distance * tau.powi(3) * (10.0 + tau * (6.0 * tau - 15.0)),
        deg_s: distance / duration_s * 30.0 * (tau * (1.0 - tau)).powi(2),
        deg_s2: distance / duration_s.powi(2) * 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau),
    }
}

/// A point of an exercise's path, as `twum neck path` prints it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PathPoint {
    /// Time from the start, s.
    pub time_s: f64,
    /// Joint angles, °.
    pub angles_deg: [f64; JOINTS],
    /// Joint velocities, °/s.
    pub velocities_deg_s: [f64; JOINTS],
    /// Joint accelerations, °/s².
    pub accelerations_deg_s2: [f64; JOINTS],
    /// End point in the base frame, m: x, y, z.
    pub end_point_m: [f64; 3],
}

/// The path sampled at `rate_hz`, from the start to the end, both included.
pub fn table(exercise: &Exercise, wrist: Wrist, rate_hz: f64) -> Vec<PathPoint> {
    let duration_s = exercise.duration_s();
    // The end is a point of its own where the rate does not meet it.
    let inner = (duration_s * rate_hz - 1e-9).ceil().max(0.0) as u64;
    let times = (0..inner).map(|index| index as f64 / rate_hz).chain(std::iter::once(duration_s));
    times
        .map(|time_s| {
            let motions = motion(exercise, time_s);
            let angles_deg = motions.map(|motion| motion.deg);
            PathPoint {
                time_s,
                angles_deg,
                velocities_deg_s: motions.map(|motion| motion.deg_s),
                accelerations_deg_s2: motions.map(|motion| motion.deg_s2),
                end_point_m: wrist.end_point_m(angles_deg).coords.into(),
            }
        })
        .collect()
}

/// The same path as the firmware tracks it, from the joint's start: way points to the nearest count of its sensor, times
/// to the µs.
///
/// An [`Exercise`] has at most as many segments as a reference has way points, so that none is lost.
pub fn reference(exercise: &Exercise, joint: usize, edges_per_rev: u32) -> Reference {
    let counts = |deg: f64| (deg * f64::from(edges_per_rev) / 360.0).round() as i32;
    let start = counts(exercise.start_deg[joint]);
    let way_points = exercise
        .segments
        .iter()
        .map(|segment| WayPoint {
            position: counts(segment.to_deg[joint]) - start,
            duration_us: (segment.seconds * 1e6).round() as u32,
        })
        .collect();
    Reference::Path { start: 0, way_points }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exercise::{Exercise, PEAK_OVER_MEAN_VELOCITY, Segment};
    use proptest::prelude::*;

    /// The thesis's own quintic, from the six end conditions solved as a linear system: the independent reference.
    fn by_end_conditions(from: f64, to: f64, duration: f64, t: f64) -> Motion {
        use nalgebra::{Matrix6, Vector6};
        let row = |t: f64, order: i32| {
            Vector6::from_fn(|power, _| {
                let power = power as i32;
                let factor: f64 = (0..order).map(|k| f64::from(power - k)).product();
                if power < order { 0.0 } else { factor * t.powi(power - order) }
            })
        };
        let rows = [row(0.0, 0), row(0.0, 1), row(0.0, 2), row(duration, 0), row(duration, 1), row(duration, 2)];
        let system = Matrix6::from_rows(&rows.map(|r| r.transpose()));
        let ends = Vector6::new(from, 0.0, 0.0, to, 0.0, 0.0);
        let coefficients = system.lu().solve(&ends).expect("the end conditions of a quintic are independent");
        Motion {
            deg: row(t, 0).dot(&coefficients),
            deg_s: row(t, 1).dot(&coefficients),
            deg_s2: row(t, 2).dot(&coefficients),
        }
    }

    fn exercise() -> Exercise {
        Exercise::shipped("flexion-extension").unwrap()
    }

    #[test]
    fn shipped_exercises_take_22_seconds_and_meet_their_way_points_at_rest() {
        for name in Exercise::SHIPPED {
            let exercise = Exercise::shipped(name).unwrap();
            assert_eq!(exercise.duration_s(), 22.0, "{name}");
            let mut time = 0.0;
            for segment in &exercise.segments {
                time += segment.seconds;
                for (joint, motion) in motion(&exercise, time).into_iter().enumerate() {
                    let expected = Motion { deg: segment.to_deg[joint], ..Motion::default() };
                    assert_eq!(motion, expected, "{name} at {time} s");
                }
            }
        }
    }

    #[test]
    fn middle_of_a_move_is_half_way_at_the_peak_velocity() {
        let [_, middle, _] = motion(&exercise(), 1.5);
        assert!((middle.deg - 30.0).abs() < 1e-12 && middle.deg_s2.abs() < 1e-12);
        assert!((middle.deg_s - PEAK_OVER_MEAN_VELOCITY * 60.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn before_and_after_the_path_the_joints_rest() {
        let at = |t| motion(&exercise(), t).map(|m| m.deg);
        assert_eq!((at(-1.0), at(22.0), at(1e9)), ([90.0, 0.0, -90.0], [90.0, 0.0, -90.0], [90.0, 0.0, -90.0]));
    }

    /// The firmware's generator is within a count of the doubles, plus half a count for each way point's own rounding.
    #[test]
    fn integer_reference_follows_the_doubles() {
        for name in Exercise::SHIPPED {
            let exercise = Exercise::shipped(name).unwrap();
            for edges_per_rev in [400, 4096, 65_536] {
                let pitch_deg = 360.0 / f64::from(edges_per_rev);
                for joint in 0..JOINTS {
                    let reference = reference(&exercise, joint, edges_per_rev);
                    reference.validate().unwrap();
                    for tick in 0..44_000u64 {
                        let exact = motion(&exercise, tick as f64 * 500e-6)[joint];
                        let target = reference.at(tick * 500);
                        let start = (exercise.start_deg[joint] / pitch_deg).round();
                        let deg = (start + f64::from(target.position)) * pitch_deg;
                        assert!((deg - exact.deg).abs() <= 1.1 * pitch_deg, "{name} joint {joint} tick {tick}: {deg}");
                        let deg_s = f64::from(target.rate) * pitch_deg;
                        assert!((deg_s - exact.deg_s).abs() <= 2.2 * pitch_deg, "{name} joint {joint} tick {tick}");
                    }
                }
            }
        }
    }

    proptest! {
        #[test]
        fn quintic_is_the_one_of_the_end_conditions(
            from in -180.0..180.0f64, to in -180.0..180.0f64, duration in 0.5..20.0f64, share in 0.0..1.0f64,
        ) {
            let (ours, theirs) = (
                quintic(from, to, share * duration, duration),
                by_end_conditions(from, to, duration, share * duration),
            );
            prop_assert!((ours.deg - theirs.deg).abs() < 1e-7, "{ours:?} {theirs:?}");
            prop_assert!((ours.deg_s - theirs.deg_s).abs() < 1e-6, "{ours:?} {theirs:?}");
            prop_assert!((ours.deg_s2 - theirs.deg_s2).abs() < 1e-5, "{ours:?} {theirs:?}");
        }

        #[test]
        fn peak_velocity_is_never_above_the_stated_one(to in -180.0..180.0f64, share in 0.0..1.0f64) {
            let segments = vec![Segment { name: String::new(), to_deg: [to, 0.0, 0.0], seconds: 2.0 }];
            let exercise = Exercise { start_deg: [0.0; 3], segments, ..exercise() };
            let peak = PEAK_OVER_MEAN_VELOCITY * to.abs() / 2.0;
            prop_assert!(motion(&exercise, 2.0 * share)[0].deg_s.abs() <= peak * (1.0 + 1e-12));
        }
    }
}
