//! The thesis's own text files: words of 32 samples printed in base 2 (thesis, C.1).

use super::lines::{self, Budget, Lines};
use super::{
    DEFAULT_EDGES_PER_REV, DEFAULT_PWM_HZ, Direction, Format, MAX_RUNS, Measurement, MeasurementError, Run, RunData,
    RunKind,
};
use std::path::Path;

/// Samples in one printed word.
pub(super) const WORD_BITS: usize = 32;
/// Sampling period of the thesis's capture in µs.
const PERIOD_US: f64 = 1000.0;
/// Steps of its 5-bit PWM.
const DUTY_STEPS: f64 = 32.0;
/// Seconds after which its timer switched the drive off.
const DRIVE_ON_S: f64 = 5.0;
/// The capture stops once it has received this many equal words in a row.
const EQUAL_WORDS_TO_STOP: usize = 5;

/// Reads words until the end of the file. The printing left leading zeros out; every word stands for 32 samples.
pub(super) fn read(lines: &mut Lines, budget: &mut Budget) -> Result<RunData, MeasurementError> {
    let mut levels = Vec::new();
    while lines.advance()? {
        let line = lines.line();
        let digits = line.trim_ascii_start();
        let indent = line.len() - digits.len();
        if digits.starts_with(b"ERROR") {
            return Err(lines.error(
                indent + 1,
                "the capture reports a lost word of 32 samples (its queue of 20 was full), so every later word is at \
                 least 32 ms late: cut the file within the 20 words before and after this line and make two runs of it",
            ));
        }
        if let Some(wrong) = digits.iter().position(|digit| !matches!(digit, b'0' | b'1')) {
            let shown = digits[wrong..=wrong].escape_ascii();
            return Err(lines.error(indent + wrong + 1, format!("`{shown}` is not a binary digit")));
        }
        if digits.len() > WORD_BITS {
            return Err(lines
                .error(indent + WORD_BITS + 1, format!("{} digits: a word holds at most {WORD_BITS}", digits.len())));
        }
        let word: [bool; WORD_BITS] = std::array::from_fn(|bit| {
            (bit + digits.len()).checked_sub(WORD_BITS).is_some_and(|index| digits[index] == b'1')
        });
        for level in word {
            budget.push(&mut levels, level, lines)?;
        }
    }
    if levels.is_empty() {
        return Err(lines.error(1, "the file holds no word"));
    }
    Ok(RunData::Levels { start_us: 0.0, period_us: PERIOD_US, levels })
}

/// Whether a record of packed words ended because of the capture's own rule (equal words in a row) rather than because
/// the motor had been switched off: what came later is then unknown, not zero.
pub(super) fn stopped_by_equal_words(levels: &[bool]) -> bool {
    let words: Vec<&[bool]> = levels.rchunks_exact(WORD_BITS).take(EQUAL_WORDS_TO_STOP).collect();
    words.len() == EQUAL_WORDS_TO_STOP && words.iter().all(|word| *word == words[0])
}

/// The on fraction and repetition that a file name such as `Duty_093_4.txt` stands for.
///
/// The name holds the HIGH fraction `d` of an active-low pin without its decimal point; the code rounded `32 d`.
pub(super) fn duty_from_name(file: &str) -> Option<(f64, u32)> {
    let name = Path::new(file).file_name()?.to_str()?.strip_suffix(".txt")?.strip_prefix("Duty_")?;
    let (digits, repetition) = name.split_once('_')?;
    if digits.is_empty() || digits.len() > 6 || !digits.bytes().all(|digit| digit.is_ascii_digit()) {
        return None;
    }
    let high: f64 = format!("{}.{}", &digits[..1], &digits[1..]).parse().ok()?;
    let on = 1.0 - (DUTY_STEPS * high).round() / DUTY_STEPS;
    (0.0..=1.0).contains(&on).then_some((on, repetition.parse().ok()?))
}

/// See [`Measurement::load_thesis_texts`].
pub(super) fn load_folder(folder: &Path, direction: Direction) -> Result<Measurement, MeasurementError> {
    let entries = std::fs::read_dir(folder).map_err(|source| MeasurementError::io(folder, source))?;
    let mut found = Vec::new();
    for entry in entries {
        let name = entry.map_err(|source| MeasurementError::io(folder, source))?.file_name();
        if let Some(name) = name.to_str()
            && let Some((duty, repetition)) = duty_from_name(name)
        {
            found.push((name.to_owned(), duty, repetition));
        }
        if found.len() > MAX_RUNS {
            return Err(MeasurementError::whole(folder, format!("more than {MAX_RUNS} runs")));
        }
    }
    if found.is_empty() {
        return Err(MeasurementError::whole(folder, "no file is named Duty_<duty>_<number>.txt"));
    }
    found.sort_by(|a, b| a.0.cmp(&b.0));
    let mut budget = Budget::new();
    let runs = found
        .into_iter()
        .map(|(file, duty, _)| {
            Ok(Run {
                id: file.trim_end_matches(".txt").to_owned(),
                kind: RunKind::Speed,
                format: Format::Packed,
                duty: Some(duty),
                direction: Some(direction),
                pwm_hz: DEFAULT_PWM_HZ,
                drive_on_s: Some(DRIVE_ON_S),
                pwm_phase_s: 0.0,
                aligned: true,
                order: None,
                control: None,
                data: {
                    let path = folder.join(&file);
                    read(&mut Lines::new(lines::open(&path)?, &path), &mut budget)?
                },
                file,
            })
        })
        .collect::<Result<_, MeasurementError>>()?;
    Ok(Measurement {
        name: folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
        motor: "pcbmotor-30mm".to_owned(),
        edges_per_rev: DEFAULT_EDGES_PER_REV,
        runs,
        folder: folder.to_owned(),
    })
}
