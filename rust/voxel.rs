//! In the making: voxel.
