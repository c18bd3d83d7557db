//! From a measured run to what a model is held against: times, angles and the windows between edges.

use super::rotor::{Period, Schedule};
use std::f64::consts::TAU;
use twum_record::convert::changes;
use twum_record::measurement::{Direction, Run, RunData, RunKind};

/// A stretch between two measured times over which the measured angle advance is known (or bounded).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Index of the first time.
    pub from: usize,
    /// Index of the second time.
    pub to: usize,
    /// Smallest angle advance the record allows, in rad.
    pub low: f64,
    /// Largest angle advance the record allows, in rad (equal to `low` between two edges).
    pub high: f64,
}

impl Window {
    /// Half way from its beginning to its end, `of` the times or the angles of its run.
    pub fn middle(&self, of: &[f64]) -> f64 {
        0.5 * (of[self.from] + of[self.to])
    }
}

/// One run, ready to be held against a model.
#[derive(Debug, Clone)]
pub struct Observed {
    /// `folder/run` name for messages.
    pub id: String,
    /// Closed loop or open loop.
    pub kind: RunKind,
    /// Commanded on fraction of an open-loop run.
    pub duty: Option<f64>,
    /// Commanded direction's sign (1 where unknown or changing).
    pub direction: f64,
    /// Whether the direction was stated.
    pub direction_known: bool,
    /// PWM frequency in Hz.
    pub pwm_hz: f64,
    /// Order in which the runs were made.
    pub order: Option<u32>,
    /// The drive.
    pub schedule: Schedule,
    /// End of the drive in s.
    pub drive_end: f64,
    /// Measured times in s.
    pub times: Vec<f64>,
    /// Measured angle at the times in rad.
    pub angles: Vec<f64>,
    /// Encoder level after each time: 1, -1, or 0 where unknown.
    pub level: Vec<i8>,
    /// What is compared.
    pub windows: Vec<Window>,
    /// Encoder pitch in rad (0 where the data carry speed instead of edges).
    pub pitch: f64,
    /// Edges of a closed-loop run at which the count turns: time in s and the sign of the new sense.
    pub reversals: Vec<(f64, f64)>,
    /// Spread (standard deviation) of a measured time in s: quantisation of the sampling.
    pub time_spread: f64,
    /// End of the record in s.
    pub record_end: f64,
}

impl Observed {
    /// Duration of a window in s.
    pub fn duration(&self, w: &Window) -> f64 {
        self.times[w.to] - self.times[w.from]
    }

    /// Total time compared, in s.
    pub fn compared_s(&self) -> f64 {
        self.windows.iter().map(|w| self.duration(w)).sum()
    }

    /// How many windows that do not overlap hold as much as these, see [`Self::widen`].
    pub fn apart(&self) -> f64 {
        let from = self.windows.iter().map(|w| self.times[w.from]).fold(f64::INFINITY, f64::min);
        let to = self.windows.iter().map(|w| self.times[w.to]).fold(0.0, f64::max);
        let overlap = self.compared_s() / (to - from).max(1e-9);
        self.windows.len() as f64 / overlap.max(1.0)
    }

    /// Takes encoder edges (time in s, level after it) of a record from `start` to `end` for what was measured.
    pub fn put_edges(&mut self, edges: &[(f64, bool)], initial: bool, start: f64, end: f64) {
        let word = |level: bool| if level { 1 } else { -1 };
        let start = start.max(0.0);
        let end = end.min(self.drive_end + 0.2);
        let step = self.direction * self.pitch;
        let mut angle = 0.0;
        (self.times, self.angles, self.level, self.windows) = (vec![start], vec![0.0], vec![word(initial)], Vec::new());
        for (t, level) in edges {
            if *t <= start || *t > end {
                continue;
            }
            let k = self.times.len();
            angle += if k == 1 { 0.5 * step } else { step };
            self.times.push(*t);
            self.angles.push(angle);
            self.level.push(word(*level));
            if k == 1 {
                self.windows.push(Window { from: 0, to: 1, low: step.min(0.0), high: step.max(0.0) });
            } else {
                self.windows.push(Window { from: k - 1, to: k, low: step, high: step });
            }
        }
        let k = self.times.len();
        if end > self.times[k - 1] + 1e-9 {
            self.times.push(end);
            self.angles.push(angle);
            self.level.push(0);
            self.windows.push(Window { from: k - 1, to: k, low: step.min(0.0), high: step.max(0.0) });
        }
    }

