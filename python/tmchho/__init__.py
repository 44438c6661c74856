"""Register cross-source 3D point clouds without targets and without an initial guess."""
