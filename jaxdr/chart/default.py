"""How good the default is: how many times as long as the best estimator it takes to the same error."""

from collections.abc import Sequence

from jaxdr.chart.statistics import error_of_mean

BUDGETS = 0.3, 3.0, 30.0  # seconds


def error_after(rows: Sequence[dict], budget: float) -> float | None:
    """The least error of a method within so many seconds: the mean of as many calls of one rung as fit.

    None if not even one call fits. `rows`: the rungs of one method that have an error.
    """
    fitting = [(row, budget / float(row["seconds"])) for row in rows if float(row["seconds"]) <= budget]
    errors = [error_of_mean(float(row["bias2"]), float(row["deviation"]) ** 2, calls) for row, calls in fitting]
    return min(errors, default=None)


def seconds_to(rows: Sequence[dict], error: float) -> float | None:
    """The least time in which a method gets to an error; None if its bias keeps it away. `rows`: as before."""
    times = []
    for row in rows:
        left = error**2 - max(float(row["bias2"]), 0.0)
        if left > 0:
            times.append(float(row["seconds"]) * max(float(row["deviation"]) ** 2 / left, 1.0))
    return min(times, default=None)


def times_as_long(rows: Sequence[dict], default: str) -> dict[float, tuple[float, str]]:
    """By seconds: how many times as long as the best method the one called `default` takes to its error then; the best.

    `rows`: those of one scene, of methods that compete. Budgets in which no call of the default fits are left out.
    """
    methods: dict[str, list[dict]] = {}
    for row in rows:
        if row.get("rmse"):
            methods.setdefault(row["estimator"], []).append(row)
    found = {}
    for budget in BUDGETS if default in methods else ():
        error = error_after(methods[default], budget)
        if error is None:
            continue
        # A hair more than the error: it is the default's own, up to rounding.
        times = {name: seconds_to(mine, error * (1 + 1e-6)) for name, mine in methods.items()}
        least, best = min((time, name) for name, time in times.items() if time is not None)
        found[budget] = max(budget / least, 1.0), best
    return found


def line(found: dict[float, tuple[float, str]]) -> str:
    """A sentence about what `times_as_long` found."""
    parts = [f"{ratio:.2g} at {budget:g} s (best: {best})" for budget, (ratio, best) in found.items()]
    return f"To the same error the default takes, times as long as the best: {', '.join(parts)}"
