//! In the making: normals.
