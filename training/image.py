"""What all figures have in common: fonts, colours, and the files they become. Needs matplotlib."""

import io
from collections.abc import Callable
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

DPI = 150  # pixels an inch
GREY = "#5b5f68"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.labelcolor": GREY,
    "axes.edgecolor": "#9a9da4",
    "xtick.color": GREY,
    "ytick.color": GREY,
    "text.color": "#26292f",
    "svg.hashsalt": "outlast",  # the same picture, the same file
}


def colour(rgb: tuple[int, int, int]) -> str:
    """Return a colour in matplotlib's form."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def encoded(draw: Callable[[], Figure], form: str, about: dict[str, str], colours: int) -> bytes:
    """Return a figure as the content of a file; the same figure gives the same bytes.

    Args:
        draw: Makes the figure.
        form: "png" or "svg".
        about: Metadata for the file: "Title", and "Source", a digest of what is shown.
        colours: The number of colours in a PNG, at most 256, which takes a quarter of the bytes of a full-colour one.
    """
    content = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure = draw()
        if form == "svg":
            figure.savefig(content, format=form, metadata={**about, "Date": None})
        else:
            _save_png(figure, content, about, colours)
    return content.getvalue()


def _save_png(figure: Figure, content: io.BytesIO, about: dict[str, str], colours: int) -> None:
    pixels = io.BytesIO()
    figure.savefig(pixels, format="png", dpi=DPI)
    texts = PngInfo()
    for key, text in about.items():
        texts.add_text(key, text)
    few = Image.open(pixels).convert("RGB").quantize(colours, Image.Quantize.MAXCOVERAGE)
    few.save(content, format="png", optimize=True, pnginfo=texts, dpi=(DPI, DPI))


def literal(text: str) -> str:
    """Return text in which $ does not begin a formula."""
    return text.replace("$", r"\$")
