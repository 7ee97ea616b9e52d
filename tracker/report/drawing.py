"""Pictures by matplotlib without a display or any global state; what they show belongs elsewhere."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from tracker.errors import PluginError
from tracker.types import Array

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

# Okabe and Ito, Color Universal Design (2008): told apart by colour-blind readers, and in print.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
INK = "#1b2530"
QUIET = "#8a96a3"

STYLE: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": QUIET,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 11,
    "axes.prop_cycle": f"cycler('color', {list(PALETTE)})",
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 12,
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "figure.facecolor": "white",    # also on a dark page
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 11,
    "grid.color": "#e3e7eb",
    "legend.fontsize": 10,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "path.simplify": True,
    "savefig.dpi": 144,
    "svg.fonttype": "path",
    "svg.hashsalt": "tracker",    # the same picture, the same bytes
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
}  # fmt: skip
"""The house style as settings of matplotlib: ``plt.style.use(STYLE)`` draws a script's own pictures in it."""


@contextmanager
def drawing() -> Iterator[None]:
    """Draw in the house style.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise PluginError("figures need matplotlib: pip install 'tracker-lab[plot]'")
    import matplotlib as mpl

    with mpl.rc_context(
        STYLE | {"text.parse_math": False}
    ):  # names come from data; "$" is a letter
        yield


def plain_numbers(axis: Axis) -> None:
    """Label a logarithmic axis by 1, 2 and 5 times powers of ten, written out.

    Narrow ranges keep more than one label, and nothing looks like ``6e0``.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def svg(draw: Callable[[], Figure]) -> bytes:
    """The picture that ``draw`` makes, as SVG.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    return svg_and_png(draw, ("svg",))[0]


def png(draw: Callable[[], Figure]) -> bytes:
    """The picture that ``draw`` makes, as PNG.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    return svg_and_png(draw, ("png",))[0]


def svg_and_png(
    draw: Callable[[], Figure], forms: tuple[str, ...] = ("svg", "png")
) -> tuple[bytes, ...]:
    """The picture that ``draw`` makes in several forms, drawn once.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    out = []
    with drawing():
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.backends.backend_svg import FigureCanvasSVG

        picture = draw()
        picture.dpi = STYLE["savefig.dpi"]
        engine = picture.get_layout_engine()
        if engine is not None:
            FigureCanvasAgg(picture)  # whose fonts measure the texts
            engine.execute(picture)
            picture.set_layout_engine("none")  # what was laid out once stays where it is
        for form in forms:
            stream = io.BytesIO()
            # savefig would draw once more before each, to lay out what is laid out
            if form == "svg":
                vectors: Any = FigureCanvasSVG(picture)
                vectors.print_svg(stream, metadata={"Date": None})
            else:
                picture.dpi = STYLE["savefig.dpi"]
                pixels: Any = FigureCanvasAgg(picture)
                pixels.print_png(stream, metadata={"Software": None})
            out.append(stream.getvalue())
    return tuple(out)


def ellipse(mean: Array, cov: Array, *, squared_radius: float = 5.991, points: int = 61) -> Array:
    """Outline of the region that holds a Gaussian point with 95 % probability.

    Shapes:
        mean ``(2,)``, cov ``(2, 2)``; result ``(2, points)``.

    Example:
    >>> bool(np.isclose(abs(ellipse(np.zeros(2), np.eye(2))).max(), 5.991 ** 0.5))
    True
    """
    values, vectors = np.linalg.eigh(cov)
    axes = vectors * np.sqrt(squared_radius * np.maximum(values, 0.0))
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    outline: Array = mean[:, None] + axes @ np.stack([np.cos(angle), np.sin(angle)])
    return outline
