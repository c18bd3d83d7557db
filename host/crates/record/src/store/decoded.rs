//! The motion as numbers, beside the raw frames it was decoded from: what makes a recording plot as it is.
//!
//! One message for each block of control ticks (8 ms at a control period of 500 µs), and one for each status while no run is
//! made. Frames stay the truth: what is read back is read from them.

use crate::live::LiveView;
use twum_shared::frame::{self, MAX_ENCODED};
use twum_shared::message::DeviceMessage;

/// Schema of the messages: keys without a value at the time are left out.
pub(super) const MOTION_SCHEMA: &str = r#"{"type":"object","title":"twum.Motion","properties":{
"time_us":{"type":"integer","description":"of the board's clock"},
"position":{"type":"integer","description":"counts from the board's zero"},
"position_deg":{"type":"number","description":"degrees from the board's zero"},
"speed_rpm":{"type":"number","description":"mean over the last 0.3 s, or since the run began"},
"duty":{"type":"number","description":"signed fraction of the PWM period with drive on"},
"target":{"type":"integer","description":"counts from the board's zero, in a closed loop"},
"target_deg":{"type":"number","description":"degrees from the board's zero, in a closed loop"},
"error_deg":{"type":"number","description":"target less position, in a closed loop"}}}"#;

/// Follows the frames of the board.
#[derive(Debug, Default)]
pub(super) struct Motion {
    view: LiveView,
    block: Vec<u8>,
}

impl Motion {
    /// The message that goes with a frame of the board, as it was on the line; none for most.
    pub(super) fn of(&mut self, bytes: &[u8]) -> Option<String> {
        if bytes.len() > MAX_ENCODED {
            return None;
        }
        self.block.clear();
        self.block.extend_from_slice(bytes.strip_suffix(&[0]).unwrap_or(bytes));
        let (header, message) = frame::decode::<DeviceMessage>(&mut self.block).ok()?;
        self.view.observe(header.time_us, &message);
        let shown = match message {
            DeviceMessage::Control(_) => true,
            DeviceMessage::Status(_) => self.view.target().is_none(),
            _ => false,
        };
        shown.then(|| self.message(header.time_us))
    }

    /// Degrees to a thousandth: a count is hundreds of them.
    fn message(&self, time_us: u64) -> String {
        let view = &self.view;
        let (position, position_deg) = (view.position(), view.position_deg());
        let mut json = format!(
            "{{\"time_us\":{time_us},\"position\":{position},\"position_deg\":{position_deg:.3},\"speed_rpm\":{:.3},\"duty\":{:.5}",
            view.speed_rpm() + 0.0,
            view.duty() + 0.0
        );
        if let Some(target) = view.target() {
            let target_deg = view.degrees(target);
            json += &format!(
                ",\"target\":{target},\"target_deg\":{target_deg:.3},\"error_deg\":{:.3}",
                target_deg - position_deg + 0.0
            );
        }
        json.push('}');
        json
    }
}
