//! In the making: verdict.
