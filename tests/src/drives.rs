//! Ordinary motors drawn at random: a fourth source of data, which shares no model code with the host.
//!
//! Torque balance in small steps (at least 60 to the shortest time constant), friction with a rest rule of its own; inputs of six shapes
//! and a closed loop; speeds with noise, speeds rounded, or counts of an encoder. Orders of magnitude of gain, lag, noise and sampling are drawn.

mod visible;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// What is hidden in a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hidden {
    /// Nothing: a linear motor.
    Nothing,
    /// Coulomb friction.
    Coulomb,
    /// A dead zone in the input.
    DeadZone,
    /// A top that bends or is flat.
    Saturation,
    /// Directions that differ in gain.
    Asymmetry,
    /// A steady load.
    Load,
    /// A dead time of some samples.
    DeadTime,
    /// Coulomb friction, larger at rest.
    Stribeck,
    /// A torque that goes with the angle.
    Cogging,
    /// A load behind an elastic coupling, the sensor on either side of it.
    Coupling,
    /// A gain that falls as the motor warms: no effect of the host's library.
    Warmth,
}

impl Hidden {
    /// Those of the host's library.
    pub const KNOWN: [Hidden; 9] = [
        Hidden::Coulomb,
        Hidden::DeadZone,
        Hidden::Saturation,
        Hidden::Asymmetry,
        Hidden::Load,
        Hidden::DeadTime,
        Hidden::Stribeck,
        Hidden::Cogging,
        Hidden::Coupling,
    ];

    /// How the place begins in which the host should see what has no name in its library.
    pub fn lives_in(self) -> &'static str {
        match self {
            Hidden::Warmth => "time",
            _ => "",
        }
    }

    /// The names under which it is found; the first is its own.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Hidden::Nothing | Hidden::Warmth => &[],
            Hidden::Coulomb => &["coulomb-friction"],
            Hidden::DeadZone => &["dead-zone"],
            Hidden::Saturation => &["high-duty-saturation"],
            Hidden::Asymmetry => &["direction-asymmetry"],
            Hidden::Load => &["load-bias"],
            Hidden::DeadTime => &["dead-time"],
            Hidden::Stribeck => &["stribeck-friction", "coulomb-friction"],
            Hidden::Cogging => &["cogging"],
            Hidden::Coupling => &["coupling-resonance"],
        }
    }
}

/// One record.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Times in µs.
    pub time_us: Vec<f64>,
    /// Inputs in the drive's unit.
    pub input: Vec<f64>,
    /// Speeds in rpm.
    pub rpm: Vec<f64>,
    /// Angles in rad, where an encoder was read; the speeds are then not.
    pub angle_rad: Option<Vec<f64>>,
}

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Sensor {
    /// A speed with noise.
    Speed,
    /// A speed with noise, rounded to a step in rpm.
    Rounded(f64),
    /// Counts of an encoder with so many a turn.
    Counts(f64),
}

/// Shape of the input: one of those of [`Drive::input`], or what a controller makes of a target.
const LOOP: usize = 6;

/// A motor and how it is measured.
#[derive(Debug, Clone)]
pub struct Drive {
    hidden: Vec<Hidden>,
    gain: f64,
    lag: f64,
    largest: f64,
    period: f64,
    samples: usize,
    runs: usize,
    noise: f64,
    shape: usize,
    size: f64,
    sensor: Sensor,
    ripples: f64,
    seed: u64,
}

