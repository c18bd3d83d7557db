//! An effect of the user's own: where it acts, a formula over what the motor does, and the numbers in it.
//!
//! ```toml
//! [effects.mine]
//! says = "the drive weakens in the first seconds, the more the harder it is driven"   # optional
//! acts_on = "speed"                            # speed, torque, braking or duty
//! change = "-a*duty*(1 - exp(-time_s/tau))"    # relative; of the duty, what is added to it
//!
//! [effects.mine.numbers]
//! a = { typical = 0.1, min = 0.0, max = 0.5 }  # a size: where all sizes are 0, nothing changes
//! tau = { start = 1.0, min = 0.1, max = 20.0 } # a number of the form
//! ```
//!
//! A diagnosis fits the numbers; the file that it saves holds the `value` of each, and simulates. What it describes without a cause
//! is saved in the same form, as `[effects.described]`.

use exmex::{Express, FlatEx, FloatOpsFactory, MatchLiteral, literal_matcher_from_pattern};
use serde::ser::{Serialize, SerializeMap, Serializer};
use std::sync::Arc;

/// The unit of a number that has none.
pub const DIMENSIONLESS: &str = "1";
/// Longest name of an effect: it stands in tables.
const LONGEST_NAME: usize = 40;
/// The name in files of what a diagnosis describes and has no cause for: a formula like a user's own.
pub const DESCRIBED: &str = "described";

/// What a formula may hang on, in the order of the fields of [`Now`].
pub const VARIABLES: [(&str, &str); 7] = [
    ("duty", "commanded duty of the running PWM period"),
    ("time_s", "time since the drive began"),
    ("on_s", "time with the drive on since then"),
    ("turned_rad", "angle of the encoder's shaft since the record began"),
    ("speed_rad_s", "speed of the rotor"),
    ("direction", "1 or -1"),
    ("revolutions", "turned in all runs so far, either way"),
];

/// Most numbers in a formula: more than four cannot be told apart by the runs of a bench.
pub const MOST_NUMBERS: usize = 4;
literal_matcher_from_pattern!(Decimal, r"^([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?");

/// A formula as it is evaluated; its numbers may have an exponent.
type Expression = FlatEx<f64, FloatOpsFactory<f64>, Decimal>;

/// Longest formula in characters: its parser calls itself for every parenthesis.
pub const LONGEST: usize = 500;
/// A change beyond which the formula is no small correction of the model, which is bounded there (1).
const LARGEST_CHANGE: f64 = 3.0;

/// The state of the motor that a formula sees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Now {
    /// Commanded duty.
    pub duty: f64,
    /// Time since the drive began in s.
    pub time_s: f64,
    /// Time with the drive on since then in s.
    pub on_s: f64,
    /// Angle since the record began in rad.
    pub turned_rad: f64,
    /// Speed in rad/s.
    pub speed_rad_s: f64,
    /// 1 or −1.
    pub direction: f64,
    /// Turned in all runs so far.
    pub revolutions: f64,
}

impl Now {
    fn array(&self) -> [f64; VARIABLES.len()] {
        [self.duty, self.time_s, self.on_s, self.turned_rad, self.speed_rad_s, self.direction, self.revolutions]
    }
}

/// What a change is a change of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ActsOn {
    /// The speed that the wave draws the rotor to, relative.
    Speed,
    /// The torque of the contact under drive, relative.
    Torque,
    /// The braking without a wave, relative.
    Braking,
    /// The duty that reaches the driver: added to the commanded one.
    Duty,
}

impl ActsOn {
    /// All of them, by the words of a file.
    pub const ALL: [(&str, Self); 4] =
        [("speed", Self::Speed), ("torque", Self::Torque), ("braking", Self::Braking), ("duty", Self::Duty)];
}

/// What a number of the formula is.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// It makes the size of the effect: 0 is none, and this much is plausible.
    Typical(f64),
    /// It makes its form, above 0: this is where a search begins.
    Start(f64),
}

/// A number of the formula.
#[derive(Debug, Clone, PartialEq)]
pub struct Number {
    /// Its name there.
    pub name: String,
    /// Its unit, for who reads the answer.
    pub unit: String,
    /// What it is.
    pub role: Role,
    /// Least admissible value.
    pub min: f64,
    /// Largest one.
    pub max: f64,
}

impl Number {
    /// Whether it makes the size.
    pub fn is_size(&self) -> bool {
        matches!(self.role, Role::Typical(_))
    }
}

