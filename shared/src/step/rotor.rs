//! What a drive that is gated believes of its motor: where the rotor is between two edges, and how it comes up and runs on.
//!
//! Angles are in 2^-20 count, speeds in that a tick; all fits 32 bits, for the speeds that [`Model::of`] lets pass. What is
//! decided is measured by what full drive turns in a tick, so that it does not depend on the encoder.

use super::load::Load;
use super::model::{COUNT, FARTHEST, FASTEST, Model};
use super::{Config, Inputs};
use serde::{Deserialize, Serialize};

/// Where the controller believes the rotor to be, and how the motor is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rotor {
    /// Count at the last tick.
    pub count: i32,
    /// Place past that count's edge, 2^-20 count.
    pub place: i32,
    /// Speed, 2^-20 count a tick.
    pub speed: i32,
    /// Speed at full drive, clockwise; zero before the first tick.
    pub full_cw: i32,
    /// Speed at full drive, counter-clockwise.
    pub full_ccw: i32,
    /// What the speed loses in a tick with the drive off.
    pub braking: i32,
    /// Drive on, decided so many ticks ago: bit by bit, the last tick's the lowest.
    pub on: u16,
    /// Clockwise, likewise.
    pub cw: u16,
    /// Ticks since the drive was last switched, up to the longest pulse.
    pub held: u8,
    /// Ticks since the last pulse began, where pulses have a period.
    pub since: u8,
    /// How far the rotor went since the last edge with the drive on, 2^-20 count, where pulses have a period.
    pub driven: i32,
    /// How far with the drive off.
    pub coasted: i32,
    /// The load on it, where a target gives way to one.
    pub load: Load,
}

impl Rotor {
    /// Nothing seen yet: anywhere within its count.
    pub const REST: Self = Self {
        count: 0,
        place: COUNT / 2,
        speed: 0,
        full_cw: 0,
        full_ccw: 0,
        braking: 0,
        on: 0,
        cw: 0,
        held: u8::MAX,
        since: u8::MAX,
        driven: 0,
        coasted: 0,
        load: Load::REST,
    };

    /// Drive decided `ago` ticks before: +1, 0 or -1.
    fn drive(&self, ago: u8) -> i32 {
        match ((self.on >> ago) & 1, (self.cw >> ago) & 1) {
            (0, _) => 0,
            (_, 0) => -1,
            _ => 1,
        }
    }

    /// What the speed loses in a tick with the drive off, of a rotor that moves clockwise (1) or counter-clockwise (-1).
    pub(super) const fn slows(&self, sense: i32) -> i32 {
        self.braking - sense * self.load.pushes
    }

    /// Place and speed after a tick in which the drive is that of `ago` ticks before. The wave, and the rotor with it, comes
    /// up to 5/8 of what is missing in a tick, and takes a quarter of the speed back as it dies: the averaged model's own
    /// course, at 500 µs. After that the rotor is braked by a constant friction.
    #[inline(always)]
    pub(super) fn advanced(&self, place: i32, speed: i32, ago: u8) -> (i32, i32) {
        let next = match (self.drive(ago), self.drive(ago + 1)) {
            (0, before) => {
                let left = if before != 0 { speed - speed / 4 } else { speed };
                if left > 0 { (left - self.slows(1)).max(0) } else { (left + self.slows(-1)).min(0) }
            }
            (on, _) => {
                let wanted = if on > 0 { self.full_cw } else { -self.full_ccw };
                speed + (wanted - speed) / 8 * 5
            }
        };
        (place + (speed + next) / 2, next)
    }

