//! How a target gives way to a load: the guided mode of a controller that has a model of its rotor.
//!
//! About its path the target is a spring and a damper without a mass, d·y' + k·y = torque, an admittance (Hogan, Impedance control,
//! J. Dyn. Sys. Meas. Control 107, 1985). Without a load that is worth believing it goes back to the path by itself.

use super::ConfigSpec;
use super::model::{COUNT, Model};
use serde::{Deserialize, Serialize};

/// How a target gives way: torques in nN·m, angles in counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GuideSpec {
    /// Farthest that the target leaves its path, counts; zero for a target that does not give way.
    pub limit_counts: u16,
    /// Torque that holds the target a count off its path, nN·m.
    pub stiffness_nnm: u32,
    /// Torque that moves it by a count a second, nN·m·s.
    pub damping_nnm_s: u32,
    /// Torques up to this are left alone, nN·m: the estimate's own error.
    pub dead_band_nnm: u32,
    /// Torque of the braking that the controller is told as `braking_counts_s2`, nN·m.
    pub braking_nnm: u32,
}

/// Farthest that a target may be asked to give way, counts: half of what errors are counted by.
const FARTHEST: u16 = 256;
/// Largest torque, nN·m: 1 N·m.
const STRONGEST: u32 = 1_000_000_000;

impl GuideSpec {
    /// The target stays on its path.
    pub const OFF: Self =
        Self { limit_counts: 0, stiffness_nnm: 0, damping_nnm_s: 0, dead_band_nnm: 0, braking_nnm: 0 };
    /// A target that gives way by a count for 5 µN·m, with a time constant of half a second, on a rotor that bears 197 µN·m as the
    /// measured 30 mm motor does: the example of `docs/control.md`.
    pub const EXAMPLE: Self = Self {
        limit_counts: 60,
        stiffness_nnm: 5_000,
        damping_nnm_s: 2_500,
        dead_band_nnm: 40_000,
        braking_nnm: 197_000,
    };
}

/// The same in ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Admittance {
    /// Farthest, 2^-20 count.
    farthest: i32,
    /// What a push of 1 (2^-20 count a tick, each tick) moves the target by in a tick, 2^-36 count.
    gives_way: u32,
    /// What share of the way the target goes back in a tick, 2^-32.
    goes_back: u32,
    /// Pushes that are left alone.
    dead_band: i32,
}

impl Admittance {
    /// Of a configuration; `None` where the numbers leave what fixed point holds.
    pub(super) fn of(spec: &ConfigSpec, model: &Model) -> Option<Self> {
        let guide = &spec.guide;
        if guide.limit_counts == 0 {
            return Some(Self::default());
        }
        let torques = [guide.stiffness_nnm, guide.damping_nnm_s, guide.braking_nnm];
        // A drive that is switched every tick leaves the rotor no way to run on by which a load could be told.
        let is_inside = guide.limit_counts <= FARTHEST
            && spec.has_pulse_period()
            && torques.iter().all(|torque| (1..=STRONGEST).contains(torque))
            && guide.dead_band_nnm < guide.braking_nnm;
        if !is_inside {
            return None;
        }
        // None is zero here; what divides is told so, or a panic would be kept for it.
        let [stiffness, damping, torque] = torques.map(|torque| u64::from(torque).max(1));
        let (period_us, braking) = (u64::from(spec.period_us), u64::from(model.braking.unsigned_abs()).max(1));
        // 30 + 14 bits, and 16 or 18 more: each product fits.
        let gives_way = ((((torque * period_us) << 16) / braking / damping) << 20) / 1_000_000;
        let goes_back = ((((stiffness * period_us) << 18) / damping) << 14) / 1_000_000;
        let dead_band = u64::from(guide.dead_band_nnm) * braking / torque;
        // A share below 2^-16 a tick would leave the target a sixteenth of a count off its path for good.
        ((1..=1 << 31).contains(&gives_way) && (1 << 16..=1 << 31).contains(&goes_back)).then_some(Self {
            farthest: i32::from(guide.limit_counts) * COUNT,
            gives_way: gives_way as u32,
            goes_back: goes_back as u32,
            dead_band: dead_band as i32,
        })
    }

    /// Whether the target ever gives way.
    pub(super) const fn is_on(&self) -> bool {
        self.farthest > 0
    }

