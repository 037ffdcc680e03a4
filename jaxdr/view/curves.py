"""Diagrams as inline SVG."""

import html
import math

from jaxdr.view.tables import Curve, Diagram

WIDTH, HEIGHT = 340.0, 210.0
LEFT, RIGHT, TOP, BOTTOM = 58.0, 12.0, 24.0, 36.0
COLORS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2", "#7f7f7f", "#bcbd22")
MOST = 800  # points of a curve
SMALLEST = 1e-300  # of a difference that an axis shows
DECADES = 10.0  # positive numbers get a logarithmic axis if they differ by more than this factor


class _Axis:
    """Maps values to positions between `start` and `end`, in pixels."""

    def __init__(self, values: list[float], start: float, end: float, logarithmic: bool):
        self.logarithmic = logarithmic and min(values) > 0
        low, high = self.scaled(min(values)), self.scaled(max(values))
        size = max(abs(low), abs(high))
        if high - low <= max(1e-12 * size, SMALLEST):
            margin = size / 2 if size > SMALLEST else 0.5
            low, high = low - margin, high + margin
        self.low, self.high, self.start, self.end = low, high, start, end

    def scaled(self, value: float) -> float:
        return math.log10(value) if self.logarithmic else value

    def place(self, value: float) -> float:
        return self.start + (self.end - self.start) * (self.scaled(value) - self.low) / (self.high - self.low)

    def ticks(self) -> list[float]:
        if self.logarithmic:
            powers = range(max(math.floor(self.low), -307), min(math.ceil(self.high), 307) + 1)  # floats end there
            stride = max(1, len(powers) // 5)
            factors = (1.0,) if self.high - self.low > 2 else (1.0, 2.0, 5.0)
            found = [factor * 10.0**power for power in powers[::stride] for factor in factors]
        else:
            rough = (self.high - self.low) / 4
            unit = 10.0 ** math.floor(math.log10(rough))
            step = next(factor * unit for factor in (1, 2, 5, 10) if factor * unit >= rough)
            found = [i * step for i in range(math.floor(self.low / step), math.ceil(self.high / step) + 1)]
        slack = 1e-9 * (self.high - self.low)
        return [value for value in found if self.low - slack <= self.scaled(value) <= self.high + slack]


def svg(diagram: Diagram) -> str:
    """The diagram, with a legend if it has several curves. Its y axis is logarithmic if values differ much."""
    xs = [x for curve in diagram.curves for x in curve.x]
    ys = [y for curve in diagram.curves for y in curve.y]
    bottom, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    x_axis = _Axis(xs, LEFT, right, diagram.logarithmic_x)
    y_axis = _Axis(ys, bottom, TOP, min(ys) > 0 and max(ys) > DECADES * min(ys))
    legend = diagram.curves if len(diagram.curves) > 1 else []
    parts = [
        f'<svg class="diagram" xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT + 15 * len(legend)}" '
        f'role="img" aria-label="{html.escape(diagram.title)}">',
        _text(LEFT, 15.0, diagram.title, "title"),
        _text((LEFT + right) / 2, HEIGHT - 4, diagram.x_label, "middle"),
        f'<rect class="frame" x="{LEFT}" y="{TOP}" width="{right - LEFT}" height="{bottom - TOP}"/>',
    ]
    for value in x_axis.ticks():
        x = x_axis.place(value)
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{bottom}"/>')
        parts.append(_text(x, bottom + 14, f"{value:.4g}", "middle"))
    for value in y_axis.ticks():
        y = y_axis.place(value)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(_text(LEFT - 5, y + 4, f"{value:.4g}", "end"))
    for i, curve in enumerate(diagram.curves):
        parts.append(_line(curve, x_axis, y_axis, COLORS[i % len(COLORS)]))
    for i, curve in enumerate(legend):
        y = HEIGHT + 15 * i + 4
        parts.append(f'<circle cx="{LEFT + 4}" cy="{y}" r="4" fill="{COLORS[i % len(COLORS)]}"/>')
        parts.append(_text(LEFT + 14, y + 4, curve.name, "start"))
    return "\n".join([*parts, "</svg>"])


def _line(curve: Curve, x_axis: _Axis, y_axis: _Axis, color: str) -> str:
    stride = -(-len(curve.x) // MOST)
    points = list(zip(curve.x, curve.y, strict=True))
    points = points[::stride] + ([points[-1]] if (len(points) - 1) % stride else [])
    places = [f"{x_axis.place(x):.1f},{y_axis.place(y):.1f}" for x, y in points]
    marks = "".join('<circle cx="{}" cy="{}" r="2.5"/>'.format(*place.split(",")) for place in places)
    last = f"<title>{html.escape(curve.name)}: {curve.y[0]:.4g} to {curve.y[-1]:.4g}</title>"
    line = f'<polyline fill="none" stroke="{color}" stroke-width="1.5" points="{" ".join(places)}"/>'
    return f'<g fill="{color}">{last}{line}{marks if len(places) <= 20 else ""}</g>'


def _text(x: float, y: float, text: str, kind: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{html.escape(text)}</text>'