/// A formula, where it acts, and what is known of its numbers.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// What the effect is called, in files and in answers.
    pub name: String,
    /// A sentence for the answer.
    pub says: String,
    /// Where it acts.
    pub acts_on: ActsOn,
    /// The formula.
    pub change: String,
    /// Its numbers, sizes first.
    pub numbers: Vec<Number>,
    formula: Expression,
    /// Where each variable of the formula stands: among [`VARIABLES`], and behind them the numbers.
    places: Vec<usize>,
}

impl PartialEq for Hypothesis {
    fn eq(&self, other: &Self) -> bool {
        (&self.name, &self.says, self.acts_on, &self.change, &self.numbers)
            == (&other.name, &other.says, other.acts_on, &other.change, &other.numbers)
    }
}

impl Hypothesis {
    /// # Errors
    /// Says in words what will not do: a formula that cannot be read or hangs on what is not there, numbers without a size, a change that
    /// is there without its sizes or is no number.
    pub fn new(
        name: &str,
        says: &str,
        acts_on: ActsOn,
        change: &str,
        mut numbers: Vec<Number>,
    ) -> Result<Self, String> {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        if name.is_empty() || name.len() > LONGEST_NAME || !name.chars().all(plain) {
            return Err(format!(
                "has a name that will not do: small letters, digits, `-` and `_`, {LONGEST_NAME} characters at most"
            ));
        }
        if change.chars().count() > LONGEST {
            return Err(format!("has a formula of more than {LONGEST} characters"));
        }
        numbers.sort_by_key(|n| !n.is_size());
        let formula =
            Expression::parse(&signs(change)?).map_err(|e| format!("has a formula that cannot be read: {e}"))?;
        let place = |name: &String| {
            let variable = VARIABLES.iter().position(|v| v.0 == name);
            variable.or_else(|| numbers.iter().position(|n| n.name == *name).map(|k| VARIABLES.len() + k)).ok_or_else(
                || {
                    let known: Vec<&str> =
                        VARIABLES.iter().map(|v| v.0).chain(numbers.iter().map(|n| n.name.as_str())).collect();
                    format!(
                        "has a formula with `{name}`, which is neither a variable nor among its numbers: {}",
                        known.join(", ")
                    )
                },
            )
        };
        let places = formula.var_names().iter().map(place).collect::<Result<Vec<_>, _>>()?;
        let unused = |k: &usize| !places.contains(&(VARIABLES.len() + k));
        if let Some(k) = (0..numbers.len()).find(unused) {
            return Err(format!("has a number `{}` that its formula does not hold", numbers[k].name));
        }
        let hypothesis = Self {
            name: name.to_owned(),
            says: says.to_owned(),
            acts_on,
            change: change.to_owned(),
            numbers,
            formula,
            places,
        };
        hypothesis.check()?;
        Ok(hypothesis)
    }

    /// What the formula and its numbers have to be whatever the motor does.
    fn check(&self) -> Result<(), String> {
        if self.numbers.len() > MOST_NUMBERS {
            return Err(format!("has {} numbers: {MOST_NUMBERS} at most", self.numbers.len()));
        }
        for n in &self.numbers {
            let (name, min, max) = (&n.name, n.min, n.max);
            if VARIABLES.iter().any(|v| v.0 == name) {
                return Err(format!("has a number `{name}`, which is the name of a variable"));
            }
            let fits = match n.role {
                Role::Typical(size) => {
                    min <= 0.0 && max >= 0.0 && min < max && size != 0.0 && (min..=max).contains(&size)
                }
                Role::Start(start) => 0.0 < min && min < max && (min..=max).contains(&start),
            };
            if !fits {
                return Err(format!(
                    "has a number `{name}` whose bounds will not do: of a size, min ≤ 0 ≤ max with `typical` between them and not 0; \
                     of the form, 0 < min < max with `start` between them"
                ));
            }
        }
        if !self.numbers.iter().any(Number::is_size) {
            return Err("has no size: of one number at least, `typical` is to be given".to_owned());
        }
        if self.acts_on == ActsOn::Duty {
            let known = ["duty", "direction"];
            if let Some(other) = self.hangs_on().find(|v| !known.contains(v)) {
                return Err(format!(
                    "acts on the duty and hangs on `{other}`; what the driver makes of a duty may hang on {}",
                    known.join(", ")
                ));
            }
        }
        self.check_values()
    }

