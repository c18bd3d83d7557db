//! The configuration as the page edits it: every key with its value, unit and bounds.

use crate::configuration::rows;
use serde::Serialize;
use toml::Value;
use twum_shared::message::Configuration;

/// One key.
#[derive(Debug, Serialize)]
pub struct Row {
    /// The key, with its table.
    pub key: String,
    /// Its value, as TOML has it.
    pub value: Value,
    /// Its unit.
    pub unit: &'static str,
    /// What it may be. The board has the last word.
    pub bounds: &'static str,
}

/// Unit and bounds of every key; what the firmware's own checks refuse.
const KEYS: [(&str, &str, &str); 41] = [
    ("count_sign", "", "positive or reversed"),
    ("edges_per_rev", "edges", "2 to 10000"),
    ("pwm_hz", "Hz", "10 to 2000"),
    ("control.kp", "steps/count", "below 1024"),
    ("control.ki_tick", "steps/(count\u{b7}tick)", "below 1024, see integral_max"),
    ("control.kd_tick", "steps\u{b7}tick/count", "below 1024"),
    ("control.feed_forward", "steps\u{b7}s/count", "below 1024"),
    ("control.integral_min", "count\u{b7}tick", "at most 0"),
    ("control.integral_max", "count\u{b7}tick", "at least 0; times ki_tick below 16384"),
    ("control.period_us", "\u{b5}s", "100 to 10000"),
    ("control.duty_steps", "steps", "2 to 32768"),
    ("control.law", "", "active-low-truncated, on-time-rounded or gated"),
    ("control.dead_band_counts", "counts", "at least 0"),
    ("control.conditional_integration", "", "true or false"),
    ("control.reversal_rest_ticks", "ticks", "at most reversal_limit_ticks"),
    ("control.reversal_limit_ticks", "ticks", "at least reversal_rest_ticks"),
    ("control.full_speed_counts_s", "counts/s", "of a gated drive: up to 8 counts a tick"),
    ("control.braking_counts_s2", "counts/s\u{b2}", "of a gated drive: above 0"),
    ("control.delay_ticks", "ticks", "at most 8"),
    ("control.shortest_pulse_ticks", "ticks", "of a gated drive: 1 to 40"),
    ("control.pulse_period_ticks", "ticks", "of a gated drive: 1 to 40, 1 for a pulse whenever it has to be"),
    ("control.learns", "", "true or false, of a gated drive"),
    ("control.guide_limit_counts", "counts", "of a gated drive: at most 256, 0 for a target that does not give way"),
    ("control.guide_stiffness_nnm", "nN\u{b7}m/count", "1 to 1000000000 for a target that gives way"),
    ("control.guide_damping_nnm_s", "nN\u{b7}m\u{b7}s/count", "1 to 1000000000 for a target that gives way"),
    ("control.guide_dead_band_nnm", "nN\u{b7}m", "below guide_braking_nnm"),
    ("control.guide_braking_nnm", "nN\u{b7}m", "1 to 1000000000 for a target that gives way"),
    ("limits.command_timeout_ms", "ms", "1 to 2000"),
    ("limits.stall_duty", "1/32768", "1 to 32768"),
    ("limits.stall_ms", "ms", "1 to 2000"),
    ("limits.chatter_edges", "edges/tick", "1 to 20"),
    ("limits.wrong_direction_counts", "counts", "1 to 100"),
    ("limits.following_error_counts", "counts", "1 to 16777216"),
    ("limits.overspeed_counts_s", "counts/s", "1 to 10000"),
    ("limits.position_min", "counts", "-16777216 to 0"),
    ("limits.position_max", "counts", "0 to 16777216"),
    ("limits.late_tick_us", "\u{b5}s", "1 to 1000"),
    ("limits.late_ticks", "ticks", "1 to 20"),
    ("limits.lost_items", "items", "1 to 10000"),
    ("limits.slowest_percent", "%", "1 to 100"),
    ("limits.slow_start_duty", "1/32768", "0 to 32768"),
];

/// Every key of a configuration.
pub fn settings(configuration: &Configuration) -> Vec<Row> {
    let row = |(key, value): (String, Value)| {
        let known = KEYS.iter().find(|(name, _, _)| *name == key);
        Row { value, unit: known.map_or("", |it| it.1), bounds: known.map_or("", |it| it.2), key }
    };
    rows(configuration).into_iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use twum_shared::step::ConfigSpec;

    #[test]
    fn every_key_there_is_has_its_bounds_and_no_other() {
        let mut shown: Vec<String> =
            settings(&Configuration::with_control(ConfigSpec::DEFAULT)).into_iter().map(|row| row.key).collect();
        let mut known = KEYS.map(|(key, _, _)| key.to_owned()).to_vec();
        shown.sort();
        known.sort();
        assert_eq!(shown, known);
    }
}
