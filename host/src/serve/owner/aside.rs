//! What goes on beside the port.

use super::Owner;
use crate::serve::board::Ended;
use std::sync::Arc;

/// Something beside the port that goes on alone, until it is dropped.
pub struct Aside {
    pub(super) owner: Arc<Owner>,
    pub(super) ended: Option<Ended>,
}

impl Aside {
    /// Whether it has to stop.
    pub fn is_stopped(&self) -> bool {
        self.owner.desk().aside == Some(true)
    }

    /// Tells of the end, when the next thing can be asked for and nothing else has been.
    pub fn ends(mut self, ended: Ended) {
        self.ended = Some(ended);
    }
}

impl Drop for Aside {
    fn drop(&mut self) {
        // One step: what is set aside next must not be ended by this.
        let mut desk = self.owner.desk();
        desk.aside = None;
        if let Some(ended) = self.ended.take() {
            self.owner.board.ended(ended);
        }
    }
}
