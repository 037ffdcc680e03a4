"""Export to Blender: write a mesh as GLB with its y axis up, so that it stands upright there.

In Blender: File, Import, glTF 2.0. glTF has y up, and Blender turns it to z up. jaxdr's shapes have z up, so we turn
them once.
"""

import jax.numpy as jnp

import jaxdr as jd

# (x, y, z) with z up becomes (x, z, -y) with y up: a quarter turn about x.
Y_UP = jnp.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def main(path: str = "duck.glb") -> jd.Mesh:
    """Writes a duck; returns what is read back from the file."""
    duck = jd.shapes.duck(4).smooth()
    jd.save_mesh(path, duck.with_vertices(duck.vertices @ Y_UP.T))
    # The file splits vertices where normals differ; reading joins them again, so that edges know both their faces.
    return jd.load_mesh(path, shading="file")


if __name__ == "__main__":
    mesh = main()
    print("vertices:", len(mesh.vertices), "faces:", len(mesh.faces), "closed:", mesh.closed)
