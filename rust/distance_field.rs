//! In the making: distance_field.
