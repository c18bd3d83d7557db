//! The one policy of overwriting, as every command that writes states it.

use twum_host::output::Existing;

/// What `twum --help` says about it.
pub const POLICY: &str = "\
Files: pictures and pages (.svg, .png, .html) are replaced. Tables and data are replaced only with --force; recordings and
folders never, nor what the command itself reads. A file is there whole or not at all: one that was not finished is named
.NAME.*.part and can be deleted. Recordings, sweeps and studies keep what they have when they are interrupted.";

/// Whether a table or data file that is there may be replaced.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct ExistingArgs {
    /// Replace a table or data file that is there already; pictures and pages always are
    #[arg(long)]
    force: bool,
}

impl From<ExistingArgs> for Existing {
    fn from(args: ExistingArgs) -> Self {
        if args.force { Self::Replace } else { Self::Keep }
    }
}
