"""Pictures of the array convention, drawn while the site is built, and how the gallery keeps its own."""

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.patches import Rectangle

FOLDER = "generated/pictures"
STATE, LANES, TIME, GREY = "#2563a6", "#d97706", "#4d7c0f", "#6b7280"
SHADES = ["#2563a6", "#4f86bd", "#86aed4", "#bdd4ea"]
INK = ["white", "white", "#111", "#111"]
NAMES = ["x", "y", "vx", "vy"]
CODE = {"family": "monospace", "fontsize": 11}


def vectors(block: Any, block_vars: Any, gallery_conf: Any) -> str:
    """What a tutorial has drawn, as SVG: sharp at any size."""
    from sphinx_gallery.scrapers import matplotlib_scraper

    return str(matplotlib_scraper(block, block_vars, gallery_conf, format="svg"))


def _canvas(width: float, height: float) -> tuple[Any, Any]:
    """Axes in which a box is one unit, y downwards."""
    figure, axes = plt.subplots(figsize=(width / 2, height / 2), facecolor="white")
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.axis("off")
    figure.subplots_adjust(0, 0, 1, 1)
    return figure, axes


def _box(axes: Any, x: float, y: float, shade: int, text: str = "", size: float = 1.0) -> None:
    axes.add_patch(Rectangle((x, y), size, size, facecolor=SHADES[shade], edgecolor="white"))
    middle = size / 2
    axes.text(x + middle, y + middle, text, ha="center", va="center", color=INK[shade], fontsize=10)


def _frame(axes: Any, x: float, y: float, width: float) -> None:
    axes.add_patch(Rectangle((x, y), width, 1, fill=False, edgecolor="#111", linewidth=2))


def _arrow(
    axes: Any, start: tuple[float, float], end: tuple[float, float], colour: str
) -> tuple[float, float]:
    style = {"arrowstyle": "->", "color": colour, "linewidth": 1.6}
    axes.annotate("", end, start, arrowprops=style)
    return (start[0] + end[0]) / 2, (start[1] + end[1]) / 2


def _label(axes: Any, x: float, y: float, text: str, colour: str, turned: float = 0) -> None:
    axes.text(
        x, y, text, color=colour, rotation=turned, ha="center", va="center", fontsize=11,
        weight="bold",
    )  # fmt: skip


def one_and_many() -> Any:
    """A state of one target beside states of six: components down, lanes to the right."""
    figure, axes = _canvas(14.4, 7.4)
    for left, title, shape in ((1.5, "one target", "(4,)"), (9.4, "six of them", "(4, 6)")):
        axes.text(left + 0.5, 0.5, title, ha="center", fontsize=12, weight="bold")
        axes.text(left + 0.5, 1.15, f"shape {shape}", ha="center", color=GREY, **CODE)
    for row, name in enumerate(NAMES):
        _box(axes, 1.5, 2.3 + row, row, name)
        for lane in range(6):
            _box(axes, 6.9 + lane, 2.3 + row, row, f"{name}{lane}")
    for left, text in ((1.0, "components"), (6.4, "components first")):
        x, y = _arrow(axes, (left, 2.3), (left, 6.3), STATE)
        _label(axes, x - 0.4, y, text, STATE, 90)
    x, y = _arrow(axes, (6.9, 2.1), (12.9, 2.1), LANES)
    _label(axes, x, y - 0.4, "batch last", LANES)
    _frame(axes, 1.5, 2.3, 1)
    _frame(axes, 6.9, 2.3, 6)
    axes.text(2.0, 7.0, "state[0]", ha="center", **CODE)
    axes.text(9.9, 7.0, "state[0]: all six x", ha="center", **CODE)
    return figure


def covariance() -> Any:
    """Covariances: two matrix axes, then the lanes as sheets behind each other."""
    figure, axes = _canvas(14.4, 7.4)
    for lane in (2, 1, 0):
        left, top = 1.5 + 0.75 * lane, 2.0 - 0.75 * lane
        for i, a in enumerate(NAMES):
            for j, b in enumerate(NAMES):
                shade = min(3, abs(i - j) + (lane > 0))
                _box(axes, left + j, top + i, shade, "" if lane else f"{a}\u00b7{b}")
    x, y = _arrow(axes, (1.1, 2.0), (1.1, 6.0), STATE)
    _label(axes, x - 0.4, y, "n", STATE)
    x, y = _arrow(axes, (1.5, 6.4), (5.5, 6.4), STATE)
    _label(axes, x, y + 0.45, "n", STATE)
    x, y = _arrow(axes, (5.8, 6.0), (7.3, 4.5), LANES)
    _label(axes, x + 0.9, y + 0.4, "batch", LANES)
    for k, (code, text) in enumerate((
        ("cov", "shape (4, 4, *batch)"),
        ("cov[0, 2]", "of x and vx, for every lane"),
        ("cov[..., 7]", "the whole matrix of lane 7"),
    )):  # fmt: skip
        axes.text(8.9, 1.2 + 1.4 * k, code, weight="bold", **CODE)
        axes.text(8.9, 1.75 + 1.4 * k, text, color=GREY, fontsize=10.5)
    return figure


def history() -> Any:
    """A history: time leads, then components, then lanes."""
    figure, axes = _canvas(14.4, 6.6)
    for step in range(4):
        left = 0.9 + 3.6 * step
        for lane in (2, 1, 0):
            for row, name in enumerate(NAMES):
                shade = 3 if lane else row
                _box(axes, left + 0.4 * lane, 2.2 - 0.4 * lane + row, shade, "" if lane else name)
        axes.text(left + 0.5, 6.6, f"mean[{step}]", ha="center", va="bottom", **CODE)
    x, y = _arrow(axes, (0.9, 0.9), (13.8, 0.9), TIME)
    _label(axes, x, y - 0.45, "time leads: mean has shape (T, n, *batch)", TIME)
    return figure


PICTURES = {"one_and_many": one_and_many, "covariance": covariance, "history": history}


def draw(folder: Path) -> None:
    """All pictures, as files in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context({"svg.hashsalt": "tracker"}):
        for name, picture in PICTURES.items():
            figure = picture()
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)


def setup(app: Any) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("builder-inited", lambda app: draw(Path(app.srcdir, FOLDER)))
    return {"parallel_read_safe": True}
