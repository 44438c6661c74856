//! What clouds larger than memory are worked on with: sums by voxel, and tiles.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{ReadArray, dict, from_points, from_vec, points};
use super::config::options;
use super::errors::as_argument;
use super::run::{briefly, with_progress};
use crate::cloud::{Cloud, Point, difference};
use crate::error::Error;
use crate::evaluate::{CompareOptions, DistanceMethod, surface_distances};
use crate::m3c2::{M3c2Options, M3c2Scales};
use crate::neighbors::{Neighbor, NeighborIndex, Places, map_places};
use crate::overlap;
use crate::parallel;
use crate::running_voxels::{self, Thinned};
use crate::spacing::strided_spacings_m;
use crate::{fuse, surface_area};

/// Sums up points by voxels, part by part.
#[pyclass(module = "tmchho._core")]
pub(super) struct RunningVoxels(Option<running_voxels::RunningVoxels>);

#[pymethods]
impl RunningVoxels {
    #[new]
    fn new(low: Point, high: Point, voxel_size: f64, max_voxels: usize) -> PyResult<Self> {
        briefly(|| {
            let voxels = running_voxels::RunningVoxels::new(low, high, voxel_size, max_voxels)?;
            Ok(Self(Some(voxels)))
        })
    }

    /// Adds the next part of the cloud.
    fn add(&mut self, py: Python<'_>, array: ReadArray<'_>) -> PyResult<()> {
        let part = points(&array)?;
        let voxels = self.0.as_mut();
        with_progress(py, None, |_| voxels.ok_or_else(finished)?.add(part))
    }

    /// The centroids, how many points each stands for, and the edge; nothing can be added any more.
    fn finish<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let voxels = self.0.take();
        let Thinned {
            points,
            n_points,
            voxel_size_m,
        } = with_progress(py, None, |_| Ok(voxels.ok_or_else(finished)?.finish()))?;
        briefly(|| {
            Ok(dict! { py,
                "points": from_points(py, points)?,
                "counts": from_vec(py, n_points),
                "voxel_size": voxel_size_m,
            })
        })
    }
}

fn finished() -> Error {
    Error::argument("voxels", "are finished; begin anew")
}

/// From each of the first `n_own` rows of `places` to the nearest row of `others` within
/// `max_distance`, infinite where there is none; with `repeated`, also which of them repeat a
/// point of `others`. All rows of `places` tell how dense that cloud is.
#[pyfunction]
pub(super) fn distances_within<'py>(
    py: Python<'py>,
    places: ReadArray<'py>,
    n_own: usize,
    others: ReadArray<'py>,
    max_distance: f64,
    repeated: bool,
) -> PyResult<(Bound<'py, PyAny>, Option<Bound<'py, PyAny>>)> {
    let (places, others) = (points(&places)?, points(&others)?);
    let (distances, repeated) = with_progress(py, None, |progress| {
        let own = places
            .get(..n_own)
            .ok_or_else(|| Error::argument("n_own", "exceeds the number of rows"))?;
        let others = Cloud::of_any_shape("cloud that distances are measured to", others)?;
        let origin = others.origin();
        let to_local = |p: &Point| std::array::from_fn(|axis| p[axis] - origin[axis]);
        let local: Vec<Point> = own.iter().map(to_local).collect();
        let index = NeighborIndex::new(others.points());
        let max_sq = max_distance * max_distance;
        let nearest = index.nearest_all_within(&Places::new(&local), max_sq, progress)?;
        let flags = match repeated {
            false => None,
            true => {
                let all: Vec<Point> = places.iter().map(to_local).collect();
                let own_index = NeighborIndex::new(&all);
                Some(overlap::repeated(
                    &nearest, &own_index, 1.0, &index, progress,
                )?)
            }
        };
        let distance =
            |found: &Option<Neighbor>| found.map_or(f32::INFINITY, |n| n.distance_sq.sqrt() as f32);
        Ok((nearest.iter().map(distance).collect::<Vec<f32>>(), flags))
    })?;
    briefly(|| {
        Ok((
            from_vec(py, distances),
            repeated.map(|flags| from_vec(py, flags)),
        ))
    })
}

