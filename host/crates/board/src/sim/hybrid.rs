//! The hybrid motor model behind the board's seam, and what a board that simulates one says of itself.

use super::Setup;
use super::driver_board::DriverHealth;
use super::motor::{FirstOrderMotor, SimulatedMotor};
use thiserror::Error;
use twum_motor::actuator::{effective_duty, start_delay_s};
use twum_motor::effects::EffectSet;
use twum_motor::motor::Motor;
use twum_motor::motor_plant::{History, MotorPlant, Solver};
use twum_motor::parameters::Flavour;
use twum_motor::plant::{Drive, Plant};
use twum_shared::Direction;

/// What a simulated board says of itself in the place of a chip's name: `simulated`, the motor's name, the flavour, and
/// `+effects` where some are hidden in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Simulated {
    /// Name of the motor, or `simple`.
    pub motor: String,
    /// Flavour of the model; none for the simple motor.
    pub flavour: Option<Flavour>,
    /// Whether effects are hidden in it.
    pub effects: bool,
}

impl Simulated {
    /// Reads what a board says; none for a real one.
    pub fn parse(chip: &str) -> Option<Self> {
        let mut words = chip.split(' ');
        if words.next()? != "simulated" {
            return None;
        }
        let motor = words.next()?.to_owned();
        let rest: Vec<&str> = words.collect();
        let flavour = Flavour::ALL.into_iter().find(|f| rest.contains(&f.to_string().as_str()));
        Some(Self { motor, flavour, effects: rest.contains(&"+effects") })
    }
}

impl std::fmt::Display for Simulated {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "simulated {}", self.motor)?;
        if let Some(flavour) = self.flavour {
            write!(f, " {flavour}")?;
        }
        if self.effects { f.write_str(" +effects") } else { Ok(()) }
    }
}

/// An effect that a simulated board cannot have.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("`{name}` cannot be hidden in a simulated board: {reason}")]
pub struct NotOnABoard {
    /// The effect.
    pub name: &'static str,
    /// Why.
    pub reason: &'static str,
}

impl Setup {
    /// A board with the simple motor.
    pub fn simple() -> Self {
        let motor = Simulated { motor: "simple".to_owned(), flavour: None, effects: false };
        Self { simulates: motor.to_string(), motor: Box::new(FirstOrderMotor::default()), ..Self::default() }
    }

    /// A board with a motor of the hybrid model, averaged; `hidden` effects join those its file lists.
    ///
    /// # Errors
    /// For an effect of the controller (the board runs the firmware's own), or of the record.
    pub fn hybrid(motor: &Motor, flavour: Flavour, hidden: &EffectSet) -> Result<Self, NotOnABoard> {
        let mut effects = motor.effects();
        effects.join(hidden);
        for (info, _) in effects.present() {
            let name = info.name;
            let reason = match name {
                "dropped-samples" => "the firmware sends every sample",
                "reversal-miscount" => "the firmware counts every edge the encoder makes",
                "loop-delay" | "controller-mismatch" => "the controller is the firmware's own",
                _ => continue,
            };
            return Err(NotOnABoard { name, reason });
        }
        let described =
            Simulated { motor: motor.name.clone(), flavour: Some(flavour), effects: *hidden != EffectSet::default() };
        let plant = MotorPlant::new(motor.parameters(flavour), flavour, Solver::Averaged, &effects, History::default());
        Ok(Self {
            edges_per_rev: motor.edges_per_rev,
            simulates: described.to_string(),
            encoder_effects: effects.clone(),
            motor: Box::new(HybridMotor::new(plant, effects)),
            driver: DriverHealth::Well,
            ..Self::default()
        })
    }
}

/// The shortest step the plant makes (s): a thousandth of the simulated board's microsecond.
const SHORTEST_S: f64 = 1e-9;

/// A motor model with the effects of the actuator in front of it.
#[derive(Clone, Debug)]
pub struct HybridMotor {
    plant: MotorPlant,
    effects: EffectSet,
    nudged_rad: f64,
    duty: f64,
    period_s: f64,
    /// Time since the pin went on (s); none while it is off.
    on_s: Option<f64>,
    /// How long the pin was off before it went on, or has been (s).
    rest_s: f64,
}

impl HybridMotor {
    /// Puts a motor at rest on the board.
    pub fn new(plant: MotorPlant, effects: EffectSet) -> Self {
        Self { plant, effects, nudged_rad: 0.0, duty: 0.0, period_s: 0.02, on_s: None, rest_s: f64::INFINITY }
    }

    /// What the effects of the actuator take off each period's on time (s). A duty that they round up stays as the pin has it.
    fn lost_s(&self, direction: Direction) -> f64 {
        (self.duty - effective_duty(&self.effects, self.duty, direction)).max(0.0) * self.period_s
    }

    fn run(&mut self, dt_s: f64, level: f64, direction: Direction) {
        // Rounding leaves slivers of a step over, and a step of no length has no slope.
        if dt_s > SHORTEST_S {
            let until_s = self.plant.time_s() + dt_s;
            self.plant.advance(until_s, Drive { level, direction, duty: self.duty }, &mut |_| {});
        }
    }
}

