//! Progress is data: typed events go to the caller, who may answer "stop". Nothing is printed here.

use std::ops::ControlFlow;

use crate::error::{Error, Result};

/// The stages of the route, in the order of the data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Stage {
    /// Radius outlier removal.
    Outliers,
    /// Voxel centroids.
    Voxel,
    /// ISS keypoints.
    Keypoints,
    /// Search for the pose without an initial guess.
    Coarse,
    /// Iterative closest point.
    Icp,
    /// Judging the pose.
    Verdict,
    /// Cloud-to-cloud distances.
    Evaluate,
    /// Fusion of the two clouds.
    Fuse,
}

impl Stage {
    /// The name used in results, on the command line and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Outliers => "outliers",
            Self::Voxel => "voxel",
            Self::Keypoints => "keypoints",
            Self::Coarse => "coarse",
            Self::Icp => "icp",
            Self::Verdict => "verdict",
            Self::Evaluate => "evaluate",
            Self::Fuse => "fuse",
        }
    }
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// A stage began.
    Started {
        /// Which.
        stage: Stage,
    },
    /// A stage got on: `done` of `total` steps, with the best score so far where there is one.
    Advanced {
        /// Which.
        stage: Stage,
        /// Steps done.
        done: usize,
        /// Steps in all, as far as known now.
        total: usize,
        /// Best score so far; its meaning is the stage's (lower is better in paper mode, higher in
        /// robust mode).
        best: Option<f64>,
    },
    /// A sign of life without news, so that the caller can ask to stop in the middle of a stage.
    Tick,
}

type Listener<'a> = dyn Fn(&Event) -> ControlFlow<()> + Sync + 'a;

/// The way back to the caller: where events go and where the wish to stop comes from.
///
/// ```
/// use std::ops::ControlFlow;
/// use tmchho::progress::{Event, Progress};
/// let listener = |event: &Event| match event {
///     Event::Started { .. } => ControlFlow::Break(()),
///     _ => ControlFlow::Continue(()),
/// };
/// let progress = Progress::new(&listener);
/// assert!(progress.check().is_ok());
/// ```
#[derive(Clone, Copy)]
pub struct Progress<'a> {
    listener: Option<&'a Listener<'a>>,
    is_quiet: bool,
}

impl<'a> Progress<'a> {
    /// Events go to `listener`, from any thread; it stops the work by answering `Break`.
    pub fn new(listener: &'a Listener<'a>) -> Self {
        Self {
            listener: Some(listener),
            is_quiet: false,
        }
    }

    /// Nobody listens.
    pub fn silent() -> Self {
        Self {
            listener: None,
            is_quiet: true,
        }
    }

    /// The same caller, who is not told of anything but may still stop the work.
    pub fn quietly(&self) -> Self {
        Self {
            is_quiet: true,
            ..*self
        }
    }

    /// Tells the caller.
    ///
    /// # Errors
    /// [`Error::Cancelled`] once the caller wants to stop.
    pub fn emit(&self, event: &Event) -> Result<()> {
        let event = if self.is_quiet { &Event::Tick } else { event };
        match self.listener.map(|listener| listener(event)) {
            Some(ControlFlow::Break(())) => Err(Error::Cancelled),
            _ => Ok(()),
        }
    }

    /// Asks whether the caller wants to stop.
    ///
    /// # Errors
    /// [`Error::Cancelled`] if so.
    pub fn check(&self) -> Result<()> {
        self.emit(&Event::Tick)
    }
}

impl std::fmt::Debug for Progress<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Progress")
            .field("listened_to", &self.listener.is_some())
            .finish()
    }
}
