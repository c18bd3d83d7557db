//! Recordings and measurement folders: store, import, export.
//!
//! ```
//! use twum_record::measurement::{Measurement, RunData};
//!
//! let folder = tempfile::tempdir()?;
//! std::fs::write(
//!     folder.path().join("measurement.toml"),
//!     "name = \"bench 3\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = 400\n\
//!      [[run]]\nid = \"d50\"\nkind = \"speed\"\nfile = \"d50.csv\"\nformat = \"edges\"\nduty = 0.5\n",
//! )?;
//! std::fs::write(folder.path().join("d50.csv"), "time_us,level\n0,0\n7000,1\n14000,0\n20000,0\n")?;
//! let measurement = Measurement::load(folder.path())?;
//! let RunData::Edges { edges, .. } = &measurement.runs[0].data else { unreachable!("format = \"edges\"") };
//! assert_eq!(edges.len(), 2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod check;
pub mod configuration;
pub mod control;
pub mod convert;
pub mod decode;
mod earlier;
pub mod export;
pub mod live;
pub mod load;
pub mod measurement;
pub mod order;
pub mod pieces;
pub mod recording;
pub mod series;
pub mod store;
pub mod synthetic;
