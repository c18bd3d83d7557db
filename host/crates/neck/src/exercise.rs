//! Exercises as data files: the way points a neck goes through, and how long each move or hold takes.

use super::kinematics::JOINTS;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use twum_shared::reference::MAX_WAY_POINTS;

/// Peak velocity of the quintic that leads from pose to pose, over its mean velocity: `s'(1/2)` of `s(τ) = 10τ³ − 15τ⁴ + 6τ⁵`.
pub const PEAK_OVER_MEAN_VELOCITY: f64 = 1.875;

/// Joint ranges unless a file says otherwise, °: joint 2 leans the neck, and below 90° there are shoulders.
const RANGE_DEG: [[f64; 2]; JOINTS] = [[-180.0, 180.0], [-90.0, 90.0], [-180.0, 180.0]];
/// No range may be wider than this, °.
const RANGE_LIMIT_DEG: f64 = 360.0;
/// The longest segment, s.
const SECONDS_LIMIT: f64 = 3600.0;

/// A range-of-motion exercise: validated, so that every path made from it can be tracked.
#[derive(Debug, Clone, PartialEq)]
pub struct Exercise {
    pub(super) name: String,
    pub(super) title: String,
    pub(super) source: String,
    pub(super) start_deg: [f64; JOINTS],
    pub(super) segments: Vec<Segment>,
}

/// A move to a way point, or a hold where it equals the one before.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Segment {
    /// What a person does here.
    #[serde(default)]
    pub name: String,
    /// The way point at its end: joint angles, °, joint 1 first.
    pub to_deg: [f64; JOINTS],
    /// How long it takes, s.
    pub seconds: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    title: Option<String>,
    #[serde(default)]
    source: String,
    start_deg: [f64; JOINTS],
    #[serde(default = "default_range")]
    range_deg: [[f64; 2]; JOINTS],
    #[serde(rename = "segment")]
    segments: Vec<Segment>,
}

fn default_range() -> [[f64; 2]; JOINTS] {
    RANGE_DEG
}

/// Why an exercise is refused. Joints and segments count from 1.
#[derive(Debug, thiserror::Error)]
pub enum ExerciseError {
    /// Neither shipped nor a file.
    #[error("no exercise `{0}`: {names} are shipped, anything else is the path of a .toml file", names = Exercise::SHIPPED.join(", "))]
    Unknown(String),
    /// The file cannot be read.
    #[error("{path}: {reason}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        reason: std::io::Error,
    },
    /// The file is not an exercise.
    #[error("{path}: {message}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, key and what was wrong.
        message: String,
    },
    /// The file is an exercise nobody can do.
    #[error("{path}: {problem}")]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong where.
        problem: Box<Problem>,
    },
}

