//! Register cross-source point clouds without targets and without an initial guess.
//!
//! Modules are listed the way the data goes.

// Floor 0: words.
pub mod cloud;
pub mod deadline;
pub mod error;
pub mod freedom;
pub(crate) mod parallel;
pub mod progress;
pub mod random;
pub(crate) mod rank;
pub mod rigid;
pub mod similarity;
pub(crate) mod vectorize;

// Floor 1: tools.
pub mod descriptors;
pub mod distance_field;
pub mod kabsch;
pub mod near_field;
pub mod neighbors;
pub mod normals;
pub mod observations;
pub mod optim;
pub mod overlap;
pub mod point_to_plane;
pub mod spacing;
pub mod surface_area;
pub mod surface_cloud;
pub mod uncertainty;

// Floor 2: stages, in the order of the data.
pub mod coarse;
pub mod evaluate;
pub mod fitness;
pub mod fuse;
pub mod icp;
pub mod keypoints;
pub mod m3c2;
pub mod outlier;
pub mod running_voxels;
pub mod verdict;
pub mod voxel;

// Floor 3: the route.
pub mod config;
pub mod pipeline;
pub mod registration;

// The bindings: the only room with Python in it.
#[cfg(feature = "python")]
mod python;

pub use cloud::{Cloud, Point};
pub use config::Config;
pub use error::{Error, Result};
pub use pipeline::register;
pub use registration::Registration;
pub use rigid::Rigid;

/// Runs the README's Rust example as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeExamples;

/// Runs the Rust examples of the documentation site.
#[cfg(doctest)]
#[doc = include_str!("../docs/how_to/rust.md")]
struct RustPageExamples;
