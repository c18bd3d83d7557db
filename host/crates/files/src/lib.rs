//! Files in and out: what is handed in is read up to a bound, what a person keeps is written whole or not at all.
//!
//! ```
//! use twum_files::input;
//! use twum_files::output::{self, Existing};
//!
//! let folder = tempfile::tempdir()?;
//! let gains = folder.path().join("gains.toml");
//! output::write(&gains, "kp = 1.3\n", Existing::Keep)?;
//! assert_eq!(input::text(&gains, input::WRITTEN)?, "kp = 1.3\n");
//! // What is there already is not lost, nor what this program has read, even if it may replace files.
//! assert!(output::write(&gains, "kp = 2.0\n", Existing::Keep).is_err());
//! assert!(output::write(&gains, "kp = 2.0\n", Existing::Replace).is_err());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod input;
pub mod output;
