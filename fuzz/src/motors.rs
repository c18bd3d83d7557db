//! Motor files.

use twum_host::model::motor::Motor;
use twum_host::model::parameters::Flavour;

/// Any text. What is accepted can be computed with, and written and read again.
pub fn motors(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    match Motor::parse("fuzz.toml", text) {
        Err(error) => assert!(error.to_string().contains("fuzz.toml, line "), "{error}"),
        Ok(motor) => {
            for flavour in Flavour::ALL {
                motor.parameters(flavour).check().expect("an accepted motor is within its bounds");
            }
            let written = motor.to_toml().expect("an accepted motor can be written");
            assert_eq!(Motor::parse("again.toml", &written).expect("and read again"), motor);
        }
    }
}
