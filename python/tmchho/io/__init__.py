"""Point cloud files: read with every attribute, write whole or not at all.

`read` goes by the content of the file, `write` by the extension of its name:

========================  =======================  =======================================================
family                    extensions               written as
========================  =======================  =======================================================
LAS/LAZ                   las laz                  layout of the file read before, else LAS 1.4
COPC                      copc.laz                 (read only, also in part)
E57                       e57                      a scan for each station, coordinates as double
PLY                       ply                      encoding of the file read before; coordinates as double
PCD                       pcd                      encoding of the file read before; coordinates as double
PTX                       ptx                      a grid for each station; intensity and colours only
text                      xyz txt csv asc pts      shortest digits that read back as the same numbers
NumPy                     npy npz                  float64; attributes as named fields or arrays
OBJ                       obj                      (read only: the vertices)
========================  =======================  =======================================================

E57 needs pye57: ``pip install 'tmchho[e57]'``.

Colours keep the depth they have in the file. Where the depths differ, 8-bit colours become 16-bit by a
factor of 256 on the way into LAS, as its specification asks, and 16-bit ones lose their lower byte on the
way into PLY and PCD, whose readers expect 0..255.
"""

from tmchho.io.atomic import atomic_path, check_output, check_writable_folder
from tmchho.io.registry import known_extensions, read, write

__all__ = ["atomic_path", "check_output", "check_writable_folder", "known_extensions", "read", "write"]
