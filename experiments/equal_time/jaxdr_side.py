"""Our half: derivative images of `jaxdr.render` in forward mode."""

import time

import numpy as np
from tqdm import tqdm


def estimates(path, case, setting, spp, offsets, seeds):
    """Derivative images [offsets, seeds, H, W, 3], seconds of each call, seconds to compile and run the first call.

    `setting` names the boundary estimator; or (that, its options, those of the integrator).
    """
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    boundary, options, more = setting if isinstance(setting, tuple) else (setting, {}, {})
    scene = jd.load_mitsuba(str(path))
    name = f"{case.shape}.vertices"
    rest = scene.parameters()[name]
    direction = jnp.zeros_like(rest).at[:, 0].set(1)
    integrator = jd.PathTracer(max_depth=case.max_depth, boundary=getattr(jd, boundary)(**options), **more)

    @jd.jit
    def derivative(offset, key):
        def image(vertices):
            return jd.render(scene.replace({name: vertices}), key, spp=spp, integrator=integrator)

        return jax.jvp(image, (rest + offset * direction,), (direction,))[1]

    def timed(offset, seed):
        start = time.perf_counter()
        image = jax.block_until_ready(derivative(jnp.asarray(offset, rest.dtype), jax.random.key(seed)))
        return np.asarray(image, float), time.perf_counter() - start

    _, first = timed(offsets[0], 12345)
    timed(offsets[0], 12346)
    images, seconds = [], []
    for i, offset in enumerate(tqdm(offsets, desc=f"{case.name} {boundary} {spp} spp", leave=False)):
        calls = [timed(offset, 1 + i * seeds + j) for j in range(seeds)]
        images.append([image for image, _ in calls])
        seconds += [t for _, t in calls]
    return np.array(images), seconds, first
