//! In the making: spacing.
