//! In the making: fuse.
