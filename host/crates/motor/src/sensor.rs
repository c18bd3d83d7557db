//! From angle to edges: a one-line encoder, its faults, and the clock that times it.

use super::effects::EffectSet;
use super::plant::Segment;
use std::f64::consts::PI;

/// An edge of the encoder's line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// When, on the recorder's clock (s).
    pub time_s: f64,
    /// Level of the line after the edge.
    pub level: bool,
    /// Sense of the motion that made it, +1 or −1; the line itself does not tell.
    pub sense: i8,
}

/// An encoder with `edges_per_rev` equally spaced edges, fed with the plant's steps.
#[derive(Debug, Clone)]
pub struct Encoder {
    pitch_rad: f64,
    phase_rad: f64,
    effects: EffectSet,
    /// Index of the interval between edges the encoder is in.
    interval: i64,
    /// Angle of the encoder's shaft, which lags the rotor by up to half the backlash (rad).
    shaft_rad: f64,
}

impl Encoder {
    /// An encoder whose rotor angle 0 is `phase_rad` past an edge (rad, inside one pitch).
    pub fn new(edges_per_rev: u32, phase_rad: f64, effects: &EffectSet) -> Self {
        let mut encoder = Encoder {
            pitch_rad: 2.0 * PI / f64::from(edges_per_rev),
            phase_rad,
            effects: effects.clone(),
            interval: 0,
            shaft_rad: 0.0,
        };
        encoder.interval = encoder.interval_at(0.0);
        encoder
    }

    /// Level of the line.
    pub fn level(&self) -> bool {
        self.interval.rem_euclid(2) == 1
    }

    /// Edges passed since the start, in the positive sense.
    pub fn interval(&self) -> i64 {
        self.interval
    }

    /// Edges passed, in the positive sense, when the shaft stands at an angle (rad).
    pub fn interval_at(&self, shaft_rad: f64) -> i64 {
        self.interval_of(self.apparent(shaft_rad))
    }

    /// The angle the disc shows for a shaft angle (rad).
    fn apparent(&self, shaft: f64) -> f64 {
        let shown = shaft + self.phase_rad;
        match self.effects.encoder_eccentricity {
            Some(e) => shown + e.error_rad(shaft),
            None => shown,
        }
    }

    /// The angle of the edge between interval k − 1 and interval k.
    fn edge_rad(&self, k: i64) -> f64 {
        let shift = match self.effects.unequal_edges {
            Some(e) if k.rem_euclid(2) == 1 => e.offset,
            _ => 0.0,
        };
        (k as f64 + shift) * self.pitch_rad
    }

    fn interval_of(&self, angle: f64) -> i64 {
        let mut k = (angle / self.pitch_rad).floor() as i64;
        while angle < self.edge_rad(k) {
            k -= 1;
        }
        while angle >= self.edge_rad(k + 1) {
            k += 1;
        }
        k
    }

    /// Shaft angle for a rotor angle: the rotor pushes it at either end of the gap.
    fn shaft_after(&self, rotor: f64) -> f64 {
        match self.effects.backlash {
            Some(e) => self.shaft_rad.clamp(rotor - 0.5 * e.gap_rad, rotor + 0.5 * e.gap_rad),
            None => rotor,
        }
    }

    /// Reports the edges inside a step, on the plant's clock, in order.
    pub fn watch(&mut self, segment: &Segment, edge: &mut impl FnMut(Edge)) {
        // A step that turns back has an extreme inside it: look at either side of it.
        if segment.start_rad_s * segment.end_rad_s < 0.0 {
            let turn = crossing(segment, segment.start_s, segment.end_s, |s, t| s.speed_rad_s(t));
            self.sweep(segment, segment.start_s, turn, edge);
            self.sweep(segment, turn, segment.end_s, edge);
        } else {
            self.sweep(segment, segment.start_s, segment.end_s, edge);
        }
    }