    /// A tick later: what the model says, put right by the edges there were.
    #[inline(always)]
    pub(super) fn sees(&mut self, config: &Config, inputs: &Inputs) {
        let model = &config.model;
        if self.full_cw == 0 {
            (self.full_cw, self.full_ccw, self.braking) = (model.full, model.full, model.braking);
            self.count = inputs.position;
        }
        // A state that was recorded may be anything.
        self.place = self.place.clamp(0, COUNT);
        self.speed = self.speed.clamp(-2 * FASTEST + 1, 2 * FASTEST - 1);
        (self.full_cw, self.full_ccw) = (model.about(self.full_cw), model.about(self.full_ccw));
        self.braking = model.braked(self.braking);
        let guides = config.admittance.is_on();
        if guides {
            self.load.is_borne(self.braking);
        } else {
            self.load = Load::REST;
        }
        let by_way = config.spec.has_pulse_period();
        let delay = config.spec.delay_ticks;
        let drive = self.drive(delay);
        let before = self.place;
        (self.place, self.speed) = self.advanced(self.place, self.speed, delay);
        if guides {
            self.load.passes(drive != 0, self.speed != 0);
        }
        if by_way {
            let way = if drive == 0 { &mut self.coasted } else { &mut self.driven };
            *way = way.saturating_add((self.place - before).saturating_abs());
        }

        let edges = inputs.position.wrapping_sub(self.count);
        self.count = inputs.position;
        if edges != 0 {
            let edge = if edges > 0 { 0 } else { COUNT };
            // In 256ths of a tick, without a sign: a division of signed numbers might overflow.
            let period_us = config.spec.period_us.max(1);
            let age = ((u32::from(inputs.edge_age_us).min(period_us) << 8) / period_us) as i32;
            let since = (self.speed >> 8) * age;
            if edges.unsigned_abs() <= FARTHEST.unsigned_abs() {
                let error = edge + edges * COUNT - (self.place - since);
                if guides {
                    self.load.counts();
                    self.feels(model, error);
                }
                if by_way {
                    self.learns_by_way(config, delay, error);
                } else {
                    self.learns(config, drive, error);
                }
            }
            self.place = edge + since;
        }
        // No edge is an answer too: the rotor is still within its count.
        let inside = self.place.clamp(0, COUNT);
        let short = inside - self.place;
        if short != 0 {
            self.place = inside;
            if (short < 0) == (self.speed > 0) {
                self.speed -= self.speed / 8;
                if guides {
                    self.feels(model, short);
                }
                self.learns(config, drive, short);
            }
        }
        if guides {
            self.load.is_borne(self.braking);
        }
    }

    /// Corrects what the rotor's last stretch depended on: by `error`, how much farther it is than foretold.
    #[inline(always)]
    fn learns(&mut self, config: &Config, drive: i32, error: i32) {
        if !config.spec.learns {
            return;
        }
        let model = &config.model;
        // A jump by more is no motion of this rotor: a count's worth at the encoder it is meant for.
        let error = error.max(-8 * model.full).min(8 * model.full);
        match drive {
            // With a time constant of 512 ticks of drive: long against the encoder's unevenness, short against a turn.
            1 => self.full_cw = model.about(self.full_cw + error / 512),
            -1 => self.full_ccw = model.about(self.full_ccw - error / 512),
            // What a rotor that is known runs on too far is the load's, or is told apart from it.
            _ if self.load.is_known_roughly() => {}
            _ => {
                // The same share of the braking for each tick of full drive that the rotor went too far, or not far enough.
                let ticks = error.unsigned_abs() / (model.full.unsigned_abs() / 64).max(1);
                let share = ((u64::from(self.braking.unsigned_abs()) * u64::from(ticks)) >> 12) as i32;
                let brakes_less = (error > 0) == (self.speed > 0);
                self.braking = model.braked(self.braking + if brakes_less { -share } else { share });
            }
        }
    }

    /// Corrects the load by `error`, and the braking by what is no load.
    #[inline(always)]
    fn feels(&mut self, model: &Model, error: i32) {
        let push = self.load.tells(model, error);
        self.braking = model.braked(self.braking - self.speed.signum() * push);
    }

    /// The same where a pulse makes an edge or two: the error belongs to both, the drive and what it left, by how far the rotor
    /// went in each. Given to the last tick's alone, what the rotor runs on too far would be taken from the speed at full drive.
    #[inline(always)]
    fn learns_by_way(&mut self, config: &Config, delay: u8, error: i32) {
        // A state that was recorded may hold any.
        let (driven, coasted) = (self.driven.max(0).unsigned_abs() >> 8, self.coasted.max(0).unsigned_abs() >> 8);
        let of_drive = (((u64::from(driven) << 8) / u64::from((driven + coasted).max(1))) as i32).min(1 << 8);
        let full = config.model.full;
        let error = error.max(-8 * full).min(8 * full);
        let while_on = (error >> 8) * of_drive;
        self.learns(config, if (self.cw >> delay) & 1 == 1 { 1 } else { -1 }, while_on);
        self.learns(config, 0, error - while_on);
        (self.driven, self.coasted) = (0, 0);
    }

    /// How far the rotor goes on before it has come to the speed `rate`, relative to what moves at that rate.
    #[inline(always)]
    pub(super) fn runs_on(&self, speed: i32, rate: i32) -> i32 {
        let left = if self.on & 1 == 1 { speed - speed / 4 } else { speed };
        let over = (left - rate).clamp(-2 * FASTEST + 1, 2 * FASTEST - 1);
        // Speed squared over twice the braking, in 32 bits: 2·(20 - 9) bits over 20 - 4, and what is missing to 20 less the half.
        let square = (over.unsigned_abs() >> 9).pow(2);
        let braking = self.slows(over.signum());
        let way = ((square / (braking.unsigned_abs() >> 4).max(1)).min(1 << 14) << 13) as i32;
        if over < 0 { -way } else { way }
    }
}