    /// Whether the change is a number wherever the motor may be, and none without its sizes.
    fn check_values(&self) -> Result<(), String> {
        let at = |n: &Number, share: f64| match n.role {
            Role::Typical(size) => size * share,
            Role::Start(_) => n.min + share * (n.max - n.min),
        };
        for now in places() {
            for share in [0.0, 0.3, 1.0] {
                let values: Vec<f64> = self.numbers.iter().map(|n| at(n, share)).collect();
                let change = self.raw(&values, &now);
                if !change.is_finite() {
                    return Err(format!("has a formula that is no number at {now:?} with {values:?}"));
                }
                let without: Vec<f64> =
                    self.numbers.iter().map(|n| if n.is_size() { 0.0 } else { at(n, share) }).collect();
                let left = self.raw(&without, &now);
                if left.abs() > 1e-12 {
                    return Err(format!(
                        "has a formula that is {left} where its sizes are 0, at {now:?}: it must be 0 there"
                    ));
                }
            }
        }
        Ok(())
    }

    fn raw(&self, values: &[f64], now: &Now) -> f64 {
        let now = now.array();
        let mut variables = [0.0; VARIABLES.len() + MOST_NUMBERS];
        for (to, place) in variables.iter_mut().zip(&self.places) {
            *to = if *place < now.len() { now[*place] } else { values[*place - now.len()] };
        }
        self.formula.eval(&variables[..self.places.len()]).unwrap_or(f64::NAN)
    }

    /// The change with these values of [`Self::numbers`]; none where it is no number.
    pub fn change(&self, values: &[f64], now: &Now) -> f64 {
        let change = self.raw(values, now);
        if change.is_finite() { change.clamp(-LARGEST_CHANGE, LARGEST_CHANGE) } else { 0.0 }
    }

    /// Whether it acts at all with these values.
    pub fn is_there(&self, values: &[f64]) -> bool {
        self.numbers.iter().zip(values).any(|(n, v)| n.is_size() && *v != 0.0)
    }

    /// The variables in its formula.
    pub fn hangs_on(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.places.iter().filter_map(|p| VARIABLES.get(*p)).map(|v| v.0)
    }

    /// Whether nothing in its formula changes between two equal periods of a steady drive.
    pub fn is_steady(&self) -> bool {
        self.hangs_on().all(|v| matches!(v, "duty" | "direction"))
    }
}

/// The formula with the signs that stand alone as factors: the parser takes them before a power, and everybody else after it.
fn signs(change: &str) -> Result<String, String> {
    let mut out = String::with_capacity(change.len());
    let mut before = '(';
    for c in change.chars() {
        match (before, c) {
            ('(' | ',', '-') => out.push_str("(-1)*"),
            ('(' | ',', '+') => {}
            ('+' | '-' | '*' | '/' | '^', '+' | '-') => {
                return Err(format!(
                    "has a formula with the sign `{c}` right after `{before}`: put what it belongs to in parentheses"
                ));
            }
            _ => out.push(c),
        }
        if !c.is_whitespace() {
            before = c;
        }
    }
    Ok(out)
}

/// Where a formula is tried before it is believed: over what motors of the kind do.
fn places() -> impl Iterator<Item = Now> {
    let shares = [0.0, 0.02, 0.37, 1.0];
    (0..shares.len().pow(3) as u32).flat_map(move |k| {
        let at = |digit: u32| shares[(k / 4_u32.pow(digit) % 4) as usize];
        [1.0, -1.0].map(|direction| Now {
            duty: at(0),
            time_s: 100.0 * at(1),
            on_s: 100.0 * at(1) * at(0),
            turned_rad: direction * 600.0 * at(2),
            speed_rad_s: direction * 10.0 * at(2),
            direction,
            revolutions: 1000.0 * at(2),
        })
    })
}

/// A hypothesis with the values of its numbers: an effect that a motor has.
#[derive(Debug, Clone, PartialEq)]
pub struct Formula {
    /// The formula.
    pub hypothesis: Arc<Hypothesis>,
    /// Values of its numbers, in their order.
    pub values: Vec<f64>,
    /// Relative change of the supply's voltage for one of the speed (1): what a change of the speed is simulated by.
    pub voltage_per_speed: f64,
}

impl Formula {
    /// The change now, of what `acts_on`; 0 for anything else.
    pub fn change_of(&self, what: ActsOn, now: &Now) -> f64 {
        if self.hypothesis.acts_on == what && self.hypothesis.is_there(&self.values) {
            self.hypothesis.change(&self.values, now)
        } else {
            0.0
        }
    }
}

fn is_dimensionless(unit: &&str) -> bool {
    *unit == DIMENSIONLESS
}

