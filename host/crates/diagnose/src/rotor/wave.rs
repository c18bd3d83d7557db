//! The wave's height after a switching.

use super::motion::decayed;
use nalgebra::Complex;

/// The stator's wave: it follows the drive with a time constant, and carries the more of the contact the higher it is.
///
/// Of a resonance of half-width 1/τ that is driven beside it by `detuning` half-widths, the amplitude a in the frame that turns with the drive
/// follows τ·ȧ = (1 + i·detuning)·(goal − a); the wave is as high as |a|. It rises faster than beside no detuning, and a little too high.
///
/// A wave of height h carries h²/(h² + lift²) of the contact, as its energy is a share of what lifts the rotor off.
pub(super) struct Wave {
    /// Time constants in s of building up and of dying away.
    builds_up_s: f64,
    dies_s: f64,
    detuning: f64,
    /// Share of its full height at which it carries half of the contact.
    lift: f64,
    /// Share of its full height from which its pull overcomes the friction of what it does not carry.
    overcomes: f64,
    /// Speed of the full crest in rad/s.
    pub(super) full: f64,
    /// What the contact accelerates or brakes the rotor by, in rad/s².
    pub(super) rate: f64,
    /// Whether it is driven, since when (s), and its amplitude then (1: the full one).
    driven: bool,
    since: f64,
    amplitude: Complex<f64>,
    /// Where the course that was asked for last ended (s), and its amplitude there.
    reached: (f64, Complex<f64>),
    /// What came of the last fall and of the last rise, which the next may repeat.
    switchings: [Switching; 2],
}

/// A straight course between two times, which is as high as the wave on average.
#[derive(Debug, Clone, Copy)]
pub(super) struct Course {
    /// Its height at both ends.
    pub(super) heights: [f64; 2],
    /// Share of the contact that it carries on average.
    pub(super) carried: f64,
}

/// What a wave does after it was switched: nothing else decides it than how high it was.
#[derive(Default)]
struct Switching {
    amplitude: Complex<f64>,
    /// When it begins to move the rotor, or stops, in s after the switching.
    overcomes: Option<f64>,
    steps: Vec<Step>,
    /// The step that comes next where they are repeated.
    next: usize,
}

/// A course with its ends in s after the switching, and the wave's amplitude at its end.
struct Step {
    from: f64,
    to: f64,
    course: Course,
    amplitude: Complex<f64>,
}

/// Time constants after which the wave is at its height, or gone, to a few thousandths.
const SETTLED: f64 = 5.0;
/// First step after a switching, and how later ones grow with the time since a rise, in time constants: the crest moves in a straight line
/// within one.
const STEP: f64 = 0.5;
const GROWTH: f64 = 1.0;

impl Wave {
    /// A wave that is not driven and not there; `rates` are what the contact accelerates the rotor by with it and brakes by without it.
    pub(super) fn new([builds_up_s, dies_s]: [f64; 2], detuning: f64, lift: f64, full: f64, rates: [f64; 2]) -> Self {
        let [rate, brake] = rates;
        let lift = lift.max(GONE);
        // h²/(h² + lift²) of the one is as much as the rest of the other. How fast a rotor stops that stops at once does not show, and says nothing
        // of how it starts.
        let overcomes = (lift * (brake / rate).sqrt().clamp(HARDLY_CARRIES, 1.0)).clamp(GONE, MOST_LIFT);
        let (driven, since, amplitude) = (false, 0.0, Complex::ZERO);
        let reached = (f64::NAN, amplitude);
        let switchings = Default::default();
        Self {
            builds_up_s,
            dies_s,
            detuning,
            lift,
            overcomes,
            full,
            rate,
            driven,
            since,
            amplitude,
            reached,
            switchings,
        }
    }

    /// Where it goes, and in which time constant (s).
    fn going(&self) -> (f64, f64) {
        if self.driven { (1.0, self.builds_up_s) } else { (0.0, self.dies_s) }
    }

    /// What is kept of the way to its goal after so many time constants.
    fn kept(&self, time_constants: f64) -> Complex<f64> {
        match decayed(time_constants) {
            0.0 => Complex::ZERO,
            kept => Complex::from_polar(kept, -self.detuning * time_constants),
        }
    }

