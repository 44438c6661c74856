//! In the making: optim/mod.
