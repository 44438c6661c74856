//! The examples run as they stand.

#![allow(clippy::unwrap_used)]

#[path = "../examples/minimize.rs"]
mod minimize;
#[path = "../examples/register.rs"]
mod register;

#[test]
fn register_runs() {
    register::main().unwrap();
}

#[test]
fn minimize_runs() {
    minimize::main().unwrap();
}
