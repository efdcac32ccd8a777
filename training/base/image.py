"""What all figures have in common: fonts, colours, and how they become files. Needs matplotlib."""

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
    "svg.hashsalt": "outlast",  # so that the same picture gives the same file
}


def colour(rgb: tuple[int, int, int]) -> str:
    """Return a colour in matplotlib's form."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def encoded(draw: Callable[[], Figure], form: str, about: dict[str, str], colours: int) -> bytes:
    """Encode a figure as a file: the same figure gives the same bytes.

    form: "png" or "svg". about: Kept in the file: "Title", and "Source", a digest of what is shown. colours: How many
    colours a PNG has, at most 256: it takes a quarter of the bytes that it would with all.
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
    """Escape a text, so that $ begins no formula."""
    return text.replace("$", r"\$")
