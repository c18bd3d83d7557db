//! Firmware library, generic over the board.
#![no_std]