    /// Pairs of neighbouring edges, by their intervals, that no rotor of this record made: more than three times as fast as nine in ten.
    /// An encoder that chatters makes them, and a record that was joined where samples are lost.
    pub fn impossible(&self) -> Vec<Window> {
        if self.kind != RunKind::Speed || self.pitch == 0.0 {
            return Vec::new();
        }
        // Each end may have been seen up to a sample late.
        let fastest = |w: &Window| w.low.abs() / (self.duration(w) + 4.0 * self.half_sample_s());
        let exact: Vec<&Window> = self.windows.iter().filter(|w| w.low == w.high).collect();
        let mut speeds: Vec<f64> = exact.iter().map(|w| fastest(w)).collect();
        speeds.sort_by(f64::total_cmp);
        let Some(usual) = speeds.get(speeds.len() * 9 / 10) else { return Vec::new() };
        exact.into_iter().filter(|w| fastest(w) > NO_ROTOR * usual).copied().collect()
    }

    /// Compares over stretches of several edges where single intervals are short against the sampling, or against the PWM period.
    ///
    /// The times at both ends of an interval are uncertain, and so is its length, by which its residual is weighted: that bends a fit by
    /// the square of (uncertainty / length), 1 % for 4 ms at 1 ms sampling. Stretches of an odd number of edges keep the slots of
    /// the wheel apart. Of sampled edges they overlap, so that every edge is an end; exact ones need not.
    pub fn widen(&mut self) {
        if self.kind != RunKind::Speed || self.pitch == 0.0 {
            return;
        }
        let impossible = self.impossible();
        self.windows.retain(|w| !impossible.contains(w));
        let exact: Vec<Window> = self.windows.iter().copied().filter(|w| w.low == w.high).collect();
        let (Some(first), Some(last)) = (exact.first(), exact.last()) else { return };
        let mean = (self.times[last.to] - self.times[first.from]) / exact.len() as f64;
        let sampled = self.half_sample_s() > 0.0;
        let wanted_s = if sampled { WIDE * self.half_sample_s() } else { 1.0 / (PIECES_A_PERIOD * self.pwm_hz) };
        let mut count = 1;
        while (count as f64) * mean < wanted_s && count + 2 < exact.len() / 4 {
            count += 2;
        }
        if count == 1 {
            return;
        }
        let stretch = |k: usize| {
            let (from, to) = (exact[k].from, exact[k + count - 1].to);
            let advance = self.angles[to] - self.angles[from];
            Window { from, to, low: advance, high: advance }
        };
        let step = if sampled { 1 } else { count };
        let wide = (0..=exact.len() - count).step_by(step).map(stretch);
        let ends = |after: bool| self.windows.iter().copied().filter(move |w| w.low != w.high && (w.from > 0) == after);
        self.windows = ends(false).chain(wide).chain(ends(true)).collect();
    }

    /// Half the period in which an edge was seen, in s; 0 where it is short against everything the rotor does.
    pub fn half_sample_s(&self) -> f64 {
        let half = self.time_spread * 3f64.sqrt();
        if half > 5e-5 { half } else { 0.0 }
    }

    /// Revolutions made during the run.
    pub fn revolutions(&self) -> f64 {
        let mut total = 0.0;
        for pair in self.angles.windows(2) {
            total += (pair[1] - pair[0]).abs();
        }
        total / TAU
    }

    /// Mean speed over the drive in rpm.
    pub fn mean_speed_rpm(&self) -> f64 {
        let (mut angle, mut time) = (0.0, 0.0);
        for w in &self.windows {
            if self.times[w.to] <= self.drive_end + 1e-9 && w.low == w.high {
                angle += w.low;
                time += self.duration(w);
            }
        }
        if time > 0.0 { angle / time * 60.0 / TAU } else { 0.0 }
    }
}

/// Shortest window of a closed-loop run in s: where the rotor chatters on one edge, single crossings say nothing of its speed.
const SHORTEST_S: f64 = 5e-3;

/// Times the speed of nine in ten intervals that none can have: pulses show those in which the rotor is driven, and none is driven three times as
/// fast as others.
const NO_ROTOR: f64 = 3.0;
/// Least mean length of what is compared, in half sampling periods.
const WIDE: f64 = 24.0;
/// Pieces of a PWM period in which exactly timed edges are compared: enough to see what happens within one.
const PIECES_A_PERIOD: f64 = 8.0;

/// Why a run cannot be used.
pub type Refusal = String;

