//! How the host reaches a board: serial port, pseudo-terminal, in memory.
