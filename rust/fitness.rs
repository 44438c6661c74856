//! In the making: fitness.
