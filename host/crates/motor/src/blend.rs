//! A motor that changes slowly and stops in every off part of the PWM need not be integrated period by period: what a period
//! does depends smoothly on a number or two. Periods are integrated on a grid of those numbers, and blended between.
//!
//! The grid is fine enough that the blend is within a few µs of the integrated edges (see the test); a search over effects
//! is ten times faster for it.

use super::averaged::Averaged;
use super::modulation::Modulation;
use super::momentary::Momentary;
use super::plant::{Drive, Segment};

/// Samples of a stretch, densest at its start where the wave changes.
const SAMPLES: usize = 32;
/// Largest number of integrated stretches kept.
const KEPT: usize = 256;
/// Grid of the changes: voltage (1), drive and resonance shifts (Hz), preload (1), load (N·m).
const GRID: [f64; 5] = [0.01, 25.0, 25.0, 0.02, 2e-4];

/// A point of the grid.
type Node = [i32; 5];

/// One integrated stretch of constant drive.
#[derive(Debug, Clone)]
struct Stretch {
    node: Node,
    duration_s: f64,
    drive: Drive,
    /// The stretch it continues, or none from rest.
    after: Option<usize>,
    /// Angle turned (rad) and speed (rad/s) at the sample times.
    samples: [(f64, f64); SAMPLES],
    end: Momentary,
}

/// The blending integrator of one motor.
#[derive(Debug, Clone)]
pub(super) struct Blend {
    scratch: Averaged,
    stretches: Vec<Stretch>,
    /// What the last stretch was blended from: its parts with their weights, while the rotor has not stopped.
    running: Vec<(usize, f64)>,
}

fn coordinates(m: &Modulation) -> [f64; 5] {
    [m.voltage - 1.0, m.drive_shift_hz, m.resonance_shift_hz, m.preload - 1.0, m.load_nm]
}

fn at_node(m: &Modulation, node: &Node) -> Modulation {
    let at = |i: usize| f64::from(node[i]) * GRID[i];
    Modulation {
        voltage: 1.0 + at(0),
        drive_shift_hz: at(1),
        resonance_shift_hz: at(2),
        preload: (1.0 + at(3)).max(1e-3),
        load_nm: at(4),
        ..*m
    }
}

/// Nodes around a modulation and their weights: two for one changing number, four for two. None for more.
fn corners(m: &Modulation) -> Option<Vec<(Node, f64)>> {
    let mut corners: Vec<(Node, f64)> = vec![([0; 5], 1.0)];
    for (i, value) in coordinates(m).into_iter().enumerate() {
        let position = value / GRID[i];
        if position.abs() > 1e6 {
            return None;
        }
        let below = position.floor();
        let share = position - below;
        for (node, _) in &mut corners {
            node[i] = below as i32;
        }
        if share > 1e-9 {
            if corners.len() == 4 {
                return None;
            }
            for k in 0..corners.len() {
                let (mut node, weight) = corners[k];
                node[i] += 1;
                corners.push((node, weight * share));
                corners[k].1 = weight * (1.0 - share);
            }
        }
    }
    Some(corners)
}

fn sample_time(i: usize, duration_s: f64) -> f64 {
    let x = (i + 1) as f64 / SAMPLES as f64;
    duration_s * x * x * x
}

impl Blend {
    pub(super) fn new(model: &Averaged) -> Self {
        Blend { scratch: model.clone(), stretches: Vec::new(), running: Vec::new() }
    }

    /// Advances `model` if its motion can be blended: from rest, or off after a blended stretch. Returns whether it did.
    pub(super) fn advance(
        &mut self,
        model: &mut Averaged,
        until_s: f64,
        drive: Drive,
        modulation: &Modulation,
        observe: &mut dyn FnMut(&Segment),
    ) -> bool {
        let start_s = model.time_s();
        let duration_s = until_s - start_s;
        let parts = if self.running.is_empty() {
            if !model.momentary().at_rest() || drive.level == 0.0 {
                return false;
            }
            let Some(corners) = corners(modulation) else { return false };
            if self.stretches.len() + corners.len() > KEPT {
                self.stretches.clear();
            }
            corners
                .iter()
                .map(|(node, weight)| (self.stretch(node, None, duration_s, drive, modulation), *weight))
                .collect::<Vec<_>>()
        } else {
            let running = std::mem::take(&mut self.running);
            if drive.level != 0.0 || self.stretches.len() + running.len() > KEPT {
                return false;
            }
            running
                .iter()
                .map(|&(after, weight)| {
                    let node = self.stretches[after].node;
                    (self.stretch(&node, Some(after), duration_s, drive, modulation), weight)
                })
                .collect()
        };

        let start_rad = model.position_rad();
        let mut last = Segment {
            start_s,
            end_s: start_s,
            start_rad,
            end_rad: start_rad,
            start_rad_s: 0.0,
            end_rad_s: model.speed_rad_s(),
        };
        for i in 0..SAMPLES {
            let (mut turned, mut speed) = (0.0, 0.0);
            for &(part, weight) in &parts {
                let sample = self.stretches[part].samples[i];
                turned += weight * sample.0;
                speed += weight * sample.1;
            }
            last = Segment {
                start_s: last.end_s,
                end_s: if i + 1 == SAMPLES { until_s } else { start_s + sample_time(i, duration_s) },
                start_rad: last.end_rad,
                end_rad: start_rad + turned,
                start_rad_s: last.end_rad_s,
                end_rad_s: speed,
            };
            observe(&last);
        }
        let ends = parts.iter().map(|&(part, weight)| (self.stretches[part].end, weight));
        let end = Momentary::mean(ends);
        model.resume(until_s, last.end_rad, end);
        if !parts.iter().all(|&(part, _)| self.stretches[part].end.at_rest()) {
            self.running = parts;
        }
        true
    }

    /// The index of an integrated stretch, integrating it if it is new.
    fn stretch(&mut self, node: &Node, after: Option<usize>, duration_s: f64, drive: Drive, m: &Modulation) -> usize {
        let known = self.stretches.iter().position(|s| {
            s.node == *node && s.after == after && (s.duration_s - duration_s).abs() < 1e-11 && s.drive == drive
        });
        if let Some(known) = known {
            return known;
        }
        let start = after.map_or(Momentary::REST, |after| self.stretches[after].end);
        self.scratch.modulate(&at_node(m, node));
        self.scratch.resume(0.0, 0.0, start);
        let mut samples = [(0.0, 0.0); SAMPLES];
        let mut next = 0;
        self.scratch.advance(duration_s, drive, &mut |segment| {
            while next < SAMPLES && sample_time(next, duration_s) <= segment.end_s {
                let at = sample_time(next, duration_s);
                samples[next] = (segment.position_rad(at), segment.speed_rad_s(at));
                next += 1;
            }
        });
        for sample in &mut samples[next..] {
            *sample = (self.scratch.position_rad(), self.scratch.speed_rad_s());
        }
        let end = self.scratch.momentary();
        self.stretches.push(Stretch { node: *node, duration_s, drive, after, samples, end });
        self.stretches.len() - 1
    }
}