/// The number of the tile of each row: `axes` and `places` are the cuts of a complete binary tree, and
/// what lies above a cut goes to its second branch.
#[pyfunction]
pub(super) fn tile_of<'py>(
    py: Python<'py>,
    array: ReadArray<'py>,
    axes: Vec<u8>,
    places: Vec<f64>,
) -> PyResult<Bound<'py, PyAny>> {
    let given = points(&array)?;
    let tiles = with_progress(py, None, |progress| {
        let is_tree = axes.len() == places.len()
            && (axes.len() + 1).is_power_of_two()
            && axes.len() <= usize::from(u16::MAX)
            && axes.iter().all(|&axis| axis < 3);
        if !is_tree {
            return Err(Error::argument("cuts", "must be a complete binary tree"));
        }
        let n_levels = (axes.len() + 1).ilog2();
        parallel::map_cheap(given.len(), progress, |i| {
            let node = (0..n_levels).fold(0, |node, _| {
                let above = given[i][usize::from(axes[node])] > places[node];
                2 * node + 1 + usize::from(above)
            });
            (node - axes.len()) as u16
        })
    })?;
    briefly(|| Ok(from_vec(py, tiles)))
}

/// Points that distances are measured to, again and again.
#[pyclass(module = "tmchho._core", frozen)]
pub(super) struct PointIndex {
    origin: Point,
    index: NeighborIndex,
}

#[pymethods]
impl PointIndex {
    #[new]
    fn new(py: Python<'_>, array: ReadArray<'_>) -> PyResult<Self> {
        let given = points(&array)?;
        with_progress(py, None, |_| {
            let cloud = Cloud::of_any_shape("cloud that distances are measured to", given)?;
            Ok(Self {
                origin: cloud.origin(),
                index: NeighborIndex::new(cloud.points()),
            })
        })
    }

    /// From each row to the nearest of the points.
    fn distances<'py>(
        &self,
        py: Python<'py>,
        array: ReadArray<'py>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let given = points(&array)?;
        let distances = with_progress(py, None, |progress| {
            let to_local = |p: &Point| std::array::from_fn(|axis| p[axis] - self.origin[axis]);
            let places: Vec<Point> = given.iter().map(to_local).collect();
            self.index.distances_to(&Places::new(&places), progress)
        })?;
        briefly(|| Ok(from_vec(py, distances)))
    }

    /// The `k` nearest points of each row: distances, then row numbers of the points, each n·k long; the
    /// distances are infinite where there are no more.
    fn k_nearest<'py>(
        &self,
        py: Python<'py>,
        array: ReadArray<'py>,
        k: usize,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let given = points(&array)?;
        let found = with_progress(py, None, |progress| {
            let places = self.local(given);
            parallel::map_cheap(places.len(), progress, |i| {
                let mut found = Vec::new();
                self.index.k_nearest(&places[i], k, &mut found);
                found
            })
        })?;
        briefly(|| {
            let filled = |f: fn(&Neighbor) -> f64| {
                let rows = found.iter().flat_map(move |row| {
                    (0..k).map(move |rank| row.get(rank).map_or(f64::INFINITY, f))
                });
                rows.collect::<Vec<f64>>()
            };
            let distances = filled(|neighbor| neighbor.distance_sq.sqrt());
            let numbers = found.iter().flat_map(|row| {
                (0..k).map(move |rank| row.get(rank).map_or(0, |neighbor| neighbor.index))
            });
            Ok((
                from_vec(py, distances),
                from_vec(py, numbers.collect::<Vec<u32>>()),
            ))
        })
    }

    /// From each row to the nearest of the points that lies at another place; infinite without one.
    fn nearest_elsewhere<'py>(
        &self,
        py: Python<'py>,
        array: ReadArray<'py>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let given = points(&array)?;
        let distances = with_progress(py, None, |progress| {
            let places = self.local(given);
            parallel::map_cheap(places.len(), progress, |i| {
                let found = self.index.nearest_elsewhere(&places[i]);
                found.map_or(f64::INFINITY, |neighbor| neighbor.distance_sq.sqrt())
            })
        })?;
        briefly(|| Ok(from_vec(py, distances)))
    }
}

