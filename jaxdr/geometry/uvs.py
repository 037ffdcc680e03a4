"""Texture coordinates for meshes that have none."""

import numpy as np

from jaxdr.geometry.mesh import Mesh


def spherical_uvs(mesh: Mesh) -> Mesh:
    """The mesh with longitude around the z axis as u and latitude as v, as seen from the origin; on the host.

    v = 0 is -z, u = 0 is +x. Faces across the meridian u = 0 have u up to 3/2 or below 0, so a texture that repeats
    does not jump there. At a pole u is the mean of the face's other corners. It is made for closed meshes that every
    ray from the origin meets once. On other meshes several points share a texel.

    Raises ValueError for a mesh with a vertex at the origin.
    """
    x, y, z = np.asarray(mesh.vertices, np.float64).T
    across = np.hypot(x, y)
    radius = np.hypot(across, z)
    if not radius.all():
        raise ValueError("spherical_uvs: a vertex at the origin has no direction; move the mesh around the origin")
    faces = np.asarray(mesh.faces)
    u = (np.arctan2(y, x) / (2 * np.pi) % 1.0)[faces]
    v = (0.5 + np.arctan2(z, across) / np.pi)[faces]
    pole = (across < 1e-6 * radius)[faces]
    rows, first = np.arange(len(faces)), np.argmin(pole, axis=1)  # a corner that is not at a pole
    u += np.round(u[rows, first][:, None] - u)
    others = np.where(pole, 0.0, u).sum(1) / np.maximum((~pole).sum(1), 1)
    u = np.where(pole, others[:, None], u)
    uvs, index = np.unique(np.stack([u, v], -1).reshape(-1, 2), axis=0, return_inverse=True)
    return mesh.with_uvs(uvs, index.reshape(-1, 3))
