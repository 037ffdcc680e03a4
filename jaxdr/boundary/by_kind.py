"""`ByKind`: the boundary integral as a sum over kinds of segments, each kind by the estimator that is best at it."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.guided_edges import GuidedEdges
from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.boundary.shared.kinds import KINDS, present
from jaxdr.boundary.shared.term import Chunk, Context, Term
from jaxdr.boundary.shared.traits import Traits, known_failure
from jaxdr.transport.radiance import Answers, Requests, joined


class Part(NamedTuple):
    """An estimator, and the kinds of segments that it is asked for."""

    estimator: Any
    kinds: tuple[str, ...]


class _Held(eqx.Module):
    """What the parts have drawn, and the number of requests of each; 0 for none."""

    parts: list[Any]
    counts: tuple[int, ...] = eqx.field(static=True)


@checked
class ByKind(eqx.Module):
    """A boundary term with an estimator for each kind of segments: `rest` for those that are not named.

    A segment has light of one of three sources: `emitters` (area emitters), the `environment`, or what a surface has
    `scattered`. A vertex with `diffuse` lobes or with a `glossy` one (`BSDF.lobe_width`) sends it on. If a glossy
    vertex lies between there and the camera, the segment is `reflected`, whatever its own lobes are. So there are nine
    kinds. Together they are the whole boundary integral. An estimator of several kinds runs once, and one whose kinds
    a scene does not have takes no part.

    The defaults: `GuidedEdges` has little noise, but seldom finds what a glossy lobe sends to the camera. Only lamps
    are found from there.

    Raises ValueError for an estimator that covers no single kinds: it has no `takes_kinds`.
    """

    rest: Term = GuidedEdges()
    emitters_diffuse: Term | None = None
    emitters_glossy: Term | None = None
    emitters_reflected: Term | None = LineSampling()
    environment_diffuse: Term | None = None
    environment_glossy: Term | None = LineSampling()
    environment_reflected: Term | None = LineSampling()
    scattered_diffuse: Term | None = None
    scattered_glossy: Term | None = LineSampling()
    scattered_reflected: Term | None = LineSampling()

    name = "boundary"

    def __check_init__(self):
        for name in ("rest", *KINDS):
            estimator = getattr(self, name)
            covers = getattr(estimator, "takes_kinds", False) and not isinstance(estimator, type)
            if not (covers or (estimator is None and name != "rest")):
                raise ValueError(
                    f"ByKind: {name} must be an estimator that covers kinds of segments by themselves, such as "
                    f"jaxdr.GuidedEdges() or jaxdr.LineSampling(); got {estimator!r}"
                )

    def parts(self, kinds: tuple[str, ...] = KINDS) -> list[Part]:
        """The estimators of these kinds, each once."""
        found: list[Part] = []
        for kind in kinds:
            named = getattr(self, kind)
            estimator = self.rest if named is None else named
            if not any(part.estimator == estimator for part in found):
                found.append(Part(estimator, ()))
            found = [Part(e, (*own, kind) if e == estimator else own) for e, own in found]
        return found

    def known_failure(self, found: Traits) -> str | None:
        """See `jaxdr.boundary.shared.traits`: that of the first estimator that has one."""
        for part in self.parts():
            reason = known_failure(part.estimator, found)
            if reason is not None:
                return f"{type(part.estimator).__name__}, a part of it: {reason}"
        return None

    def prepare(self, context: Context, key: PRNGKeyArray) -> tuple[Any, ...]:
        """The states of all parts. Raises ValueError like the estimators."""
        asked = self._asked(context)
        return tuple(p.estimator.prepare(c, jax.random.fold_in(key, i)) for i, (p, c) in enumerate(asked))

    def draw(
        self, context: Context, state: tuple[Any, ...], chunk: Chunk, key: PRNGKeyArray
    ) -> tuple[Requests | None, _Held]:
        """What all parts draw, and their requests."""
        found = [
            (None, None) if own is None else part.estimator.draw(here, own, chunk, jax.random.fold_in(key, number))
            for number, ((part, here), own) in enumerate(zip(self._asked(context), state, strict=True))
        ]
        asked = [requests for requests, _ in found]
        every = [requests for requests in asked if requests is not None]
        counts = tuple(0 if requests is None else requests.emission.shape[0] for requests in asked)
        return joined(every) if every else None, _Held([held for _, held in found], counts)

    def image(
        self, context: Context, state: tuple[Any, ...], chunk: Chunk, held: _Held, answers: Answers | None
    ) -> Float[Array, "H W 3"]:
        """The sum of the parts: zero in value, right in derivative."""
        total, first = chunk.image(context.packed, jnp.zeros_like(chunk.record.radiance)), 0
        for (part, here), own, drawn, count in zip(self._asked(context), state, held.parts, held.counts, strict=True):
            found = None
            if answers is not None and count:
                found = jax.tree.map(lambda table, at=slice(first, first + count): table[at], answers)
            if own is not None:
                total += part.estimator.image(here, own, chunk, drawn, found)
            first += count
        return total

    def _asked(self, context: Context) -> list[tuple[Part, Context]]:
        """The parts that a scene needs, and the context of each."""
        kinds = present(context.packed, context.settings.max_depth, context.kinds)
        return [(part, context._replace(kinds=part.kinds)) for part in self.parts(kinds)]