/// What is wrong with an exercise, and where. Joints and segments count from 1; segment 0 is the start.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// No segment at all.
    #[error("an exercise needs at least one [[segment]]")]
    Empty,
    /// More way points than a reference holds.
    #[error("{0} segments: the firmware's reference holds at most {MAX_WAY_POINTS} way points, split the exercise")]
    TooManySegments(usize),
    /// An angle that is not a number.
    #[error("joint {joint}, {place}: the angle is {deg}, which is not a finite number of degrees", place = place(*segment))]
    NotFinite {
        /// The joint.
        joint: usize,
        /// The segment.
        segment: usize,
        /// What was given.
        deg: f64,
    },
    /// A way point outside the joint's range.
    #[error("joint {joint}, {place}: {deg}° is unreachable, the joint goes from {low}° to {high}° (range_deg)", place = place(*segment))]
    Unreachable {
        /// The joint.
        joint: usize,
        /// The segment.
        segment: usize,
        /// What was asked for, °.
        deg: f64,
        /// Lower end of the joint's range, °.
        low: f64,
        /// Upper end of the joint's range, °.
        high: f64,
    },
    /// A range that is none.
    #[error("joint {joint}: range_deg [{low}, {high}] must rise and stay within ±{RANGE_LIMIT_DEG}°")]
    Range {
        /// The joint.
        joint: usize,
        /// Lower end given, °.
        low: f64,
        /// Upper end given, °.
        high: f64,
    },
    /// A time nothing can be done in.
    #[error("segment {segment}: {seconds} s is not a time above 0 and up to {SECONDS_LIMIT} s")]
    Time {
        /// The segment.
        segment: usize,
        /// What was given, s.
        seconds: f64,
    },
    /// A move faster than the motor at full drive.
    #[error(
        "joint {joint}, segment {segment}: {from_deg}° to {to_deg}° in {seconds} s peaks at {peak_deg_s:.1}°/s, but {motor} reaches {limit_deg_s:.1}°/s at full drive; give the segment at least {least:.2} s",
        least = seconds * peak_deg_s / limit_deg_s
    )]
    TooFast {
        /// The joint.
        joint: usize,
        /// The segment.
        segment: usize,
        /// Where the move starts, °.
        from_deg: f64,
        /// Where it ends, °.
        to_deg: f64,
        /// How long it takes, s.
        seconds: f64,
        /// Peak velocity of its quintic, °/s.
        peak_deg_s: f64,
        /// What the motor reaches without load, °/s.
        limit_deg_s: f64,
        /// The motor.
        motor: String,
    },
}

fn place(segment: usize) -> String {
    if segment == 0 { "start".to_owned() } else { format!("segment {segment}") }
}

impl Exercise {
    /// Names of the exercises that come with the tool.
    pub const SHIPPED: [&str; 3] = ["flexion-extension", "lateral-flexion", "rotation"];

    /// The file of a shipped exercise, to start one's own from.
    pub fn shipped_file(name: &str) -> Option<&'static str> {
        match name {
            "flexion-extension" => Some(include_str!("../exercises/flexion-extension.toml")),
            "lateral-flexion" => Some(include_str!("../exercises/lateral-flexion.toml")),
            "rotation" => Some(include_str!("../exercises/rotation.toml")),
            _ => None,
        }
    }

    /// A shipped exercise.
    ///
    /// # Errors
    /// When none has that name.
    pub fn shipped(name: &str) -> Result<Self, ExerciseError> {
        let text = Self::shipped_file(name).ok_or_else(|| ExerciseError::Unknown(name.to_owned()))?;
        Self::parse(text, Path::new(name))
    }

    /// A shipped exercise by its name, or one from the file at that path.
    ///
    /// # Errors
    /// Names the file and the key, or the joint, segment and limit.
    pub fn load(name_or_path: &str) -> Result<Self, ExerciseError> {
        if Self::SHIPPED.contains(&name_or_path) {
            return Self::shipped(name_or_path);
        }
        let path = Path::new(name_or_path);
        if !path.exists() && path.extension().is_none() {
            return Err(ExerciseError::Unknown(name_or_path.to_owned()));
        }
        let text = twum_files::input::text(path, twum_files::input::WRITTEN)
            .map_err(|reason| ExerciseError::Read { path: path.to_owned(), reason })?;
        Self::parse(&text, path)
    }

    /// Reads an exercise from TOML; `path` is for messages.
    ///
    /// # Errors
    /// As [`Exercise::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, ExerciseError> {
        let file: File = toml::from_str(text)
            .map_err(|error| ExerciseError::Parse { path: path.to_owned(), message: error.to_string() })?;
        check(&file).map_err(|problem| ExerciseError::Invalid { path: path.to_owned(), problem: Box::new(problem) })?;
        Ok(Self {
            title: file.title.unwrap_or_else(|| file.name.clone()),
            name: file.name,
            source: file.source,
            start_deg: file.start_deg,
            segments: file.segments,
        })
    }

    /// Its name, as in `--exercise`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its name for people.
    pub fn title(&self) -> &str {
        &self.title
    }

    /// Where it comes from.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// Joint angles at the start, °.
    pub fn start_deg(&self) -> [f64; JOINTS] {
        self.start_deg
    }

    /// Its moves and holds, in order.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// How long it takes, s.
    pub fn duration_s(&self) -> f64 {
        self.segments.iter().map(|segment| segment.seconds).sum()
    }

    /// Refuses moves whose peak velocity is above what a motor reaches.
    ///
    /// # Errors
    /// [`Problem::TooFast`], with the joint, the segment and the limit.
    pub fn check_speed(&self, motor: &str, limit_deg_s: f64) -> Result<(), Problem> {
        let mut from = self.start_deg;
        for (index, segment) in self.segments.iter().enumerate() {
            for (joint, (&from_deg, &to_deg)) in from.iter().zip(&segment.to_deg).enumerate() {
                let peak_deg_s = PEAK_OVER_MEAN_VELOCITY * (to_deg - from_deg).abs() / segment.seconds;
                if peak_deg_s > limit_deg_s {
                    return Err(Problem::TooFast {
                        joint: joint + 1,
                        segment: index + 1,
                        from_deg,
                        to_deg,
                        seconds: segment.seconds,
                        peak_deg_s,
                        limit_deg_s,
                        motor: motor.to_owned(),
                    });
                }
            }
            from = segment.to_deg;
        }
        Ok(())
    }
}