impl Drive {
    /// Drawn by a seed, with a speed sensor and a loop that is open.
    pub fn draw(hidden: &[Hidden], seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(7919).wrapping_add(17));
        let mut log = |low: f64, high: f64| low * (high / low).powf(rng.random::<f64>());
        let lag = log(3e-3, 0.8);
        let period = lag * log(0.03, 0.4);
        let (gain, largest, noise) = (log(30.0, 8000.0), log(0.5, 300.0), log(0.002, 0.02));
        let size = log(0.7, 1.4);
        let samples = log(800.0, 3000.0) as usize;
        let runs = rng.random_range(1..=4);
        let shape = rng.random_range(0..6);
        let hidden = hidden.to_vec();
        Self {
            hidden,
            gain,
            lag,
            largest,
            period,
            samples,
            runs,
            noise,
            shape,
            size,
            sensor: Sensor::Speed,
            ripples: 7.0,
            seed,
        }
    }

    /// The same with a sensor drawn too, and every ninth motor in a closed loop.
    pub fn draw_any(hidden: &[Hidden], seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(104_729).wrapping_add(5));
        let mut drive = Self::draw(hidden, seed);
        drive.ripples = f64::from(rng.random_range(1..=24));
        if drive.has(Hidden::Cogging) {
            // Where it can be felt: a tenth to twice a period while the lag passes at full speed.
            drive.gain = 60.0 * 0.1 * 20.0_f64.powf(rng.random()) / (drive.lag * drive.ripples);
        }
        drive.sensor = match rng.random_range(0..6) {
            0..=2 => Sensor::Speed,
            3 => Sensor::Rounded(drive.gain * 0.002 * 30.0_f64.powf(rng.random())),
            // From a hundred to ten thousand counts while the lag passes at full speed.
            _ => Sensor::Counts((100.0_f64.powf(1.0 + rng.random::<f64>()) * 60.0 / (drive.gain * drive.lag)).ceil()),
        };
        if rng.random_range(0..9) == 0 {
            drive.shape = LOOP;
        }
        drive
    }

    /// The same motor, measured in the same way, without something that is hidden in it.
    pub fn without(&self, hidden: Hidden) -> Self {
        Self { hidden: self.hidden.iter().copied().filter(|h| *h != hidden).collect(), ..self.clone() }
    }

    fn has(&self, hidden: Hidden) -> bool {
        self.hidden.contains(&hidden)
    }

    /// Periods of cogging to a turn.
    pub fn ripples(&self) -> f64 {
        self.ripples
    }

    /// What was drawn, in a line.
    pub fn describe(&self) -> String {
        let shape = ["sine", "levels", "PRBS", "triangle", "two sines", "chirp", "closed loop"][self.shape];
        let sensor = match self.sensor {
            Sensor::Speed => "speed".to_owned(),
            Sensor::Rounded(step) => format!("speed rounded to {:.3} of the largest", step / self.gain),
            Sensor::Counts(counts) => format!("{counts:.0} counts a turn"),
        };
        format!(
            "{shape}, {} x {} samples of {:.3} lags, lag {:.4} s, {:.0} rpm at {:.2}, noise {:.4}, {sensor}",
            self.runs,
            self.samples,
            self.period / self.lag,
            self.lag,
            self.gain,
            self.largest,
            self.noise
        )
    }

    /// What the host should find, by the names of its JSON: the lag, and the sizes whose equations are the host's own, as shares of the
    /// largest input that `records` hold.
    pub fn truth(&self, records: &[Record]) -> Vec<(&'static str, f64)> {
        let most = records.iter().flat_map(|r| &r.input).fold(0.0f64, |a, v| a.max(v.abs())) / self.largest;
        // Small steps of its own keep a little less than the lag they are steps of.
        let h = self.step();
        let mut truth = vec![("lag_s", -h / (1.0 - h / self.lag).ln())];
        for hidden in &self.hidden {
            truth.extend(match hidden {
                // Under a bend it is a share of what the host takes for the unbent gain.
                Hidden::Coulomb if self.has(Hidden::Saturation) => None,
                Hidden::Coulomb => Some(("coulomb", 0.12 * self.size / most)),
                Hidden::DeadZone => Some(("threshold", 0.15 * self.size / most)),
                Hidden::Asymmetry => Some(("gain_asymmetry", 0.06 * self.size)),
                Hidden::Load => Some(("bias", 0.06 * self.size / most)),
                Hidden::DeadTime => Some(("dead_time_s", (6.0 * self.size).round() * self.period)),
                Hidden::Cogging => Some(("cogging", 0.2 * self.size / most)),
                Hidden::Coupling => Some(("swing_s", self.coupling().swing_s)),
                Hidden::Nothing | Hidden::Saturation | Hidden::Stribeck | Hidden::Warmth => None,
            });
        }
        truth
    }

    /// The same motor, sampled at the same rate for so many samples in so many runs.
    pub fn lengthened(self, samples: usize, runs: usize) -> Self {
        Self { samples, runs, ..self }
    }

    /// The input of a run at a time, as a share of the largest.
    fn input(&self, run: usize, t: f64, levels: &[f64]) -> f64 {
        let whole = self.period * self.samples as f64;
        let x = t / whole;
        let tau = std::f64::consts::TAU;
        match self.shape {
            0 => (tau * t / (self.lag * (12.0 + 5.0 * run as f64)).min(whole / 3.0)).sin(),
            1 => levels[(t / (3.0 * self.lag)) as usize % levels.len()],
            // Of two heights in turn: one alone cannot show what bends or is lost, and what grows with the time is warmth too.
            2 => {
                let height = if ((8.0 * x) as usize).is_multiple_of(2) { 0.3 + 0.17 * run as f64 } else { 1.0 };
                levels[(t / (0.7 * self.lag)) as usize % levels.len()].signum() * height
            }
            3 => 1.0 - (4.0 * ((x + 0.13 * run as f64).rem_euclid(1.0)) - 2.0).abs(),
            4 => (tau * x * 2.0).sin() * 0.6 + 0.4 * (tau * x * (17.0 + run as f64)).sin(),
            _ => (tau * (2.0 * x + 8.0 * x * x)).sin() * (0.7 - 0.3 * (3.0 * tau * x).cos()),
        }
    }

    /// What the drive makes of an input.
    fn actuated(&self, input: f64) -> f64 {
        let mut u = input;
        if self.has(Hidden::DeadZone) {
            // Rounded at its corner, by a hundredth of the range.
            let over = u.abs() - 0.15 * self.size;
            u = u.signum() * 0.5 * (over + (over * over + 1e-4).sqrt());
        }
        if self.has(Hidden::Saturation) {
            u = match self.seed.is_multiple_of(2) {
                true => (1.6 * self.size * u).tanh() / (1.6 * self.size).tanh(),
                false => u.clamp(-0.7 / self.size, 0.7 / self.size),
            };
        }
        if self.has(Hidden::Asymmetry) {
            u *= 1.0 + 0.06 * self.size * u.signum();
        }
        if self.has(Hidden::Load) { u - 0.06 * self.size } else { u }
    }

    /// Friction at a speed, as a share of the largest torque.
    fn friction(&self, speed: f64) -> f64 {
        if self.has(Hidden::Stribeck) {
            self.size * (0.1 + 0.12 * (-(speed / (0.02 * self.gain)).powi(2)).exp())
        } else if self.has(Hidden::Coulomb) {
            0.12 * self.size
        } else {
            0.0
        }
    }

    /// Steps in which a sample is computed, and the length of one.
    fn steps(&self) -> usize {
        // Teeth that pass at full speed are quicker than the lag: a radian of them is as short as it gets.
        let tooth = 60.0 / (std::f64::consts::TAU * self.ripples * self.gain);
        let mut shortest = if self.has(Hidden::Cogging) { self.lag.min(tooth) } else { self.lag };
        if self.has(Hidden::Coupling) {
            // In steps of a sixtieth the swing itself would be a fifth of a per cent off.
            shortest = shortest.min(self.coupling().swing_s / 6.0);
        }
        (60.0 * self.period / shortest).ceil().max(20.0) as usize
    }

    fn step(&self) -> f64 {
        self.period / self.steps() as f64
    }

    /// The records.
    pub fn make(&self) -> Vec<Record> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        (0..self.runs).map(|run| self.run(run, &mut rng)).collect()
    }

    fn run(&self, run: usize, rng: &mut ChaCha8Rng) -> Record {
        let normal = Normal::new(0.0, 1.0).expect("a unit normal");
        let levels: Vec<f64> = (0..400).map(|_| rng.random_range(-1.0..1.0)).collect();
        let gain = self.gain * (1.0 + 0.003 * normal.sample(rng));
        let (mut rotor, mut integral) = (Rotor::at(0.0), 0.0);
        let mut inputs: Vec<f64> = Vec::new();
        let mut record = Record { time_us: Vec::new(), input: Vec::new(), rpm: Vec::new(), angle_rad: None };
        let mut angle = Vec::new();
        for k in 0..self.samples {
            let noisy = self.seen(&rotor) + self.noise * self.gain * normal.sample(rng);
            let measured = match self.sensor {
                Sensor::Rounded(step) => (noisy / step).round() * step,
                _ => noisy,
            };
            let t = k as f64 * self.period;
            let input = if self.shape == LOOP {
                let target = 0.8 * levels[(t / (4.0 * self.lag)) as usize % levels.len()];
                let error = target - measured / self.gain;
                integral += error * self.period / self.lag;
                (1.5 * error + 1.5 * integral).clamp(-1.0, 1.0)
            } else {
                self.input(run, t, &levels)
            };
            inputs.push(input);
            record.time_us.push(t * 1e6);
            record.input.push(self.largest * input);
            record.rpm.push(measured);
            if let Sensor::Counts(counts) = self.sensor {
                angle.push((rotor.turns * counts).round() / counts * std::f64::consts::TAU);
            }
            self.turn(&mut rotor, self.driven(&inputs, k), gain, self.lag);
        }
        if !angle.is_empty() {
            record.angle_rad = Some(angle);
        }
        record
    }

    /// What drives the rotor after sample `k` of these inputs.
    fn driven(&self, inputs: &[f64], k: usize) -> f64 {
        let late = if self.has(Hidden::DeadTime) { (6.0 * self.size).round() as usize } else { 0 };
        let warm = if self.has(Hidden::Warmth) { 1.0 - 0.2 * self.size * k as f64 / self.samples as f64 } else { 1.0 };
        warm * self.actuated(inputs[k.saturating_sub(late)])
    }

    /// Moves a rotor of a gain and a lag from one sample to the next.
    fn turn(&self, rotor: &mut Rotor, drive: f64, gain: f64, lag: f64) {
        let h = self.step();
        for _ in 0..self.steps() {
            let cogging = if self.has(Hidden::Cogging) {
                0.2 * self.size * (self.ripples * std::f64::consts::TAU * rotor.turns).cos()
            } else {
                0.0
            };
            let before = rotor.speed;
            let free: f64 = rotor.speed + h / lag * (gain * (drive + cogging) - rotor.speed);
            // Friction takes away at most what there is.
            let brake = h / lag * gain * self.friction(rotor.speed);
            rotor.speed = if free.abs() <= brake { 0.0 } else { free - brake * free.signum() };
            if self.has(Hidden::Coupling) {
                self.coupling().turn(rotor, before, h);
            }
            rotor.turns += self.seen(rotor) * h / 60.0;
        }
    }

    /// The speed that the sensor sees: every other motor's load, where there is one.
    fn seen(&self, rotor: &Rotor) -> f64 {
        if self.has(Hidden::Coupling) && self.seed.is_multiple_of(2) { rotor.load } else { rotor.speed }
    }

    /// The coupling of this motor, if it has one: quicker than the lag, or it were another lag; not so quick that no sample sees it.
    fn coupling(&self) -> Coupling {
        let of = |salt: f64, low: f64, high: f64| {
            let share = (self.seed as f64 * 0.618_033_988_7 * salt).fract();
            low * (high / low).powf(share)
        };
        Coupling {
            swing_s: (self.lag * of(1.0, 0.04, 0.25)).max(0.8 * self.period),
            damping: of(3.0, 0.02, 0.2),
            share: of(7.0, 0.4, 2.5),
        }
    }
}

