//! In the making: keypoints.
