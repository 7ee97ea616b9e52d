"""The log-log pictures of the benchmarks; what is in them is measured elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

# Okabe and Ito's palette: told apart with any kind of colour vision, and markers differ besides.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
LIMIT = "limit of this core"
ALWAYS = {"arrays": 3, "dynamax": 4, "filterpy": 5}
"""Places in the palette of what occurs in several pictures; the others take what is left."""

Curve = tuple[Sequence[float], Sequence[float]]


def draw(
    path: Path, title: str, across: str, up: str, curves: Mapping[str, Curve], note: str
) -> bool:
    """One picture; False, after a line that says so, without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.ticker import (
            FixedLocator,
            FuncFormatter,
            LogLocator,
            NullFormatter,
            NullLocator,
        )
    except ImportError:
        print(f"  no picture {path.name}: matplotlib is not installed")
        return False
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot()
    taken = [place for word, place in ALWAYS.items() if any(k.startswith(word) for k in curves)]
    free = iter([i for i in range(7) if i not in taken] * len(curves))
    for label, (x, y) in curves.items():
        if label.startswith(LIMIT):
            axes.plot(x, y, "--", color="0.35", lw=1.5, label=label)
            continue
        same = [place for word, place in ALWAYS.items() if label.startswith(word)]
        number = same[0] if same else next(free)
        axes.plot(x, y, marker=MARKERS[number], color=COLOURS[number], label=label, lw=1.6, ms=5)
    axes.set(xscale="log", yscale="log", xlabel=across, ylabel=up)
    axes.set_title(f"{title}\n", fontsize=11, loc="left")
    axes.text(0, 1.02, note, transform=axes.transAxes, fontsize=8, color="0.35")
    ticks = sorted({v for x, _ in curves.values() for v in x})
    plain = FuncFormatter(lambda v, _: f"{v:,.10g}")
    if len(ticks) < 9:
        axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_major_formatter(plain)
    axes.xaxis.set_minor_locator(NullLocator())
    low, high = axes.get_ylim()
    if high / low < 30:
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(plain)
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(visible=True, which="major", color="0.85")
    axes.spines[["top", "right"]].set_visible(False)
    # Beside the axes, where no curve can run behind it.
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    print(f"  picture: {path}")
    return True