impl SimulatedMotor for HybridMotor {
    fn pwm(&mut self, duty: f64, period_s: f64) {
        (self.duty, self.period_s) = (duty, period_s);
    }

    fn advance(&mut self, dt_s: f64, drive_on: bool, direction: Direction) -> f64 {
        // A board whose clock runs fast makes its ticks and its PWM in less time than it says.
        let dt_s = dt_s / (1.0 + self.effects.clock_error.map_or(0.0, |e| e.error));
        if drive_on {
            let (mut since_s, lost_s) = (self.on_s.unwrap_or(0.0), self.lost_s(direction));
            // Under full duty the pin never goes off: what is taken off a period, is taken off every one.
            if lost_s > 0.0 && since_s >= self.period_s {
                since_s -= self.period_s;
            }
            let late_s = lost_s + start_delay_s(&self.effects, self.rest_s);
            let off_s = (late_s - since_s).clamp(0.0, dt_s);
            self.run(off_s, 0.0, direction);
            self.run(dt_s - off_s, 1.0, direction);
            self.on_s = Some(since_s + dt_s);
        } else {
            self.run(dt_s, 0.0, direction);
            self.rest_s = dt_s + if self.on_s.take().is_some() { 0.0 } else { self.rest_s };
        }
        self.plant.position_rad() + self.nudged_rad
    }

    fn nudge(&mut self, angle_rad: f64) {
        self.nudged_rad += angle_rad;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_board_says_of_itself_is_read_back() {
        for (motor, flavour, effects) in [
            ("pcbmotor-30mm", Some(Flavour::Measured), true),
            ("simple", None, false),
            ("a", Some(Flavour::Thesis), false),
        ] {
            let said = Simulated { motor: motor.to_owned(), flavour, effects };
            assert_eq!(Simulated::parse(&said.to_string()), Some(said));
        }
        assert_eq!(Simulated::parse("esp32c3"), None);
        assert_eq!(Simulated::parse("simulated"), None);
    }

    /// Steady speed of a board's motor under full drive, rad/s, at 50 Hz.
    fn speed(motor: &mut HybridMotor, on_us: u32) -> f64 {
        motor.pwm(f64::from(on_us) / 20_000.0, 0.02);
        let mut at = [0.0; 2];
        for (i, angle) in at.iter_mut().enumerate() {
            for step in 0..(20_000 / 50 * 20) {
                let on = (step * 50) % 20_000 >= 20_000 - on_us;
                *angle = motor.advance(50e-6, on, Direction::Cw);
            }
            assert!(i == 0 || *angle > 0.0);
        }
        (at[1] - at[0]) / 0.4
    }

    fn hybrid(name: &str, values: &[f64]) -> HybridMotor {
        let motor = Motor::pcbmotor_30mm();
        let mut effects = EffectSet::default();
        effects.set(name, values).unwrap();
        let flavour = Flavour::Physical;
        let plant = MotorPlant::new(motor.parameters(flavour), flavour, Solver::Averaged, &effects, History::default());
        HybridMotor::new(plant, effects)
    }

    /// The clamped motor's speed goes with its on time, so what the actuator takes off shows in proportion.
    #[test]
    fn actuator_effects_take_their_share_of_the_on_time() {
        let none = speed(&mut hybrid("dead-zone", &[0.0]), 10_000);
        let dead = speed(&mut hybrid("dead-zone", &[0.1]), 10_000);
        assert!((dead / none - 0.8).abs() < 0.02, "{dead} of {none}");
        let late = speed(&mut hybrid("start-delay", &[1e-3]), 10_000);
        assert!((late / none - 0.9).abs() < 0.02, "{late} of {none}");
        // After a rest as long as its own, 1 − 1/e of the delay is there.
        let rested = speed(&mut hybrid("start-delay", &[1e-3, 0.01]), 10_000);
        assert!((rested / none - 0.937).abs() < 0.01, "{rested} of {none}");
        let cut = speed(&mut hybrid("duty-quantisation", &[0.2, 1.0]), 10_000);
        assert!((cut / none - 0.8).abs() < 0.02, "{cut} of {none}");
        let bent = speed(&mut hybrid("high-duty-saturation", &[1.0]), 10_000);
        assert!((bent / none - 1.0 / 1.5).abs() < 0.02, "{bent} of {none}");
        let mut full = hybrid("dead-zone", &[0.08]);
        full.pwm(1.0, 0.02);
        let angle = (0..100_000).fold(0.0, |_, _| full.advance(50e-6, true, Direction::Cw));
        assert!(angle > 10.0, "{angle} rad after five seconds");
        let full = speed(&mut hybrid("dead-zone", &[0.1]), 20_000) / speed(&mut hybrid("dead-zone", &[0.0]), 20_000);
        assert!((full - 0.9).abs() < 0.02, "{full} at full duty");
        let fast = speed(&mut hybrid("clock-error", &[0.1]), 10_000);
        assert!((fast * 1.1 / none - 1.0).abs() < 0.02, "{fast} of {none}");
    }
}
