//! Independent references for the whole-system tests.
