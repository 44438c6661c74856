//! In the making: coarse.
