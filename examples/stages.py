"""Walk the paper's route one stage at a time, on arrays.

Run it with `python examples/stages.py`.
"""

import numpy as np

import tmchho

pair = tmchho.simulate.make_pair(n_photogrammetry_points=20_000, n_scanner_points=20_000, pose="identity")
cloud = pair.target.xyz

kept = cloud[tmchho.remove_outliers(cloud).indices]
thinned = tmchho.voxel_downsample(kept, 1.0).points
keypoints = thinned[tmchho.iss_keypoints(thinned, radius=3.0)]
print(f"{len(cloud):,} points, {len(kept):,} without outliers")
print(f"{len(thinned):,} voxels, {len(keypoints):,} keypoints")

# Eq. (1): three angles in radians and three shifts; the RMS is smallest at the true pose.
about = thinned.mean(axis=0)
moved = tmchho.euler_to_matrix([0.0, 0.0, 0.02, 0.5, 0.0, 0.0])
source = (thinned - about) @ moved[:3, :3].T + moved[:3, 3]
target = thinned - about
for name, parameters in [("as given", [0.0] * 6), ("brought back", [0.0, 0.0, -0.02, -0.5, 0.01, 0.0])]:
    print(f"RMS {name}: {tmchho.rms_fitness(source, target, parameters):.4f} m")

# Eq. (8): ICP brings the last bit.
refined = tmchho.icp(source, target, method="point_to_point")
error = np.abs(refined.transformation @ moved - np.eye(4)).max()
print(f"ICP: {refined.n_iterations} iterations, largest error of the matrix {error:.1e}")
