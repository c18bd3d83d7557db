//! When a pulse takes hold of the rotor and lets it go: no equation of the rotor says it to better than a fraction of a millisecond.

use super::rotor::P;

/// How late pulses take hold, and how late they are as a whole.
pub const TIMING: [P; 2] = [P::StartDelay, P::Latency];

/// Standard deviation of what the equations miss of either, s. Contacts spring back, slip and catch within a pulse in ways that they leave
/// out, and move it by 0.1 to 0.2 ms (generator E's motors without an effect).
pub const TIMING_S: f64 = 1.5e-4;

/// Step of the derivatives by either, s: less than what is asked of them.
pub const STEP_S: f64 = 1e-4;

/// Duties of one step are pulses of one length: an experiment of three to twelve duties seldom has two in it, and one of a hundred has 17
/// lengths at most.
const DUTY_STEP: f64 = 1.0 / 16.0;

/// Which runs have pulses alike, counted from 0, by their duties: what a contact does within one pulse it does in all of that length. Runs
/// without a duty of their own are alike.
pub fn alike(duties: impl Iterator<Item = Option<f64>>) -> Vec<usize> {
    let lengths: Vec<Option<i64>> = duties.map(|duty| duty.map(|d| (d / DUTY_STEP).round() as i64)).collect();
    let mut kinds = lengths.clone();
    kinds.sort();
    kinds.dedup();
    lengths.iter().map(|length| kinds.partition_point(|kind| kind < length)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if runs of one duty are not alike, if those of another are, or if kinds are left out between others.
    #[test]
    fn runs_of_one_duty_are_alike() {
        assert_eq!(alike([0.5, 0.2, 1.0, 0.5, 0.2001].map(Some).into_iter()), [1, 0, 2, 1, 0]);
        assert_eq!(alike([None, Some(0.5), None].into_iter()), [0, 1, 0]);
    }
}