/// Prepares one run of the TWUM plant. `edges_per_rev` as in the measurement.
pub fn observe(run: &Run, edges_per_rev: u32) -> Result<Observed, Refusal> {
    let pitch = TAU / f64::from(edges_per_rev.max(1));
    let sign = run.direction.map_or(1.0, Direction::sign);
    let mut o = Observed {
        id: run.id.clone(),
        kind: run.kind,
        duty: run.duty,
        direction: sign,
        direction_known: run.direction.is_some(),
        pwm_hz: run.pwm_hz,
        order: run.order,
        schedule: Schedule::default(),
        drive_end: 0.0,
        times: Vec::new(),
        angles: Vec::new(),
        level: Vec::new(),
        windows: Vec::new(),
        pitch,
        reversals: Vec::new(),
        time_spread: 0.0,
        record_end: 0.0,
    };
    match &run.data {
        RunData::Levels { start_us, period_us, levels } => {
            if levels.len() < 2 {
                return Err(format!("run {}: {} samples, too few to show an edge", run.id, levels.len()));
            }
            let edges: Vec<(f64, bool)> =
                changes(levels).map(|i| ((start_us + (i as f64 - 0.5) * period_us) * 1e-6, levels[i])).collect();
            o.time_spread = period_us * 1e-6 / 12f64.sqrt();
            let end = (start_us + (levels.len() - 1) as f64 * period_us) * 1e-6;
            from_edges(&mut o, run, &edges, levels[0], start_us * 1e-6, end)?;
        }
        RunData::Edges { initial, start_us, edges, end_us } => {
            let list: Vec<(f64, bool)> = edges.iter().map(|e| (e.time_us * 1e-6, e.level)).collect();
            o.time_spread = 2e-6;
            from_edges(&mut o, run, &list, *initial, start_us * 1e-6, end_us * 1e-6)?;
        }
        RunData::Velocity { time_us, rpm } => from_speeds(&mut o, run, time_us, rpm)?,
        RunData::Control(rows) => {
            if rows.len() < 10 {
                return Err(format!("run {}: {} control samples, too few", run.id, rows.len()));
            }
            control(&mut o, run, rows, pitch);
        }
        RunData::Drive { .. } => {
            return Err(format!("run {}: format `drive` belongs to an ordinary motor (motor = \"inertial\")", run.id));
        }
    }
    if !o.times.iter().chain(&o.angles).all(|v| v.is_finite()) {
        return Err(format!("run {}: a time or value is not a number", run.id));
    }
    Ok(o)
}

/// Speeds in time: each stands for the time half way to its neighbours.
fn from_speeds(o: &mut Observed, run: &Run, time_us: &[f64], rpm: &[f64]) -> Result<(), Refusal> {
    if rpm.len() < 10 {
        return Err(format!("run {}: {} speed samples, too few", run.id, rpm.len()));
    }
    let duty = run.duty.ok_or_else(|| format!("run {}: no duty given", run.id))?;
    o.pitch = 0.0;
    o.record_end = time_us[time_us.len() - 1] * 1e-6;
    o.drive_end = run.drive_on_s.unwrap_or(o.record_end);
    o.schedule = Schedule::constant(duty, o.direction, run.pwm_hz, run.pwm_phase_s, o.drive_end);
    let mut angle = 0.0;
    let n = rpm.len();
    for k in 0..=n {
        let t = if k == 0 {
            1.5 * time_us[0] - 0.5 * time_us[1]
        } else if k == n {
            1.5 * time_us[n - 1] - 0.5 * time_us[n - 2]
        } else {
            0.5 * (time_us[k - 1] + time_us[k])
        } * 1e-6;
        if k > 0 {
            let before = o.times[k - 1];
            let advance = rpm[k - 1] * TAU / 60.0 * (t - before);
            angle += advance;
            o.windows.push(Window { from: k - 1, to: k, low: advance, high: advance });
        }
        o.times.push(t);
        o.angles.push(angle);
        o.level.push(0);
    }
    Ok(())
}

fn from_edges(
    o: &mut Observed,
    run: &Run,
    edges: &[(f64, bool)],
    initial: bool,
    start: f64,
    end: f64,
) -> Result<(), Refusal> {
    let duty = run.duty.ok_or_else(|| {
        format!("run {}: no duty given, so the drive is unknown; add `duty` to its [[run]] table", run.id)
    })?;
    o.record_end = end;
    o.drive_end = run.drive_on_s.unwrap_or(end);
    o.schedule = Schedule::constant(duty, o.direction, run.pwm_hz, run.pwm_phase_s, o.drive_end);
    o.put_edges(edges, initial, start, end);
    Ok(())
}

