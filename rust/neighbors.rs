//! In the making: neighbors.