    /// Moves the target by a tick, at most at half of full speed: by how much, 2^-20 count.
    #[inline(always)]
    pub(super) fn moves(&self, model: &Model, deviation: &mut i32, load: Option<i32>) -> i32 {
        let load = load.unwrap_or(0);
        let beyond = if load > 0 { (load - self.dead_band).max(0) } else { (load + self.dead_band).min(0) };
        let pushed = (i64::from(beyond) * i64::from(self.gives_way)) >> 16;
        let before = (*deviation).max(-self.farthest).min(self.farthest);
        let back = (i64::from(before) * i64::from(self.goes_back)) >> 32;
        let fastest = i64::from(model.full / 2);
        let step = (pushed - back).max(-fastest).min(fastest) as i32;
        *deviation = (before + step).max(-self.farthest).min(self.farthest);
        *deviation - before
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::super::motor::Motor;
    use super::super::{Config, ConfigError, State, step};
    use super::*;
    use crate::reference::Reference;
    use std::vec::Vec;

    const GUIDED: ConfigSpec = ConfigSpec { guide: GuideSpec::EXAMPLE, ..ConfigSpec::PLANNED };

    /// Follows a reference for some seconds under a hand that comes after ten, of a share of what the rotor bears; gives, of the seconds
    /// after two more, the mean load believed (1 of the braking), how often, and the farthest deviation (counts); and every duty.
    fn follows(reference: &Reference, push: f64, seconds: u32) -> ([f64; 3], Vec<bool>) {
        let config = Config::try_from(GUIDED).unwrap();
        let (mut state, mut motor) = (State::REST, Motor::new(234.0, 16_400.0));
        let (mut drive, mut on) = ((0, crate::Direction::Ccw), Vec::new());
        let (mut sum, mut believed, mut farthest, mut ticks) = (0.0, 0.0, 0.0f64, 0.0);
        for tick in 0..seconds * 2_000 {
            let inputs = motor.sees(reference, tick);
            let out = step(&config, &mut state, inputs);
            motor.push = if tick > 20_000 { push * 16_400.0 * 500e-6 * 500e-6 } else { 0.0 };
            motor.turn(drive.0, drive.1, f64::from(tick + 1));
            drive = (i32::from(out.on_steps > 0) * out.direction.sign(), out.direction);
            on.push(out.on_steps > 0);
            if tick > 24_000 {
                let load = state.load_nnm(&config);
                sum += load.map_or(0.0, |load| f64::from(load) / 197_000.0);
                believed += f64::from(u8::from(load.is_some()));
                farthest = farthest.max(f64::from(state.deviation.abs()) / f64::from(COUNT));
                ticks += 1.0;
            }
        }
        ([sum / f64::max(believed, 1.0), believed / f64::max(ticks, 1.0), farthest], on)
    }

    const SINE: Reference = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };

    /// Fails when a load has the wrong sign, is not believed, or moves no target. Its size is known by a factor only: what it does to an
    /// edge looks much like another speed.
    #[test]
    fn a_hand_is_felt_while_the_rotor_moves_and_the_target_gives_way() {
        for push in [-0.4, 0.0, 0.4] {
            let ([load, believed, farthest], _) = follows(&SINE, push, 30);
            let [low, high] = [0.3 * push, 1.5 * push].map(f64::abs);
            assert!((low - 0.1..high + 0.1).contains(&(load * push.signum())), "{push}: {load}");
            assert!(believed > 0.7, "{push}: believed {believed}");
            assert!(farthest < 61.0 && (push == 0.0 || farthest > 3.0), "{push}: {farthest} counts");
        }
    }

    /// Fails when anything but the path moves a rotor at rest: a hand that it bears shows nothing there, and is not made up.
    #[test]
    fn a_rotor_at_rest_is_not_moved_by_a_hand() {
        for push in [-0.9, 0.9] {
            let ([_, believed, farthest], on) = follows(&Reference::Step { position: 40, at_us: 0 }, push, 16);
            assert_eq!((believed, farthest), (0.0, 0.0), "{push}");
            assert!(!on[2_000..].contains(&true), "{push}: driven at rest");
        }
    }

    #[test]
    fn targets_that_fixed_point_cannot_let_give_way_are_refused() {
        let with = |change: fn(&mut ConfigSpec)| {
            let mut spec = GUIDED;
            change(&mut spec);
            Config::try_from(spec).map(|_| ())
        };
        let refused: [fn(&mut ConfigSpec); 9] = [
            |s| s.guide.limit_counts = 257,
            |s| s.guide.stiffness_nnm = 0,
            |s| s.guide.stiffness_nnm = 1_000_000_000,
            |s| s.guide.damping_nnm_s = 0,
            |s| s.guide.damping_nnm_s = 1_000_000_000,
            |s| s.guide.dead_band_nnm = 197_000,
            |s| s.guide.braking_nnm = 1_000_000_001,
            |s| s.pulse_period_ticks = 1,
            |s| s.law = super::super::DriveLaw::OnTimeRounded,
        ];
        for (k, change) in refused.into_iter().enumerate() {
            assert_eq!(with(change), Err(ConfigError::Guide), "{k}");
        }
        assert_eq!(with(|s| s.guide.limit_counts = 256), Ok(()));
        assert_eq!(with(|s| s.guide = GuideSpec { limit_counts: 0, ..GuideSpec::OFF }), Ok(()));
    }
}
