//! In the making: outlier.
