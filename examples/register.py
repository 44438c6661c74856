"""Align a photogrammetry cloud with terrestrial scans, judge the result, and fuse the two; then with a scale.

Run it with `python examples/register.py`; the fused cloud is written to the current folder.
"""

import numpy as np

import tmchho

# A construction site as two sensors see it; the photogrammetry lies anywhere, turned by any angle.
pair = tmchho.simulate.make_pair(n_photogrammetry_points=80_000, n_scanner_points=60_000, seed=3)

found = tmchho.register(pair.source, pair.target, seed=3)
print(found.summary())

# The known pose is the judge; a user has the verdict.
middle = pair.source.xyz.mean(axis=0)
wanted = pair.target_from_source[:3, :3] @ middle + pair.target_from_source[:3, 3]
error = np.linalg.norm(found.apply(middle[None])[0] - wanted)
print(f"error at the middle: {error:.3f} m, {error / found.voxel_size:.1%} of the voxel edge")

if found.verdict == "accepted":
    fused = tmchho.fuse(pair.source, pair.target, found)
    print(f"{fused.n_filled_by_source:,} photogrammetry points fill holes of the scans")
    tmchho.write(fused.to_point_cloud(pair.source, pair.target), "fused.laz", overwrite=True)

# A model without a scale: 7 degrees of freedom, and the scale comes out with its accuracy.
model = (pair.source.xyz - middle) / 1.1
found = tmchho.register(model, pair.target, dof=7, config={"scale_bounds": [1.0, 1.25]})
print(f"scale {found.scale:.4f}, standard error {found.scale_standard_error:.1e}")

# What is known roughly settles what the clouds leave open.
prior = tmchho.PosePrior(pair.target_from_source, rotation_rad=[0.2] * 3, translation_m=[5.0] * 3)
found = tmchho.register(pair.source, pair.target, prior=prior)
print(f"{found.verdict}; a point is off by {found.registration_error:.3f} m (1σ)")
