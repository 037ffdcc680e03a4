"""Write your own BSDF: Minnaert's model of the moon, in one class. Explained in docs/write_a_bsdf.md."""

import math

import jax
import jax.numpy as jnp

import jaxdr as jd
from jaxdr.geometry.vector import scale, z_of
from jaxdr.scene.bsdf.base import both_above
from jaxdr.scene.bsdf.parameters import Color, Number, Value, number, rgb
from jaxdr.scene.sampling import cosine_hemisphere


class Minnaert(jd.BSDF):
    """f = reflectance (k + 1) / (2 pi) (cos_i cos_o)^(k - 1): k = 1 is diffuse, larger k darkens the rim."""

    reflectance: Color
    k: Number

    def __init__(self, reflectance: Value = 0.5, k: Value = 1.5):
        self.reflectance = rgb(reflectance, "Minnaert: reflectance")
        self.k = number(k, "Minnaert: k", 1.0, 4.0)

    def eval(self, wi, wo):
        """f times the cosine of wo. Directions are in the local frame, whose z axis is the normal."""
        above = both_above(wi, wo)
        cos_i, cos_o = (jnp.where(above, z_of(w), 1.0) for w in (wi, wo))
        value = (self.k + 1) / (2 * math.pi) * (cos_i * cos_o) ** (self.k - 1) * cos_o
        return scale(self.reflectance, jnp.where(above, value, 0.0))

    def pdf(self, wi, wo):
        """Density of `sample`, per solid angle."""
        return jnp.where(both_above(wi, wo), z_of(wo), 0.0) / math.pi

    def sample(self, wi, u):
        """A direction for two uniform numbers."""
        return cosine_hemisphere(u)


def main(pixels: int = 48) -> jax.Array:
    """Writes moon.png; returns the derivative of the image's mean by k."""
    moon = jd.Shape(jd.shapes.sphere(4).smooth(), Minnaert(0.6, 1.5))
    sun = {"sun": jd.DirectionalLight((1.0, 1.0, -0.3), 3.0)}
    camera = jd.Perspective(jd.look_at((0, -4, 0), (0, 0, 0), (0, 0, 1)), 35.0, jd.Film(pixels, pixels))
    scene = jd.Scene({"moon": moon}, camera, lights=sun)
    image = jax.jit(lambda k, key: jd.render(scene.replace({"moon.bsdf.k": k}), key, 16, jd.PathTracer(max_depth=2)))
    jd.write_image("moon.png", image(1.5, jax.random.key(0)))
    return jax.grad(lambda k: image(k, jax.random.key(0)).mean())(1.5)


if __name__ == "__main__":
    with jd.working("compiling and rendering"):
        derivative = main()
    print("derivative of the mean by k:", derivative)
