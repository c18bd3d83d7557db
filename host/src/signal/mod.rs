//! From encoder edges to position, speed and spectra.
