"""What all figures share: size, letters, axes, color bar, names."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

# matplotlib is imported only when something is drawn: importing it takes as long as the rest of a program's start.
if TYPE_CHECKING:
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure as Drawing


_DPI = 150
#: Width of a figure in inches, and size of its letters in points: on a telephone that shows the figure 356 pixels wide, letters
#: still have 11 pixels.
WIDTH_IN = 6.4
LETTERS_PT = 14.5
#: Most letters of a name in a picture, half of its width.
MOST_LETTERS = 24
#: Inches below a picture for its color bar.
BAR_IN = 0.66


def new_drawing(width_in: float, height_in: float, layout: Literal["constrained"] | None = None) -> Drawing:
    """An empty drawing, sides in inches."""
    from matplotlib.figure import Figure as Drawing

    return Drawing(figsize=(width_in, height_in), layout=layout)


def few_ticks(most: int) -> Any:
    """Positions of at most so many ticks."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(most)


def outline(color: str) -> list[Any]:
    """An outline for letters on a picture."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2.5, foreground=color)]


def two_colors(first: str, second: str) -> Colormap:
    """The color scale of a map of two classes."""
    from matplotlib.colors import ListedColormap

    return ListedColormap([first, second])


def drawn(drawing: Drawing) -> NDArray[np.uint8]:
    """The drawing as a picture, H×W×3."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    drawing.set_dpi(_DPI)
    canvas = FigureCanvasAgg(drawing)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def over_bar(shape: Sequence[int], bar_in: float) -> tuple[Drawing, Any]:
    """A drawing with axes for a picture of this shape over the whole width, and `bar_in` inches of space below it."""
    drawing = new_drawing(WIDTH_IN, WIDTH_IN * shape[0] / shape[1] + bar_in)
    below = bar_in / drawing.get_figheight()
    return drawing, drawing.add_axes((0, below, 1, 1 - below))


def _beyond(colored: Any) -> Literal["neither", "min", "max", "both"]:
    """At which ends of its color scale a picture or points have values beyond the scale."""
    values = np.asarray(colored.get_array(), dtype=float)
    known, (low, high) = values[np.isfinite(values)], colored.get_clim()
    if not known.size:
        return "neither"
    below, above = bool((known < low).any()), bool((known > high).any())
    return "both" if below and above else "min" if below else "max" if above else "neither"


def _complete_numbers(axis: Any) -> None:
    """Label an axis with complete numbers, such as 0.00002 or 1000.05: matplotlib would write a common factor or offset beside them,
    where it is cut off.
    """
    axis.get_major_formatter().set_useOffset(False)
    axis.get_major_formatter().set_scientific(False)


def color_bar(drawing: Drawing, colored: Any, label: str, ticks: Mapping[float, str] | None = None) -> None:
    """Add the color bar of a picture or of points below it, with the unit; an arrow at its end stands for values beyond its limits."""
    height = BAR_IN / drawing.get_figheight()
    axes = drawing.add_axes((0.15, height * 0.62, 0.65, height * 0.2))
    bar = drawing.colorbar(colored, cax=axes, orientation="horizontal", extend=_beyond(colored))
    bar.outline.set_linewidth(0.4)
    axes.tick_params(labelsize=LETTERS_PT, length=2)
    if ticks:
        bar.set_ticks(list(ticks), labels=list(ticks.values()))
    else:
        bar.locator = few_ticks(4)
        bar.update_ticks()
        _complete_numbers(axes.xaxis)
    if label:
        drawing.text(0.82, height * 0.72, label, fontsize=LETTERS_PT, va="center")


def style(axes: Any) -> None:
    """Thin axes with a light grid."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(labelsize=LETTERS_PT, color="#8a8f96")
    axes.grid(color="#e3e6ea", lw=0.6)
    _complete_numbers(axes.xaxis)
    _complete_numbers(axes.yaxis)
    axes.set_axisbelow(True)


def tag(axes: Any, at: Any, word: str) -> None:
    """Write a name above a point, such as a box's upper left corner or a line's start; left of it if there is no space above. A name
    that would leave the picture at a side is moved into it.

    Text between two $ in a user's name is no formula.
    """
    bottom, top = axes.get_ylim()
    above = at[1] - top > 0.1 * (bottom - top)
    text = axes.annotate(
        word, at, xytext=(0, 8) if above else (-8, -5), textcoords="offset points", color="white", fontsize=LETTERS_PT,
        ha="left" if above else "right", va="bottom" if above else "top",
        bbox={"boxstyle": "round,pad=0.25", "fc": "#d1495b", "ec": "none"}, parse_math=False,
    )  # fmt: skip
    pixels_per_point = axes.figure.dpi / 72
    box, picture = text.get_window_extent().padded(0.3 * LETTERS_PT * pixels_per_point), axes.get_window_extent()
    inwards = max(picture.x0 - box.x0, 0) + min(picture.x1 - box.x1, 0)
    text.xyann = (text.xyann[0] + inwards / pixels_per_point, text.xyann[1])


def can_be_drawn(name: str) -> bool:
    """Whether matplotlib can write a name: its font has all letters, and they run from left to right."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    font = get_font(findfont(FontProperties()))
    return all(
        font.get_char_index(ord(letter)) != 0 and unicodedata.bidirectional(letter) not in ("R", "AL")
        for letter in name
    )


def names_in_picture(names: Sequence[str]) -> tuple[list[str], str]:
    """What a picture calls things: their names, or numbers such as (2) for names that `can_be_drawn` refuses or that are too long;
    and a sentence for the caption that says which name each number stands for, "" if there is none.
    """
    called = [
        name if len(name) <= MOST_LETTERS and can_be_drawn(name) else f"({number})"
        for number, name in enumerate(names, 1)
    ]
    said = ", ".join(f"{one} is {name}" for one, name in zip(called, names, strict=True) if one != name)
    return called, f" {said}." if said else ""