impl PointIndex {
    fn local(&self, given: &[Point]) -> Vec<Point> {
        given.iter().map(|p| difference(p, &self.origin)).collect()
    }
}

/// From each row of `places` to the surface between the rows of `others`, and whether that is what it is
/// for their whole cloud: `others` are all of its points between the corners `low` and `high`.
#[pyfunction]
pub(super) fn surface_within<'py>(
    py: Python<'py>,
    places: ReadArray<'py>,
    others: ReadArray<'py>,
    low: Point,
    high: Point,
    options_json: &str,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let (places, others) = (points(&places)?, points(&others)?);
    let options: CompareOptions = briefly(|| Ok(options(options_json)?))?;
    let (method, k) = (options.method, options.n_neighbors);
    let (distances, settled) = with_progress(py, None, |progress| {
        let others = Cloud::of_any_shape("cloud that distances are measured to", others)?;
        let origin = others.origin();
        let (low, high) = (difference(&low, &origin), difference(&high, &origin));
        let places: Vec<Point> = places.iter().map(|p| difference(p, &origin)).collect();
        let index = NeighborIndex::new(others.points());
        let distances = surface_distances(&places, &index, method, k, progress)?;
        let n_axes = if method == DistanceMethod::Vertical {
            2
        } else {
            3
        };
        // What lies nearer to a place than the corners is known.
        let clearance = |p: &Point| {
            let sides = (0..n_axes).map(|axis| (p[axis] - low[axis]).min(high[axis] - p[axis]));
            sides.fold(f64::INFINITY, f64::min)
        };
        let holds = |found: &[Neighbor], wanted: usize, clearance: f64| match found.last() {
            Some(last) if found.len() >= wanted => last.distance_sq.sqrt() <= clearance,
            _ => clearance == f64::INFINITY,
        };
        let settled = match method {
            DistanceMethod::Nearest => {
                let within = distances.iter().zip(&places);
                within.map(|(d, p)| *d <= clearance(p)).collect()
            }
            DistanceMethod::Vertical => {
                let flat = |p: &Point| [p[0], p[1], 0.0];
                let plan: Vec<Point> = index.points().iter().map(flat).collect();
                let plan = NeighborIndex::new(&plan);
                map_places(&places, progress, Vec::new, |found, i| {
                    plan.k_nearest(&flat(&places[i]), k, found);
                    holds(found, k, clearance(&places[i]))
                })?
            }
            DistanceMethod::Plane | DistanceMethod::Normal => {
                let nearest = index.nearest_all(&places, progress)?;
                map_places(&places, progress, Vec::new, |found, i| {
                    let foot = &index.points()[nearest[i].index as usize];
                    index.k_nearest(foot, k, found);
                    nearest[i].distance_sq.sqrt() <= clearance(&places[i])
                        && holds(found, k, clearance(foot))
                })?
            }
        };
        Ok((distances, settled))
    })?;
    briefly(|| Ok((from_vec(py, distances), from_vec::<bool>(py, settled))))
}

/// Through how many points a plane goes.
#[pyfunction]
pub(super) fn plane_points(options_json: &str) -> PyResult<usize> {
    briefly(|| Ok(options::<CompareOptions>(options_json)?.n_neighbors))
}

