//! Which effects look alike.

/// Effects that the same data cannot tell apart in general: with one out of the library, the other stands for it.
pub const TWINS: [[&str; 2]; 12] = [
    ["preload-runout", "encoder-eccentricity"],
    ["dead-zone", "start-delay"],
    ["dead-zone", "high-duty-saturation"],
    ["dead-zone", "duty-quantisation"],
    ["start-delay", "stribeck-friction"],
    ["start-delay", "contact-stiffening"],
    ["stribeck-friction", "contact-stiffening"],
    ["stribeck-friction", "dead-zone"],
    ["supply-sag", "high-duty-saturation"],
    ["supply-sag", "resonance-heating"],
    ["resonance-heating", "run-in-wear"],
    ["reversal-miscount", "backlash"],
];

/// Whether two effects are twins.
pub fn twins(a: &str, b: &str) -> bool {
    TWINS.iter().any(|t| t.contains(&a) && t.contains(&b))
}