    /// Its amplitude, 1 where it is steady.
    pub(super) fn amplitude_at(&self, t: f64) -> Complex<f64> {
        let (goal, tau) = self.going();
        if tau <= 0.0 {
            // Without inertia it is where it goes at once.
            Complex::from(goal)
        } else if t == self.reached.0 {
            self.reached.1
        } else {
            (self.amplitude - goal) * self.kept((t - self.since).max(0.0) / tau) + goal
        }
    }

    /// Its height as a share of the full one.
    pub(super) fn height_at(&self, t: f64) -> f64 {
        height(self.amplitude_at(t))
    }

    /// Its course between two times after the switching.
    pub(super) fn course(&mut self, from: f64, to: f64) -> Course {
        let ages = [from - self.since, to - self.since];
        let now = &mut self.switchings[usize::from(self.driven)];
        if let Some(step) = now.steps.get(now.next)
            && (step.from - ages[0]).abs().max((step.to - ages[1]).abs()) < SAME_TIME_S
        {
            now.next += 1;
            self.reached = (to, step.amplitude);
            return step.course;
        }
        let (course, amplitude) = self.stepped(from, to);
        self.reached = (to, amplitude);
        let now = &mut self.switchings[usize::from(self.driven)];
        now.steps.truncate(now.next);
        now.steps.push(Step { from: ages[0], to: ages[1], course, amplitude });
        now.next += 1;
        course
    }

    /// The course, and the amplitude at its end.
    fn stepped(&self, from: f64, to: f64) -> (Course, Complex<f64>) {
        let start = self.amplitude_at(from);
        let (goal, tau) = self.going();
        if tau <= 0.0 {
            let end = self.amplitude_at(to);
            let heights = [start, end].map(height);
            return (Course { heights, carried: self.carried(heights) }, end);
        }
        let half = self.kept(0.5 * (to - from) / tau);
        let middle = (start - goal) * half + goal;
        let end = (middle - goal) * half + goal;
        let ends = [start, end].map(height);
        // What Simpson's rule adds to the mean of the ends.
        let bend = (2.0 * height(middle) - ends[0] - ends[1]) * (1.0 / 3.0);
        let heights = ends.map(|height| height + bend);
        (Course { heights, carried: self.carried(heights) }, end)
    }

    /// Share of the contact that it carries on average over a straight course between two heights.
    fn carried(&self, heights: [f64; 2]) -> f64 {
        let [from, to] = heights.map(|height| height / self.lift);
        let apart = to - from;
        if apart == 0.0 {
            return from * from / (1.0 + from * from);
        }
        // The difference of their arc tangents.
        1.0 - (apart / (1.0 + from * to)).atan() / apart
    }

    /// The drive is switched at `t`.
    pub(super) fn switch(&mut self, t: f64, driven: bool) {
        self.amplitude = self.amplitude_at(t);
        self.reached = (t, self.amplitude);
        self.since = t;
        self.driven = driven;
        let amplitude = self.amplitude;
        let now = &mut self.switchings[usize::from(driven)];
        now.next = 0;
        if (now.amplitude - amplitude).norm_sqr() > AS_HIGH * AS_HIGH {
            *now = Switching { amplitude, ..Switching::default() };
        }
    }

    /// What happened before lies `later` seconds later: a period that repeats one before it.
    pub(super) fn shift(&mut self, later: f64) {
        self.since += later;
        self.reached.0 += later;
    }

    pub(super) fn driven(&self) -> bool {
        self.driven
    }

    /// When it begins to move the rotor after a rise, or stops after a fall.
    pub(super) fn overcomes_at(&mut self) -> f64 {
        let now = usize::from(self.driven);
        let after = self.switchings[now].overcomes.unwrap_or_else(|| self.crossed_at() - self.since);
        self.switchings[now].overcomes = Some(after);
        self.since + after
    }

