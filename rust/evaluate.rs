//! In the making: evaluate.