fn control(o: &mut Observed, run: &Run, rows: &[twum_record::measurement::ControlRow], pitch: f64) {
    let t0 = rows[0].time_us * 1e-6;
    let seconds = |us: f64| us * 1e-6;
    o.record_end = seconds(rows[rows.len() - 1].time_us);
    o.drive_end = o.record_end;
    let tick = (o.record_end - t0) / (rows.len() - 1) as f64;
    o.time_spread = tick / 12f64.sqrt();
    let period = 1.0 / run.pwm_hz;
    let mut index = 0;
    let mut start = -run.pwm_phase_s.rem_euclid(period);
    while start < o.record_end {
        while index + 1 < rows.len() && seconds(rows[index + 1].time_us) <= start + 1e-9 {
            index += 1;
        }
        let duty = if seconds(rows[index].time_us) <= start + 1e-9 { rows[index].duty } else { 0.0 };
        o.schedule.periods.push(Period { start, end: start + period, duty });
        start += period;
    }
    o.schedule.directions.push((0.0, rows[0].direction.sign()));
    for pair in rows.windows(2) {
        if pair[0].direction != pair[1].direction {
            o.schedule.directions.push((seconds(pair[1].time_us), pair[1].direction.sign()));
        }
    }
    o.times.push(t0);
    o.angles.push(rows[0].position * pitch);
    o.level.push(0);
    let (mut from, mut sense) = (1, 0.0);
    for pair in rows.windows(2) {
        let change = pair[1].position - pair[0].position;
        if change == 0.0 {
            continue;
        }
        let k = o.times.len();
        let t = 0.5 * (seconds(pair[0].time_us) + seconds(pair[1].time_us));
        // Count n covers the pitch from n to n + 1: upwards an edge lies at the new count, downwards at the one left, and a rotor
        // that turns back crosses the same edge twice.
        if sense != 0.0 && change.signum() != sense {
            o.reversals.push((t, change.signum()));
        }
        sense = change.signum();
        let edge = if change > 0.0 { pair[1].position } else { pair[1].position + 1.0 };
        o.times.push(t);
        o.angles.push(edge * pitch);
        o.level.push(if (pair[1].position.rem_euclid(2.0) - 1.0).abs() < 0.5 { 1 } else { -1 });
        if k == 1 {
            from = 1;
        } else if t - o.times[from] >= SHORTEST_S {
            let advance = o.angles[k] - o.angles[from];
            o.windows.push(Window { from, to: k, low: advance, high: advance });
            from = k;
        }
    }
}

/// Of which kind each run is, counted in the order of their first runs.
fn kinds(runs: &[Observed]) -> Vec<usize> {
    let mut seen: std::collections::HashMap<String, usize> = std::collections::HashMap::new();
    let kind = |r: &Observed| {
        let next = seen.len();
        *seen.entry(format!("{:?}/{:?}/{}/{}", r.kind, r.duty, r.direction, r.pwm_hz)).or_insert(next)
    };
    runs.iter().map(kind).collect()
}

/// Keeps the first run of each kind.
pub fn one_of_each(runs: &mut Vec<Observed>) {
    spread(runs, 1, |_| 0);
}

/// Keeps `most` runs, or one of each kind where these are more: as many of each kind, evenly spread over its repetitions, and of one kind
/// after the other's, so that what changes from run to run is seen in some early and some late.
pub fn some_of_each(runs: &mut Vec<Observed>, most: usize) {
    let kinds = kinds(runs).into_iter().max().map_or(1, |last| last + 1);
    spread(runs, (most / kinds).max(1), |kind| kind);
}

/// Keeps `each` repetitions of each kind, evenly spread, from the one that `first` says on, counted round.
fn spread(runs: &mut Vec<Observed>, each: usize, first: impl Fn(usize) -> usize) {
    let kinds = kinds(runs);
    let mut repetitions = vec![0; kinds.iter().max().map_or(0, |last| last + 1)];
    kinds.iter().for_each(|kind| repetitions[*kind] += 1);
    let mut seen = vec![0; repetitions.len()];
    let mut kinds = kinds.into_iter();
    runs.retain(|_| {
        let kind = kinds.next().expect("each run has a kind");
        let of = repetitions[kind];
        let at = seen[kind];
        seen[kind] += 1;
        let kept = each.min(of);
        (0..kept).any(|k| (first(kind) + k * of / kept) % of == at)
    });
}