/// As a file has it.
impl Serialize for Formula {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(serde::Serialize)]
        struct Row<'a> {
            value: f64,
            #[serde(skip_serializing_if = "is_dimensionless")]
            unit: &'a str,
            #[serde(flatten)]
            role: Role,
            min: f64,
            max: f64,
        }
        let h = &self.hypothesis;
        let rows = h.numbers.iter().zip(&self.values);
        let numbers: std::collections::BTreeMap<&str, Row<'_>> = rows
            .map(|(n, v)| (n.name.as_str(), Row { value: *v, unit: &n.unit, role: n.role, min: n.min, max: n.max }))
            .collect();
        let mut map = serializer.serialize_map(None)?;
        if !h.says.is_empty() {
            map.serialize_entry("says", &h.says)?;
        }
        map.serialize_entry("acts_on", &h.acts_on)?;
        map.serialize_entry("change", &h.change)?;
        if h.acts_on == ActsOn::Speed {
            map.serialize_entry("voltage_per_speed", &self.voltage_per_speed)?;
        }
        map.serialize_entry("numbers", &numbers)?;
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn size(name: &str) -> Number {
        Number { name: name.to_owned(), unit: "1".to_owned(), role: Role::Typical(0.1), min: -0.5, max: 0.5 }
    }

    fn read(change: &str) -> Result<Hypothesis, String> {
        Hypothesis::new("mine", "", ActsOn::Speed, change, vec![size("a")])
    }

    #[test]
    fn a_formula_is_what_it_says() {
        let tau = Number { name: "tau".into(), unit: "s".into(), role: Role::Start(1.0), min: 0.1, max: 20.0 };
        // The number of the form is named first, and still stands behind the size.
        let h =
            Hypothesis::new("mine", "", ActsOn::Speed, "-a*duty*(1 - exp(-time_s/tau))", vec![tau, size("a")]).unwrap();
        let now = Now { duty: 0.5, time_s: 2.0, ..Now::default() };
        assert!((h.change(&[0.2, 4.0], &now) + 0.2 * 0.5 * (1.0 - (-0.5_f64).exp())).abs() < 1e-15);
        assert_eq!(h.hangs_on().collect::<Vec<_>>(), ["duty", "time_s"]);
        assert!(!h.is_steady() && h.is_there(&[0.2, 4.0]) && !h.is_there(&[0.0, 4.0]));
    }

    /// Fails if a sign is taken before a power, as the parser does of itself.
    #[test]
    fn signs_stand_before_powers_as_everybody_writes_them() {
        let now = Now { duty: 0.6, ..Now::default() };
        for (change, expected) in [
            ("a*exp(-duty^2)", (-0.36_f64).exp()),
            ("-a*exp(-(duty/0.3)^2)", -(-4.0_f64).exp()),
            ("- a*(duty - 2)^2", -1.96),
            ("a*1e-1*(-duty + 1)", 0.04),
        ] {
            let change_now = read(change).expect(change).change(&[1.0], &now);
            assert!((change_now - expected).abs() < 1e-12, "{change}: {change_now}, not {expected}");
        }
    }

    #[test]
    fn what_is_no_effect_is_refused_in_words() {
        for (change, why) in [
            ("a*", "cannot be read"),
            ("a*volume", "`volume`"),
            ("duty", "does not hold"),
            ("a + 0.1", "must be 0"),
            ("a/duty", "no number"),
            ("a*exp(1000*speed_rad_s)", "no number"),
            ("a*-duty", "parentheses"),
        ] {
            let said = read(change).expect_err(change);
            assert!(said.contains(why), "{change}: {said}");
        }
        let long = format!("a*({})", ["1"; 400].join("+"));
        assert!(read(&long).unwrap_err().contains("characters"));
        let without_size = Number { role: Role::Start(0.1), min: 0.05, ..size("a") };
        assert!(Hypothesis::new("mine", "", ActsOn::Speed, "a", vec![without_size]).unwrap_err().contains("no size"));
        assert!(Hypothesis::new("mine", "", ActsOn::Duty, "a*time_s", vec![size("a")]).unwrap_err().contains("time_s"));
        assert!(Hypothesis::new("mine", "", ActsOn::Speed, "duty*a", vec![size("duty"), size("a")]).is_err());
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[a-z0-9_+*/^(){}. \\-]{0,60}", other in "\\PC{0,40}") {
            let _ = read(&text);
            let _ = read(&other);
            let _ = read(&format!("a*({text})"));
        }
    }
}
