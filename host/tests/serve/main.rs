//! `twum serve` as its users meet it: a real process, a simulated board in real time, pages that speak its protocol, and a real
//! browser where there is one. Times are generous: the machine may be busy.
#![cfg(target_os = "linux")]

#[path = "../simulator/mod.rs"]
mod simulator;

mod api;
mod browser;
mod faults;
mod load;
mod page;
mod security;
mod served;
mod sweep;
mod terminal;