fn check(file: &File) -> Result<(), Problem> {
    for (joint, &[low, high]) in file.range_deg.iter().enumerate() {
        let inside = low.abs() <= RANGE_LIMIT_DEG && high.abs() <= RANGE_LIMIT_DEG;
        if !(inside && low < high) {
            return Err(Problem::Range { joint: joint + 1, low, high });
        }
    }
    match file.segments.len() {
        0 => return Err(Problem::Empty),
        count if count > MAX_WAY_POINTS => return Err(Problem::TooManySegments(count)),
        _ => {}
    }
    let way_points = std::iter::once(&file.start_deg).chain(file.segments.iter().map(|segment| &segment.to_deg));
    for (segment, way_point) in way_points.enumerate() {
        for (index, (&deg, &[low, high])) in way_point.iter().zip(&file.range_deg).enumerate() {
            let joint = index + 1;
            if !deg.is_finite() {
                return Err(Problem::NotFinite { joint, segment, deg });
            }
            if !(low..=high).contains(&deg) {
                return Err(Problem::Unreachable { joint, segment, deg, low, high });
            }
        }
    }
    for (index, segment) in file.segments.iter().enumerate() {
        // Below a microsecond the firmware's reference would see no time at all.
        if !(segment.seconds >= 1e-6 && segment.seconds <= SECONDS_LIMIT) {
            return Err(Problem::Time { segment: index + 1, seconds: segment.seconds });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn problem(text: &str) -> String {
        Exercise::parse(text, Path::new("mine.toml")).unwrap_err().to_string()
    }

    fn with_segments(segments: &str) -> String {
        format!("name = \"mine\"\nstart_deg = [0, 0, 0]\n{segments}")
    }

    #[test]
    fn way_points_of_the_thesis_are_shipped() {
        let way_points = |name: &str| {
            let exercise = Exercise::shipped(name).unwrap();
            exercise.segments.iter().map(|s| s.to_deg).collect::<Vec<_>>()
        };
        let [up, flexed, extended] = [[90.0, 0.0, -90.0], [90.0, 60.0, -90.0], [90.0, -75.0, -90.0]];
        assert_eq!(way_points("flexion-extension"), [flexed, flexed, up, extended, extended, up]);
        let [up, one, other] = [[0.0; 3], [0.0, 45.0, 0.0], [0.0, -45.0, 0.0]];
        assert_eq!(way_points("lateral-flexion"), [one, one, up, other, other, up]);
        let [one, other] = [[80.0, 0.0, 0.0], [-80.0, 0.0, 0.0]];
        assert_eq!(way_points("rotation"), [one, one, up, other, other, up]);
    }

    #[test]
    fn refusals_name_joint_segment_and_limit() {
        let far = with_segments(
            "[[segment]]\nto_deg = [0, 10, 0]\nseconds = 1\n[[segment]]\nto_deg = [0, 91.5, 0]\nseconds = 1\n",
        );
        assert_eq!(
            problem(&far),
            "mine.toml: joint 2, segment 2: 91.5° is unreachable, the joint goes from -90° to 90° (range_deg)"
        );
        let nan = with_segments("[[segment]]\nto_deg = [0, 0, nan]\nseconds = 1\n");
        assert_eq!(
            problem(&nan),
            "mine.toml: joint 3, segment 1: the angle is NaN, which is not a finite number of degrees"
        );
        let start = "name = \"mine\"\nstart_deg = [inf, 0, 0]\n[[segment]]\nto_deg = [0, 0, 0]\nseconds = 1\n";
        assert!(problem(start).contains("joint 1, start: the angle is inf"));
        for seconds in ["0", "-1", "nan", "3601", "1e-9"] {
            let text = with_segments(&format!("[[segment]]\nto_deg = [0, 0, 0]\nseconds = {seconds}\n"));
            assert!(problem(&text).contains("segment 1:"), "{seconds}");
        }
    }

    #[test]
    fn moves_too_fast_for_the_motor_are_refused_with_the_time_they_need() {
        let text = with_segments("[[segment]]\nto_deg = [0, 60, 0]\nseconds = 0.5\n");
        let exercise = Exercise::parse(&text, Path::new("mine.toml")).unwrap();
        assert_eq!(
            exercise.check_speed("pcbmotor-30mm", 208.9).unwrap_err().to_string(),
            "joint 2, segment 1: 0° to 60° in 0.5 s peaks at 225.0°/s, but pcbmotor-30mm reaches 208.9°/s at full drive; give the segment at least 0.54 s"
        );
        assert_eq!(exercise.check_speed("faster", 225.0), Ok(()));
    }

    #[test]
    fn files_that_are_no_exercise_are_refused_with_line_and_key() {
        let text = with_segments("[[segment]]\nto_deg = [0, 0]\nseconds = 1\n");
        assert!(problem(&text).contains("line 4"), "{}", problem(&text));
        let text = with_segments("[[segment]]\nto_deg = [0, 0, 0]\nsecond = 1\n");
        assert!(problem(&text).contains("second"), "{}", problem(&text));
        assert!(problem("name = \"x\"\nstart_deg = [0, 0, 0]\nsegment = []\n").contains("at least one [[segment]]"));
        let many = with_segments(&"[[segment]]\nto_deg = [0, 0, 0]\nseconds = 1\n".repeat(17));
        assert!(problem(&many).contains("17 segments: the firmware's reference holds at most 16"));
        let range = format!(
            "range_deg = [[1, 0], [0, 1], [0, 1]]\n{}",
            with_segments("[[segment]]\nto_deg = [0, 0, 0]\nseconds = 1\n")
        );
        assert!(problem(&range).contains("joint 1: range_deg [1, 0]"), "{}", problem(&range));
    }

    #[test]
    fn unknown_names_list_the_shipped_ones_and_missing_files_are_named() {
        assert!(
            Exercise::load("nodding").unwrap_err().to_string().contains("flexion-extension, lateral-flexion, rotation")
        );
        assert!(Exercise::load("no/such/file.toml").unwrap_err().to_string().starts_with("no/such/file.toml: "));
    }

    proptest! {
        #[test]
        fn no_text_panics(text in ".{0,200}", angle in any::<f64>(), seconds in any::<f64>()) {
            let _ = Exercise::parse(&text, Path::new("x"));
            let text = with_segments(&format!("[[segment]]\nto_deg = [0, {angle:?}, 0]\nseconds = {seconds:?}\n"));
            if let Ok(exercise) = Exercise::parse(&text, Path::new("x")) {
                for joint in 0..JOINTS {
                    prop_assert_eq!(crate::path::reference(&exercise, joint, 65_536).validate(), Ok(()));
                }
            }
        }
    }
}
