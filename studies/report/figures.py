"""The look of every figure, and figures as files and as parts of a page.

Drawn with matplotlib's objects alone: no pyplot, no window, no state between figures. An SVG
carries no date and no random identifiers, so the same numbers give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import wraps
from html import escape
from pathlib import Path
from typing import Any, Concatenate, Protocol

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..running.files import write_atomically

WIDTH_IN = 5.2
PNG_DPI = 200
# A part of a figure that has more marks becomes an image within the SVG, which stays small so.
MOST_MARKS = 1000

STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "bristle",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Arial", "Helvetica"],
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#333333",
    "axes.labelcolor": "#111111",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.color": "#333333",
    "ytick.color": "#333333",
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "legend.handlelength": 2.4,
    "lines.linewidth": 1.3,
    "lines.markersize": 4.0,
    "figure.facecolor": "white",
    "axes.formatter.useoffset": False,
}

# Okabe and Ito (2008), distinguishable with any common colour blindness.
BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, BLACK, GREY = "#CC79A7", "#56B4E9", "#000000", "#777777"
DARK = "#444444"
# Of viridis: what is lighter is hardly seen on white.
LIGHTEST = 0.75
SERIES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
# As many, since colour alone tells nothing to some, nor on a black and white print.
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
# Points. On a phone a figure is about as wide as it is in print; less cannot be read there.
SMALLEST = 7.0


@dataclass(frozen=True)
class Look:
    """How the curves of one model are drawn, whatever their colour."""

    label: str
    line: dict[str, Any]


LOOKS: dict[str, Look] = {
    "analytic": Look("analytic, Eq. 7", {"linestyle": ":", "linewidth": 1.1}),
    "beam": Look("1-D beam", {"linestyle": "-"}),
    "reduced": Look("3-D reduced", {"linestyle": (0, (5, 2.5)), "linewidth": 1.6}),
    "solid": Look("3-D full order", {"linestyle": "none", "marker": "o", "fillstyle": "none"}),
}


# For a drawing function, which runs under the project's style then.
styled = matplotlib.rc_context(STYLE)


def panels(
    rows: int = 1, columns: int = 1, height_in: float = 3.2, **share: Any
) -> tuple[Figure, np.ndarray]:
    """A figure as wide as a phone or a journal column can show, and its axes (rows, columns)."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **share)
    return figure, axes


class Drawer(Protocol):
    """What makes a function that draws into axes one that returns a figure."""

    def __call__[**P](
        self, draw: Callable[Concatenate[Axes, P], None], /
    ) -> Callable[P, Figure]: ...


def drawing(
    xlabel: str = "",
    ylabel: str = "",
    *,
    height_in: float = 3.2,
    legend: str | None = "best",
    **properties: Any,
) -> Drawer:
    """For a function that draws into axes: it returns a figure of one panel then.

    Labels, a legend at ``legend`` and ``properties`` of the axes are set when all is drawn.
    """

    def of[**P](draw: Callable[Concatenate[Axes, P], None]) -> Callable[P, Figure]:
        @styled
        @wraps(draw)
        def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
            figure, axes = panels(height_in=height_in)
            ax: Axes = axes[0, 0]
            draw(ax, *args, **kwargs)
            labels = {"xlabel": xlabel, "ylabel": ylabel}
            ax.set(**{name: label for name, label in labels.items() if label}, **properties)
            if legend is not None:
                ax.legend(loc=legend)
            return figure

        return drawn

    return of


def beside(
    ax: Axes, words: str, at: tuple[float, float], ends: str = "", above: bool = True, **look: Any
) -> None:
    """Write ``words`` 3 points off a point: ``ends`` names the side they end at, else they begin
    there. ``at`` is in data, but for x where ``look`` has other ``xycoords``."""
    aside = {"right": -3, "center": 0}.get(ends, 3)
    look = {"fontsize": 7.5, "color": DARK, **look}
    ax.annotate(
        words,
        at,
        xytext=(aside, 3 if above else -3),
        textcoords="offset points",
        ha=ends or "left",
        va="bottom" if above else "top",
        **look,
    )


def sequence(n: int) -> list[tuple[float, ...]]:
    """``n`` colours from dark to light, told apart with any colour vision and on white."""
    shades = matplotlib.colormaps["viridis"]
    return [shades(x) for x in np.linspace(0.0, LIGHTEST, n)]