    /// Edges between two times of a step in which the rotor does not turn back.
    fn sweep(&mut self, segment: &Segment, from_s: f64, to_s: f64, edge: &mut impl FnMut(Edge)) {
        let rotor = segment.position_rad(to_s);
        let shaft = self.shaft_after(rotor);
        let target = self.interval_of(self.apparent(shaft));
        if target == self.interval {
            self.shaft_rad = shaft;
            return;
        }
        let sense: i64 = if target > self.interval { 1 } else { -1 };
        let mut from_s = from_s;
        while self.interval != target {
            let at = self.edge_rad(if sense > 0 { self.interval + 1 } else { self.interval });
            let time_s =
                crossing(segment, from_s, to_s, |s, t| self.apparent(self.shaft_after(s.position_rad(t))) - at);
            self.interval += sense;
            from_s = time_s;
            edge(Edge { time_s, level: self.level(), sense: sense as i8 });
        }
        self.shaft_rad = shaft;
    }
}

/// Where `f` changes sign between two times of a step, by the Illinois method; to a nanosecond.
fn crossing(segment: &Segment, from_s: f64, to_s: f64, f: impl Fn(&Segment, f64) -> f64) -> f64 {
    let (mut a, mut b) = (from_s, to_s);
    let (mut fa, mut fb) = (f(segment, a), f(segment, b));
    if fa * fb > 0.0 {
        return if fa.abs() < fb.abs() { a } else { b };
    }
    for _ in 0..60 {
        if b - a < 1e-9 || fa == fb {
            break;
        }
        let c = (a * fb - b * fa) / (fb - fa);
        let fc = f(segment, c);
        if fc == 0.0 {
            return c;
        }
        if fc * fb < 0.0 {
            (a, fa) = (b, fb);
        } else {
            fa *= 0.5;
        }
        (b, fb) = (c, fc);
    }
    // Not `clamp`, which panics where a rotor that ran away has no position any more.
    b.max(from_s).min(to_s)
}

/// What the recorder makes of the edges: its clock, and what it loses. Leaves `edges` in order.
pub fn record(edges: &mut Vec<Edge>, end_s: f64, effects: &EffectSet) -> f64 {
    let mut end_s = end_s;
    if let Some(e) = effects.clock_error {
        // Beyond the time at which a drifting clock would be half wrong it stays so: time must go on.
        let settled = if e.drift_per_s == 0.0 { f64::INFINITY } else { 0.5 / e.drift_per_s.abs() };
        let grown = |t: f64| {
            if e.drift_tau_s > 0.0 {
                return e.drift_tau_s * (t + e.drift_tau_s * (-t / e.drift_tau_s).exp_m1());
            }
            let drifting = t.min(settled);
            drifting * (t - 0.5 * drifting)
        };
        let recorded = |t: f64| t * (1.0 + e.error) + e.drift_per_s * grown(t);
        for edge in edges.iter_mut() {
            edge.time_s = recorded(edge.time_s);
        }
        end_s = recorded(end_s);
    }
    if let Some(e) = effects.dropped_samples
        && e.length_s > 0.0
    {
        end_s = drop_stretches(edges, end_s, e.length_s, e.first_s, e.every_s);
    }
    end_s
}

fn drop_stretches(edges: &mut Vec<Edge>, end_s: f64, length_s: f64, first_s: f64, every_s: f64) -> f64 {
    // In the recorder's shortened time the gaps sit at first, first + every, ...; in true time each also moves by those before.
    let mut gap_s = first_s;
    let mut lost_s = 0.0;
    let mut kept: Vec<Edge> = Vec::with_capacity(edges.len());
    let mut gap_level = None;
    for edge in edges.iter() {
        while edge.time_s >= gap_s + length_s {
            close(&mut kept, gap_level.take(), gap_s - lost_s);
            lost_s += length_s;
            gap_s = if every_s > 0.0 { gap_s + length_s + every_s } else { f64::INFINITY };
        }
        if edge.time_s >= gap_s {
            gap_level = Some(*edge);
        } else {
            kept.push(Edge { time_s: edge.time_s - lost_s, ..*edge });
        }
    }
    while end_s >= gap_s + length_s {
        close(&mut kept, gap_level.take(), gap_s - lost_s);
        lost_s += length_s;
        gap_s = if every_s > 0.0 { gap_s + length_s + every_s } else { f64::INFINITY };
    }
    *edges = kept;
    end_s - lost_s
}

/// After a gap the line is seen at its level behind the gap: an edge there if an odd number was lost.
fn close(kept: &mut Vec<Edge>, last_lost: Option<Edge>, at_s: f64) {
    if let Some(lost) = last_lost
        && kept.last().map_or(!lost.level, |edge| edge.level) != lost.level
    {
        kept.push(Edge { time_s: at_s, ..lost });
    }
}
