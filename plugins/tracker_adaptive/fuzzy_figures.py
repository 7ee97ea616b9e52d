"""Pictures of fuzzy systems: membership functions, and what the system answers; nothing is computed here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from tracker.errors import DomainError, wording
from tracker.report.drawing import PALETTE, drawing
from tracker_adaptive.fuzzy_sets import GaussianSet, SampledSet, numbers_of_set
from tracker_adaptive.fuzzy_system import FuzzySystem, Variable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 401


def _span(one: Variable) -> tuple[float, float]:
    """Its range, or where all of its sets are."""
    if one.range is not None:
        return one.range
    ends: list[float] = []
    for fuzzy in one.terms.values():
        if isinstance(fuzzy, GaussianSet):
            centre, width = np.asarray(fuzzy.centre), np.asarray(fuzzy.width)
            ends += [float((centre - 2.0 * width).min()), float((centre + 2.0 * width).max())]
        elif isinstance(fuzzy, SampledSet):
            ends += [fuzzy.places[0], fuzzy.places[-1]]
        else:
            corners = [np.asarray(v) for v in numbers_of_set(fuzzy).values()]
            ends += [float(corners[0].min()), float(corners[-1].max())]
    return min(ends), max(ends)


def membership_figure(system: FuzzySystem) -> Figure:
    """The membership functions of all inputs and of the output, one panel each.

    Raises:
        PluginError: if matplotlib is not installed.
        DomainError: if numbers differ per lane.
    """
    _alone(system)
    with drawing():
        from matplotlib.figure import Figure

        variables = (*system.inputs, system.output)
        figure = Figure(figsize=(4.6 * len(variables), 3.2))
        for place, one in enumerate(variables):
            axis = figure.add_subplot(1, len(variables), place + 1)
            low, high = _span(one)
            x = np.linspace(low, high, _POINTS)
            for k, (term, fuzzy) in enumerate(one.terms.items()):
                y = np.asarray(fuzzy.membership(x))
                axis.plot(x, y, color=PALETTE[k % len(PALETTE)])
                _label(axis, term, low, high, x, y, fuzzy.middle, PALETTE[k % len(PALETTE)])
            axis.set_ylim(0.0, 1.18)
            axis.set_xlim(low, high)
            axis.set_yticks([0.0, 0.5, 1.0])
            axis.set_xlabel(one.name + (f" [{one.unit}]" if one.unit else ""))
            axis.set_title("output" if one is system.output else "input")
            if place == 0:
                axis.set_ylabel("membership")
        return figure


def _label(
    axis: Any, term: str, low: float, high: float, x: Any, y: Any, middle: Any, colour: str
) -> None:
    """The name of a term above its top, where it is within the picture."""
    at = min(max(float(middle), low), high)
    edge = 0.03 * (high - low)
    side = "left" if at < low + edge else "right" if at > high - edge else "center"
    height = float(np.interp(at, x, y))
    axis.annotate(term, (at, height), (0, 4), textcoords="offset points", ha=side, color=colour)


def surface_figure(system: FuzzySystem, fixed: Mapping[str, float] | None = None) -> Figure:
    """What the system answers: a curve over its one input, or a map over two; ``fixed`` holds the others.

    Raises:
        PluginError: if matplotlib is not installed.
        DomainError: if not one or two inputs remain, or numbers differ per lane.
    """
    _alone(system)
    held = dict(fixed or {})
    free = [one for one in system.inputs if one.name not in held]
    if not 1 <= len(free) <= 2 or set(held) - {one.name for one in system.inputs}:
        raise DomainError(
            wording(
                "surface of a fuzzy system",
                got=f"inputs {', '.join(v.name for v in system.inputs)}, of which {', '.join(held) or 'none'} fixed",
                expected="one or two inputs that are free",
                do="pass fixed={'name': value} for the others",
            )
        )
    with drawing():
        from matplotlib.figure import Figure

        axes = [np.linspace(*_span(one), _POINTS if len(free) == 1 else 121) for one in free]
        mesh = dict(zip((v.name for v in free), np.meshgrid(*axes, indexing="ij"), strict=True))
        answer = system(*(mesh.get(v.name, held.get(v.name)) for v in system.inputs))
        figure = Figure(figsize=(5.2, 3.6))
        axis = figure.add_subplot()
        label = system.output.name + (f" [{system.output.unit}]" if system.output.unit else "")
        axis.set_xlabel(free[0].name + (f" [{free[0].unit}]" if free[0].unit else ""))
        if len(free) == 1:
            axis.plot(axes[0], np.asarray(answer))
            axis.set_ylabel(label)
        else:
            drawn = axis.pcolormesh(*axes, np.asarray(answer).T, shading="gouraud", cmap="cividis")
            axis.contour(*axes, np.asarray(answer).T, colors="white", linewidths=0.6)
            axis.set_ylabel(free[1].name + (f" [{free[1].unit}]" if free[1].unit else ""))
            figure.colorbar(drawn, label=label)
            axis.grid(visible=False)
        if held:
            axis.set_title(", ".join(f"{k} = {v:g}" for k, v in held.items()))
        return figure


def _alone(system: FuzzySystem) -> None:
    if any(np.ndim(v) for v in system.parameters.values()):
        raise DomainError(
            wording(
                "picture of a fuzzy system",
                got="numbers that differ per lane",
                expected="one number each",
                do="choose a lane: system.with_parameters(...)",
            )
        )