def model_legend(axes: Axes, models: Sequence[str], **where: Any) -> None:
    """Name the line styles of ``models`` once, in black."""
    for model in models:
        look = LOOKS[model]
        axes.plot([], [], color=BLACK, label=look.label, **look.line)
    axes.legend(**where)


def end_labels(
    axes: Axes, heights: Sequence[float], labels: Sequence[str], colours: Sequence[Any]
) -> None:
    """Write ``labels`` right of the axes at ``heights`` (data units), moved apart where needed."""
    low, high = axes.get_ylim()
    points = 72.0 * axes.get_window_extent().height / axes.figure.dpi
    apart = 1.15 * SMALLEST / max(points, 1.0) * (high - low)
    order = [int(i) for i in np.argsort(heights)]
    placed = spread(np.asarray(heights, float)[order], apart, low, high)
    for place, i in zip(placed, order, strict=True):
        axes.annotate(
            labels[i],
            (1.0, place),
            xycoords=("axes fraction", "data"),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=SMALLEST,
            color=colours[i],
            annotation_clip=False,
        )


def spread(places: np.ndarray, apart: float, low: float, high: float) -> np.ndarray:
    """Sorted ``places`` moved as little as simple shifts allow, ``apart`` from each other."""
    placed = places.copy()
    for i in range(1, len(placed)):
        placed[i] = max(placed[i], placed[i - 1] + apart)
    if len(placed) and placed[-1] > high:
        placed[-1] = high
        for i in range(len(placed) - 2, -1, -1):
            placed[i] = min(placed[i], placed[i + 1] - apart)
    return np.maximum(placed, low) if len(placed) * apart <= high - low else placed


def stiffness_label(kn_N_m: float) -> str:
    """Kn in the paper's unit, such as ``2 MN/m``."""
    return f"{kn_N_m / 1e6:g} MN/m"


def inline_svg(document: str, prefix: str, title: str) -> str:
    """An SVG document as an element of a page: own identifiers, scalable, named for readers.

    ``prefix`` keeps identifiers of several figures on one page apart. ``title`` is plain text.
    """
    body = document[document.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', body)
    body = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", body)
    body = re.sub(r'(?:xlink:)?href="#([^"]+)"', rf'href="#{prefix}-\1"', body)
    body = re.sub(r'\sxmlns(?::\w+)?="[^"]*"', "", body)
    body = re.sub(r'\s(?:width|height)="[\d.]+pt"', "", body, count=2)
    opening, rest = body.split(">", 1)
    label = f"{prefix}-title"
    head = f'{opening} role="img" aria-labelledby="{label}">'
    return f'{head}<title id="{label}">{escape(title, quote=False)}</title>{rest}'.strip()


@dataclass(frozen=True)
class Picture:
    """A figure as an SVG document and as PNG bytes."""

    svg: str
    png: bytes = field(repr=False)


def picture(figure: Figure) -> Picture:
    """Both forms of a figure, the same bytes for the same figure."""
    svg, png = io.StringIO(), io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(png, format="png", dpi=PNG_DPI, metadata={"Software": None})
        for axes in figure.axes:
            for each in axes.get_children():
                if _marks(each) > MOST_MARKS:
                    each.set_rasterized(True)
        figure.savefig(svg, format="svg", dpi=PNG_DPI, metadata={"Date": None, "Creator": None})
    lines = "".join(f"{line.rstrip()}\n" for line in svg.getvalue().splitlines())
    return Picture(lines, png.getvalue())


def _marks(drawn: Artist) -> int:
    """How many marks or strokes of its own a part of a figure has."""
    if isinstance(drawn, Line2D):
        bare = drawn.get_marker() in (None, "None", "", " ")
        return 0 if bare else np.size(drawn.get_xdata())
    if isinstance(drawn, Collection):
        return max(len(drawn.get_paths()), np.size(drawn.get_offsets()) // 2)
    return 0


def picture_files(stem: str) -> tuple[str, str]:
    """The names of a picture's files."""
    return f"{stem}.svg", f"{stem}.png"


def write_picture(stem: Path, drawn: Picture) -> list[str]:
    """Write ``stem``.svg and ``stem``.png; returns their names."""
    svg, png = picture_files(stem.name)
    write_atomically(stem.parent / svg, drawn.svg)
    write_atomically(stem.parent / png, drawn.png)
    return [svg, png]
