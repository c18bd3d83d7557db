//! The board that moves the motor: [`link`] reaches it, [`sim`] is one that needs no hardware.
//!
//! ```
//! use twum_board::link::{Session, SimulatedLink};
//! use twum_board::sim::Setup;
//!
//! let mut session = Session::new(SimulatedLink::new(Setup::default()));
//! let board = session.hello()?;
//! assert!(board.chip.contains("simulated"), "{}", board.chip);
//! // Armed, it may be told to turn; a stop always works.
//! session.arm()?;
//! session.stop()?;
//! # Ok::<(), twum_board::link::LinkError>(())
//! ```

pub mod link;
pub mod sim;