/// From each row of `places` to the surface between as many rows of `rounds` each, in their order.
#[pyfunction]
pub(super) fn surface_of_rounds<'py>(
    py: Python<'py>,
    places: ReadArray<'py>,
    rounds: ReadArray<'py>,
    options_json: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let (places, rounds) = (points(&places)?, points(&rounds)?);
    let options: CompareOptions = briefly(|| Ok(options(options_json)?))?;
    let distances = with_progress(py, None, |progress| {
        let n_each = rounds.len() / places.len().max(1);
        let one = |i: usize| {
            let round = &rounds[i * n_each..(i + 1) * n_each];
            let local: Vec<Point> = round.iter().map(|p| difference(p, &places[i])).collect();
            let index = NeighborIndex::new(&local);
            let k = options.n_neighbors;
            surface_distances(&[[0.0; 3]], &index, options.method, k, progress)
                .map(|found| found[0])
        };
        (0..places.len())
            .map(one)
            .collect::<crate::Result<Vec<f64>>>()
    })?;
    briefly(|| Ok(from_vec(py, distances)))
}

/// The lengths of M3C2 from places of both clouds, of which only what lies round these places is there:
/// radii for normals, radius and depth of the cylinder, and the points that a significant change needs.
#[pyfunction]
pub(super) fn m3c2_scales<'py>(
    py: Python<'py>,
    places: (ReadArray<'py>, ReadArray<'py>),
    reference: ReadArray<'py>,
    compared: ReadArray<'py>,
    options_json: &str,
) -> PyResult<(Vec<f64>, f64, f64, usize)> {
    let at = (points(&places.0)?, points(&places.1)?);
    let (reference, compared) = (points(&reference)?, points(&compared)?);
    let options: M3c2Options = briefly(|| Ok(options(options_json)?))?;
    with_progress(py, None, |progress| {
        let reference = Cloud::of_any_shape("target cloud", reference)?;
        let compared = Cloud::of_any_shape("source cloud", compared)?;
        let local = |places: &[Point], cloud: &Cloud| -> Vec<Point> {
            places
                .iter()
                .map(|p| difference(p, &cloud.origin()))
                .collect()
        };
        let scales = M3c2Scales::derive_at(
            [&local(at.0, &reference), &local(at.1, &compared)],
            &NeighborIndex::new(reference.points()),
            &NeighborIndex::new(compared.points()),
            &options,
            progress,
        );
        let scales = scales.map_err(as_argument)?;
        Ok((
            scales.normal_radii_m,
            scales.cylinder_radius_m,
            scales.max_depth_m,
            options.min_points,
        ))
    })
}

/// Distances from at most `n_sampled` rows, evenly strided, to the nearest row elsewhere.
#[pyfunction]
pub(super) fn spacing_sample<'py>(
    py: Python<'py>,
    array: ReadArray<'py>,
    n_sampled: usize,
) -> PyResult<Bound<'py, PyAny>> {
    let given = points(&array)?;
    let spacings = with_progress(py, None, |progress| {
        let cloud = Cloud::of_any_shape("cloud", given)?;
        let index = NeighborIndex::new(cloud.points());
        strided_spacings_m(&index, n_sampled, progress)
    })?;
    briefly(|| Ok(from_vec(py, spacings)))
}

/// The hole radius is so many times this quantile of the spacing of the sparser cloud.
#[pyfunction]
pub(super) fn hole_radius_rule() -> (f64, f64) {
    (fuse::RADIUS_IN_SPACINGS, fuse::SPACING_QUANTILE)
}

/// Adds up the area of a surface, part by part.
#[pyclass(module = "tmchho._core")]
pub(super) struct SurfaceArea(surface_area::SurfaceArea);

#[pymethods]
impl SurfaceArea {
    #[new]
    fn new(edge: f64) -> PyResult<Self> {
        briefly(|| Ok(Self(surface_area::SurfaceArea::new(edge)?)))
    }

    /// Adds the next part of the surface.
    fn add(&mut self, py: Python<'_>, array: ReadArray<'_>) -> PyResult<()> {
        let part = points(&array)?;
        let area = &mut self.0;
        with_progress(py, None, |_| area.add(part))
    }

    /// The area of all that was added.
    fn total(&self, py: Python<'_>) -> PyResult<f64> {
        with_progress(py, None, |_| Ok(self.0.total()))
    }
}
