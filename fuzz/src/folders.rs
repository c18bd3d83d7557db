//! Measurement folders: `measurement.toml` and a data file of every format.

use std::io::{BufRead, Cursor};
use std::path::{Component, Path, PathBuf};
use twum_host::record::check::check;
use twum_host::record::measurement::{DriveResponse, Files, Measurement, MeasurementError, RunData, below};

const FOLDER: &str = "/measured/bench 3";
/// Two runs of a format read the same file.
const FORMATS: [&str; 6] = ["levels", "edges", "packed", "velocity", "control", "drive"];

/// The first byte chooses: a free manifest, up to the first zero byte, and a file; or a file of a given format.
pub fn folders(data: &[u8]) {
    let Some((choice, rest)) = data.split_first() else { return };
    if let Some(format) = FORMATS.get(usize::from(*choice).wrapping_sub(1)) {
        let kind = if *format == "control" { "track" } else { "speed" };
        let manifest = format!(
            "name=\"\"\nmotor=\"pcbmotor-30mm\"\n[[run]]\nid=\"a\"\nkind=\"{kind}\"\nfile=\"a/b\"\nformat=\"{format}\"\n"
        );
        return load(&manifest, rest);
    }
    let (manifest, file) = match rest.iter().position(|byte| *byte == 0) {
        Some(zero) => (&rest[..zero], &rest[zero + 1..]),
        None => (rest, &[][..]),
    };
    if let Ok(manifest) = std::str::from_utf8(manifest) {
        load(manifest, file);
    }
}

/// One file under every name.
struct OneFile<'a>(&'a [u8]);

impl Files for OneFile<'_> {
    fn resolve(&self, name: &str) -> Result<PathBuf, String> {
        let path = below(Path::new(FOLDER), name)?;
        let inside = path.strip_prefix(FOLDER).expect("a name stays below its folder");
        assert!(inside.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)), "{name:?}");
        Ok(path)
    }

    fn open(&self, path: &Path) -> Result<Box<dyn BufRead>, MeasurementError> {
        assert!(path.starts_with(FOLDER));
        Ok(Box::new(Cursor::new(self.0.to_vec())))
    }
}

fn load(manifest: &str, file: &[u8]) {
    match Measurement::parse(Path::new(FOLDER), manifest, &OneFile(file)) {
        Err(error) => assert!(error.to_string().contains(FOLDER), "an error names its file: {error}"),
        Ok(measurement) => {
            for run in &measurement.runs {
                assert!(run.duty.is_none_or(|duty| (0.0..=1.0).contains(&duty)));
                sound(&run.data);
                let (start_us, end_us) = run.span_us();
                assert!(start_us <= end_us && end_us - start_us <= 86_400e6);
            }
            let _ = check(&measurement);
        }
    }
}

fn sound(data: &RunData) {
    let increasing = |times: &[f64]| times.windows(2).all(|pair| pair[0] < pair[1]);
    let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
    match data {
        RunData::Levels { start_us, period_us, levels } => {
            assert!(start_us.is_finite() && *period_us > 0.0 && levels.len() > 1);
        }
        RunData::Edges { initial, start_us, edges, end_us } => {
            let mut before = (*start_us, *initial);
            for edge in edges {
                assert!(edge.time_us > before.0 && edge.level != before.1);
                before = (edge.time_us, edge.level);
            }
            assert!(*end_us >= before.0 && end_us > start_us);
        }
        RunData::Velocity { time_us, rpm } => {
            assert!(time_us.len() == rpm.len() && increasing(time_us) && finite(time_us) && finite(rpm));
        }
        RunData::Control(rows) => {
            assert!(rows.windows(2).all(|pair| pair[0].time_us < pair[1].time_us));
            for row in rows {
                assert!(finite(&[row.time_us, row.target, row.position, row.u]) && (0.0..=1.0).contains(&row.duty));
            }
        }
        RunData::Drive { time_us, input, response, beside } => {
            let (DriveResponse::PositionRad(values) | DriveResponse::SpeedRpm(values)) = response;
            assert!(time_us.len() == input.len() && time_us.len() == values.len());
            assert!(increasing(time_us) && finite(time_us) && finite(input) && finite(values));
            assert!(beside.values().all(|column| column.len() == time_us.len() && finite(column)));
        }
    }
}