    /// The same, found anew.
    fn crossed_at(&self) -> f64 {
        let (_, tau) = self.going();
        let from = height(self.amplitude);
        if self.driven == (from >= self.overcomes) || tau <= 0.0 {
            return self.since;
        }
        if !self.driven {
            return self.since + tau * (from / self.overcomes).ln();
        }
        // Newton's rule within what is known to hold the crossing: what is left of the last pulse may turn the wrong way at first.
        let (mut below, mut above) = (0.0, SETTLED * tau);
        let mut at = (tau * self.overcomes).min(above);
        for _ in 0..CROSSINGS {
            let a = self.amplitude_at(self.since + at);
            let now = height(a);
            let beyond = now - self.overcomes;
            if beyond < 0.0 {
                below = at
            } else {
                above = at
            }
            let half_energy_slope = (a.conj() * Complex::new(1.0, self.detuning) * (1.0 - a)).re / tau;
            let next = at - beyond * now / half_energy_slope;
            let known = next > below && next < above;
            let next = if known { next } else { 0.5 * (below + above) };
            if (next - at).abs() < CROSSED * tau {
                return self.since + next;
            }
            at = next;
        }
        self.since + at
    }

    /// The longest step from `t` in which the crest moves in a straight line.
    pub(super) fn step_s(&self, t: f64) -> f64 {
        let (age, (_, tau)) = ((t - self.since).max(0.0), self.going());
        if self.driven && age >= SETTLED * tau {
            f64::INFINITY
        } else if self.driven {
            (STEP * tau).max(GROWTH * age)
        } else {
            STEP * tau
        }
    }
}

/// The height of a wave of an amplitude.
fn height(amplitude: Complex<f64>) -> f64 {
    amplitude.norm_sqr().sqrt()
}

/// Steps to a crossing at most, by halves from five time constants, and of how many time constants the last one is: the next would be
/// its square.
const CROSSINGS: usize = 30;
const CROSSED: f64 = 1e-5;
/// Times in s that are the same but for their last digits, and amplitudes from which a wave goes the same way: a hundredth of what periods that
/// repeat each other differ by.
const SAME_TIME_S: f64 = 1e-12;
const AS_HIGH: f64 = 1e-9;
/// Height at which a wave is gone (e⁻⁵), and one from which it has to carry: at its full height alone it would not at all.
const GONE: f64 = 0.0067;
const MOST_LIFT: f64 = 0.9;
/// Share of the lift below which a wave is as good as none: it carries a hundredth of the contact.
const HARDLY_CARRIES: f64 = 0.1;

#[cfg(test)]
mod tests {
    use super::*;

    /// When the drive is switched in s, on first: as the second pulse begins a twelfth of the first one's amplitude is left, a third of a turn
    /// behind.
    const SWITCHED: [f64; 4] = [0.0, 4e-3, 6.5e-3, 9e-3];
    const TAU: f64 = 1e-3;
    const DETUNING: f64 = 0.8;

    /// Amplitudes every 10 µs by the equation, in steps of 0.1 µs with the slope of their middle.
    fn stepped() -> Vec<Complex<f64>> {
        let mut a = Complex::ZERO;
        let mut all = vec![a];
        let dt = 1e-7;
        for k in 0..120_000 {
            let t = (f64::from(k) + 0.5) * dt;
            let on = SWITCHED.iter().filter(|s| t > **s).count() % 2 == 1;
            let slope =
                |a: Complex<f64>| (Complex::from(f64::from(u8::from(on))) - a) * Complex::new(1.0, DETUNING) / TAU;
            a += slope(a + slope(a) * (0.5 * dt)) * dt;
            if (k + 1) % 100 == 0 {
                all.push(a);
            }
        }
        all
    }

    /// Every stretch between two switchings, with its start in s and a wave that was switched there.
    fn switched(lift: f64) -> Vec<(f64, f64, Wave)> {
        let mut ends: Vec<f64> = SWITCHED[1..].to_vec();
        ends.push(12e-3);
        let wave = |k: usize| {
            let mut wave = Wave::new([TAU; 2], DETUNING, lift, 1.0, [1.0; 2]);
            (0..=k).for_each(|j| wave.switch(SWITCHED[j], j % 2 == 0));
            wave
        };
        (0..SWITCHED.len()).map(|k| (SWITCHED[k], ends[k], wave(k))).collect()
    }