/// A rotor at an instant.
struct Rotor {
    /// In rpm.
    speed: f64,
    /// Turns that the sensor saw.
    turns: f64,
    /// Speed of the load behind the coupling in rpm, and how far it is behind in rpm·s.
    load: f64,
    twist: f64,
}

impl Rotor {
    /// One that turns with its load at a speed in rpm.
    fn at(speed: f64) -> Self {
        Self { speed, turns: 0.0, load: speed, twist: 0.0 }
    }
}

/// A spring with some damping between the motor and a load.
struct Coupling {
    /// 1/ω₀ of the two inertias against one another, in s.
    swing_s: f64,
    damping: f64,
    /// Inertia of the load over the motor's.
    share: f64,
}

impl Coupling {
    /// Spring and damper over the load's inertia, in 1/s² and 1/s.
    fn parts(&self) -> (f64, f64) {
        let of = 1.0 + self.share;
        (self.swing_s.powi(-2) / of, 2.0 * self.damping / self.swing_s / of)
    }

    /// Moves on by `h`: what the torques from outside changed of the speed of both, `before` it, they change of the motor's alone, by the
    /// more as it is the lighter.
    fn turn(&self, rotor: &mut Rotor, before: f64, h: f64) {
        let (spring, damper) = self.parts();
        let torque = spring * rotor.twist + damper * (before - rotor.load);
        rotor.speed = before + (1.0 + self.share) * (rotor.speed - before) - h * self.share * torque;
        rotor.load += h * torque;
        rotor.twist += h * (rotor.speed - rotor.load);
    }
}
