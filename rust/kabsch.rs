//! In the making: kabsch.