    /// Fails if the wave is not turned beside its resonance (a first pulse then rises by a fifth less in its first millisecond), or if a
    /// course is not as high as the wave on average.
    #[test]
    fn a_wave_beside_its_resonance_is_what_small_steps_say() {
        let reference: Vec<f64> = stepped().into_iter().map(height).collect();
        let at = |t: f64| (t / 1e-5).round() as usize;
        assert!(reference.iter().copied().fold(0.0, f64::max) > 1.01, "it rises too high");
        for (from, until, mut wave) in switched(0.1) {
            let mut t = from;
            while t < until - 1e-9 {
                let end = (t + 5e-4).min(until);
                let [a, b] = wave.course(t, end).heights;
                let between = &reference[at(t)..=at(end)];
                let ends = 0.5 * (between[0] + between[between.len() - 1]);
                let mean = (between.iter().sum::<f64>() - ends) / (between.len() - 1) as f64;
                assert!((wave.height_at(end) - between[between.len() - 1]).abs() < 1e-5, "at {end}");
                // What is left of the first pulse turns round near 0 as the second begins, which no parabola does.
                let most = if t == SWITCHED[2] { 0.02 } else { 1e-3 };
                assert!((0.5 * (a + b) - mean).abs() < most, "from {t}: {} for {mean}", 0.5 * (a + b));
                t = end;
            }
        }
    }

    /// Fails if a rise is taken to be an exponential one, or if it is looked for beyond its bracket.
    #[test]
    fn it_moves_the_rotor_from_where_small_steps_cross_its_lift() {
        let reference: Vec<f64> = stepped().into_iter().map(height).collect();
        for lift in [0.05, 0.12, 0.3] {
            for (from, until, mut wave) in switched(lift) {
                let crossed = wave.overcomes_at();
                let above = |k: usize| (reference[k] >= lift) == wave.driven();
                let first = (from / 1e-5).round() as usize;
                let Some(there) = (first..=(until / 1e-5).round() as usize).find(|k| above(*k)) else {
                    assert!(crossed > until - 2e-5, "{lift} from {from}: {crossed}");
                    continue;
                };
                assert!((crossed - there as f64 * 1e-5).abs() < 1.1e-5, "{lift} from {from}: {crossed}, {there}");
            }
        }
    }

    /// Pulses of 4 ms every 6 ms, of which the second begins on what is left of the first, and the third as the second did but for e⁻⁶ of it. Fails if
    /// a switching repeats one before it that began at another height, or at another time of its own.
    #[test]
    fn a_switching_repeats_only_one_that_began_as_high() {
        let mut wave = Wave::new([TAU; 2], DETUNING, 0.1, 1.0, [1.0; 2]);
        let ends: Vec<f64> = (0..12).map(|k| 3e-3 * f64::from(k) + if k % 2 == 1 { 1e-3 } else { 0.0 }).collect();
        for k in 0..ends.len() - 1 {
            wave.switch(ends[k], k % 2 == 0);
            let mut alone = Wave::new([TAU; 2], DETUNING, 0.1, 1.0, [1.0; 2]);
            (0..=k).for_each(|j| alone.switch(ends[j], j % 2 == 0));
            assert!((wave.overcomes_at() - alone.overcomes_at()).abs() < 1e-8, "{k}");
            // Other steps each time but for the first.
            let half = ends[k] + (0.4 + 0.01 * k as f64) * (ends[k + 1] - ends[k]);
            for [from, to] in [[ends[k], ends[k] + 5e-4], [ends[k] + 5e-4, half], [half, ends[k + 1]]] {
                let (repeated, own) = (wave.course(from, to), alone.stepped(from, to).0);
                let apart = repeated.heights[0] - own.heights[0] + repeated.heights[1] - own.heights[1];
                assert!(
                    apart.abs().max((repeated.carried - own.carried).abs()) < 1e-7,
                    "{k}: {repeated:?} for {own:?}"
                );
            }
        }
    }
}