/// The first `seconds` of each run.
pub fn shorten(runs: &mut [Observed], seconds: f64) {
    for r in runs {
        let keep = r.times.iter().take_while(|t| **t <= seconds).count().max(2);
        r.times.truncate(keep);
        r.angles.truncate(keep);
        r.level.truncate(keep);
        r.windows.retain(|w| w.to < keep);
    }
}

#[cfg(test)]
impl Observed {
    /// A run of a test, clockwise at 50 Hz and half duty, of which nothing was recorded.
    pub(super) fn unrecorded() -> Self {
        Self {
            id: "r".into(),
            kind: RunKind::Speed,
            duty: Some(0.5),
            direction: 1.0,
            direction_known: true,
            pwm_hz: 50.0,
            order: Some(0),
            schedule: Schedule::default(),
            drive_end: 1.0,
            times: Vec::new(),
            angles: Vec::new(),
            level: Vec::new(),
            windows: Vec::new(),
            pitch: TAU / 400.0,
            reversals: Vec::new(),
            time_spread: 0.0,
            record_end: 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five repetitions of three duties, one after the other: fails if a kind is left out, if all that are kept were made early, or if more are kept
    /// than were asked for.
    #[test]
    fn runs_are_kept_of_each_kind_early_and_late() {
        let duties = [0.3, 0.6, 0.9];
        let all = || -> Vec<Observed> {
            let run =
                |k: usize| Observed { duty: Some(duties[k % 3]), order: Some(k as u32), ..Observed::unrecorded() };
            (0..15).map(run).collect()
        };
        let kept = |leave_out: &dyn Fn(&mut Vec<Observed>)| {
            let mut runs = all();
            leave_out(&mut runs);
            runs.iter().filter_map(|r| r.order).collect::<Vec<u32>>()
        };
        assert_eq!(kept(&one_of_each), [0, 1, 2]);
        assert_eq!(kept(&|runs| some_of_each(runs, 5)), [0, 4, 8]);
        assert_eq!(kept(&|runs| some_of_each(runs, 6)), [0, 4, 6, 8, 10, 14]);
        assert_eq!(kept(&|runs| some_of_each(runs, 99)), (0..15).collect::<Vec<u32>>());
    }

    fn sampled(edge_ms: usize) -> Observed {
        let levels = (0..2000_usize).map(|k| (k / edge_ms).is_multiple_of(2)).collect();
        let run = Run {
            id: "r".into(),
            kind: RunKind::Speed,
            file: String::new(),
            format: twum_record::measurement::Format::Levels,
            duty: Some(1.0),
            direction: Some(Direction::Cw),
            pwm_hz: 50.0,
            drive_on_s: Some(2.0),
            pwm_phase_s: 0.0,
            aligned: false,
            order: None,
            control: None,
            data: RunData::Levels { start_us: 0.0, period_us: 1000.0, levels },
        };
        observe(&run, 400).expect("the run can be used")
    }

    /// Fails if short intervals are compared alone, if slots of both kinds fall into one stretch in equal number, or if an edge is
    /// an end of none.
    #[test]
    fn short_intervals_are_compared_in_odd_stretches() {
        let mut o = sampled(5);
        let edges = o.windows.iter().filter(|w| w.low == w.high).count();
        o.widen();
        let stretches: Vec<&Window> = o.windows.iter().filter(|w| w.low == w.high).collect();
        assert_eq!(stretches.len(), edges - 2);
        for (k, w) in stretches.iter().enumerate() {
            assert_eq!((w.from, w.to), (k + 1, k + 4));
            assert!((w.low - 3.0 * o.pitch).abs() < 1e-12 && (o.duration(w) - 0.015).abs() < 1e-9);
        }
        assert!(
            o.windows[0].low != o.windows[0].high
                && o.windows[o.windows.len() - 1].high != o.windows[o.windows.len() - 1].low
        );
    }

    /// Fails if an edge that no rotor made is compared: one such interval outweighs all others.
    #[test]
    fn an_edge_that_no_rotor_made_is_not_compared() {
        let mut o = sampled(20);
        assert_eq!(o.impossible(), []);
        let k = o.times.len() / 2;
        o.times[k] = o.times[k - 1] + 1e-3;
        let chatter = o.windows[k - 1];
        assert_eq!((o.impossible(), o.windows.len()), (vec![chatter], o.times.len() - 1));
        o.widen();
        assert_eq!(o.windows.len(), o.times.len() - 2);
    }

    /// Fails if intervals that are long against the sampling are put together.
    #[test]
    fn long_intervals_stay() {
        let mut o = sampled(20);
        let before = o.windows.clone();
        o.widen();
        assert_eq!(o.windows, before);
    }
}
