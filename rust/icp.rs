//! In the making: icp.
