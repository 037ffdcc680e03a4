"""An optimiser of PyTorch: where a ball is and which colour it has, from one image. Needs `pip install -e ".[torch]"`.

`jaxdr.torch.from_jax` makes a function of JAX arrays a function of tensors. PyTorch differentiates it: visibility
changes, here the silhouette and the shadow, are included.
"""

import jax
import torch

import jaxdr as jd
import jaxdr.torch

PIXELS, SAMPLES, STEPS = 48, 16, 60


def make_scene() -> jd.Scene:
    """A ball above a floor, under a square lamp."""
    ball = jd.Shape(jd.shapes.sphere(2, radius=0.5, center=(0.0, 0.0, 0.8)), jd.Diffuse(0.5))
    floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
    shapes = {"ball": ball, "floor": floor, "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0))}
    to_world = jd.look_at((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1))
    return jd.Scene(shapes, jd.Perspective(to_world, fov=35.0, film=jd.Film(PIXELS, PIXELS)))


def main(steps: int = STEPS) -> tuple[torch.Tensor, torch.Tensor]:
    """Returns place and colour that were found."""
    scene, tracer = make_scene(), jd.PathTracer(max_depth=2)

    @jaxdr.torch.from_jax
    def image(place, colour, key):
        moved = jd.move(scene, {"ball.translate": place})
        return jd.render(moved.replace({"ball.bsdf.reflectance": colour}), key, SAMPLES, tracer)

    with torch.no_grad(), jd.working("compiling the image"):
        target = image(torch.tensor([0.4, 0.1, 0.2]), torch.tensor([0.8, 0.4, 0.1]), jax.random.key(0))

    place = torch.zeros(3, requires_grad=True)
    latent = torch.zeros(3, requires_grad=True)  # has no bounds; a sigmoid of it is a colour
    optimiser = torch.optim.Adam([{"params": [place], "lr": 0.03}, {"params": [latent], "lr": 0.1}])
    with jd.working("compiling the gradient"):
        image(place, torch.sigmoid(latent), jax.random.key(1)).sum().backward()
    for step in range(steps):
        optimiser.zero_grad()
        found = image(place, torch.sigmoid(latent), jax.random.key(step + 1))
        loss = torch.nn.functional.mse_loss(found, target)
        loss.backward()
        optimiser.step()
        if step % 10 == 0:
            print(f"step {step}: loss {loss.item():.4f}, moved by {place.tolist()}")
    return place.detach(), torch.sigmoid(latent).detach()


if __name__ == "__main__":
    place, colour = main()
    print("moved by", place.tolist(), "colour", colour.tolist())
