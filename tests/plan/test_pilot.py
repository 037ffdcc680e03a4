"""The choice among candidates, on settings whose variance and time are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.plan.pilot import FIRST, TURNS, Measured, Pilot, Refused, choose, measured


class Machine:
    """Knows variance of one sample, seconds of one sample and of the call; notes what is asked."""

    def __init__(self, **known):
        self.known, self.asked = known, []

    def __call__(self, settings):
        self.asked.append(settings)
        found = {}
        for name, (integrator, spp) in settings.items():
            known = self.known[integrator]
            if isinstance(known, str):
                found[name] = Refused(known)
            else:
                variance, each, fixed = known
                found[name] = Measured(spp, fixed + each * spp, variance / spp, {"interior": 0.2, "boundary": 0.8})
        return found


def nothing(best, shares):
    return {}


def tried(machine, *names):
    return {name: name for name in names or machine.known}


def test_least_error_in_equal_time():
    machine = Machine(slow=(1.0, 1.0, 0.0), noisy=(9.0, 0.2, 0.0), good=(2.0, 0.1, 0.0), other="no mirrors")
    chosen = choose(tried(machine), machine, nothing, 1.0, None)
    assert (chosen.name, chosen.integrator, chosen.spp) == ("good", "good", 10)
    assert "not possible here: other (no mirrors)" in chosen.lines
    assert {"slow", "noisy"}.isdisjoint(machine.asked[-1]), "far behind the best: not measured again"
    assert chosen.rounds[0]["good"].work == pytest.approx(0.2)


def test_what_a_call_takes_anyway_counts_for_less_with_many_samples():
    """At few samples the one without fixed costs wins, at the budget the other one."""
    machine = Machine(light=(1.0, 0.02, 0.0), heavy=(0.5, 0.01, 0.2))
    assert choose(tried(machine), machine, nothing, 0.02 * FIRST, None).name == "light"
    chosen = choose(tried(machine), machine, nothing, 2.0, None)
    assert (chosen.name, chosen.spp) == ("heavy", 180)


def test_samples_that_are_given_are_kept():
    machine = Machine(one=(1.0, 0.1, 0.0), two=(1.1, 0.1, 0.0))
    chosen = choose(tried(machine), machine, nothing, 100.0, 7)
    assert chosen.spp == 7 and all(spp == 7 for asked in machine.asked for _, spp in asked.values())


def test_pixels_that_the_pilot_has_not():
    machine = Machine(one=(1.0, 0.1, 0.0))
    assert choose(tried(machine), machine, nothing, 10.0, None, ratio=10.0).spp == 10


@pytest.mark.parametrize(("variance", "taken"), [(0.5, True), (0.95, False), (2.0, False)])
def test_a_change_has_to_be_worth_it(variance, taken):
    machine = Machine(base=(1.0, 0.1, 0.0), changed=(variance, 0.1, 0.0))

    def changes(best, shares):
        assert best == "base" and shares == {"interior": 0.2, "boundary": 0.8}
        return {"chords=4": "changed"}

    chosen = choose({"base": "base"}, machine, changes, 1.0, None)
    assert chosen.integrator == ("changed" if taken else "base")
    assert ("tried and not taken: base, chords=4" in chosen.lines) != taken


def test_where_nothing_is_possible():
    machine = Machine(one="no mirrors", two="no glass")
    with pytest.raises(ValueError, match=r"no estimator can.*no mirrors.*no glass"):
        choose(tried(machine), machine, nothing, 1.0, None)
    infinite = Machine(one=(float("nan"), 0.1, 0.0))
    with pytest.raises(ValueError, match="none is finite"):
        choose(tried(infinite), infinite, nothing, 1.0, None)


def test_variance_and_shares():
    """Of the sum of terms, and of each: independent ones add up. The median is deaf to one busy moment."""
    rng = np.random.default_rng(0)
    calls = [{n: jnp.asarray(s * rng.normal(size=(20, 20, 3))) for n, s in (("a", 1.0), ("b", 3.0))} for _ in range(8)]
    found = measured(4, calls, [0.1] * 7 + [50.0])
    assert found.seconds == 0.1
    assert found.variance == pytest.approx(10.0, rel=0.1)
    assert found.shares["b"] == pytest.approx(0.9, abs=0.02) and sum(found.shares.values()) == pytest.approx(1.0)
    still = measured(4, [{"a": jnp.zeros((2, 2, 3))}] * 3, [1e-9] * 3)
    assert still.variance == 0 and still.shares == {"a": 0.0} and still.seconds > 1e-5


def test_a_refusal_is_told(monkeypatch):
    pilot = Pilot.__new__(Pilot)  # of no scene
    pilot.key, pilot.programs = None, {}

    def refuse(integrator, spp):
        raise ValueError("render: not this one\n  because")

    monkeypatch.setattr(pilot, "_lowered", refuse)
    assert pilot({"x": (jd.PathTracer(), 4)}) == {"x": Refused("render: not this one")}


def test_programs_are_compiled_once(monkeypatch):
    """However often a setting is asked for, by whatever name, and with other keys."""
    pilot = Pilot.__new__(Pilot)  # of no scene
    own, another = jax.random.key(0), jax.random.key(1)
    pilot.key, pilot.programs = own, {}
    lowered, called = [], []

    class Lowered:
        def __init__(self, integrator, spp):
            self.setting = integrator, spp
            lowered.append(self.setting)

        def compile(self):
            return self.setting

    def call(program, turn, key):
        called.append((program, key))
        return {"interior": jnp.zeros((2, 2, 3))}, 0.1

    monkeypatch.setattr(pilot, "_lowered", Lowered)
    monkeypatch.setattr(pilot, "_call", call)
    tracer, other = jd.PathTracer(), jd.PathTracer(2)
    pilot({"x": (tracer, 4)})
    pilot({"x": (tracer, 8), "y": (tracer, 4), "z": (other, 4)}, another)
    assert lowered == [(tracer, 4), (tracer, 8), (other, 4)]
    assert all(key is own for _, key in called[: TURNS + 1])
    assert {program for program, _ in called[TURNS + 1 :]} == set(lowered)
    assert all(key is another for _, key in called[TURNS + 1 :])
