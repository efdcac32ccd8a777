"""The parts of pages: files of this package, and constants of Python as JavaScript."""

import base64
import dataclasses
import hashlib
import html
import json
import string
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from ..rendering import style
from ..rendering.style import BLACK, BLUE, FLOOR, INK, RIM, SIZES, UNSAFE, WALL, WHITE, css, mix

# scripts, each after those that it needs
SHARED = ("dom.js", "brush.js", "bodies.js", "sight.js", "world.js", "viewport.js")
STYLE = "style.css"
NIGHT = mix(INK, BLACK, 0.45)
ICON = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 16 16'%3E%3Ccircle cx='8' cy='8' r='6' "
    f"fill='{css(BLUE)}' stroke='{css(INK)}'/%3E%3C/svg%3E"
).replace("#", "%23")

NAMES = ("HEAL", "STRIKE", "BOX", "WHOLE", "HURT", "DYING", "EXTRA", "WHITE", "RIM")
COMMON = {name.lower(): getattr(style, name) for name in NAMES} | {"accent": BLUE, "night": NIGHT}
THEMES = {
    "light": {
        "floor": FLOOR,
        "unsafe": UNSAFE,
        "wall": WALL,
        "ink": INK,
        "outline": INK,
        "page": mix(FLOOR, UNSAFE, 0.3),
        "card": mix(FLOOR, WHITE, 0.6),
    },
    "dark": {
        "floor": mix(INK, WALL, 0.35),
        "unsafe": mix(NIGHT, INK, 0.5),
        "wall": mix(WALL, RIM, 0.4),
        "ink": mix(FLOOR, UNSAFE, 0.3),
        "outline": mix(NIGHT, BLACK, 0.4),
        "page": NIGHT,
        "card": mix(NIGHT, INK, 0.8),
    },
}


def assemble(
    title: str,
    folder: str,
    scripts: Sequence[str],
    styles: Sequence[str] = (STYLE,),
    *,
    data: str = "",
    connect: str = "'none'",
    **others: Any,
) -> str:
    """Return a page that needs no other file: page.html with the body in a folder, scripts and styles inlined.

    The page's Content-Security-Policy lets only these scripts run, and connect only to `connect`. folder: that of its
    body and its own files, "play" or "replay". scripts, styles: names; each script comes after those that it needs,
    and later styles override earlier ones. data: base64, which the scripts find as the text of #data. others: constants
    for the scripts, besides COLORS by theme and SIZES (see style.py).
    """
    colors = {name: {key: css(color) for key, color in (COMMON | theme).items()} for name, theme in THEMES.items()}
    values = {"COLORS": colors, "SIZES": dataclasses.asdict(SIZES), **others}
    constants = "".join(f"const {name} = {json.dumps(value)};\n" for name, value in values.items())
    script = "\n".join(['"use strict";', constants, *(_asset(folder, name) for name in scripts)])
    sheet = "\n".join(_asset(folder, name) for name in styles)
    script_hash, sheet_hash = (
        base64.b64encode(hashlib.sha256(source.encode()).digest()).decode() for source in (script, sheet)
    )
    policy = (
        f"default-src 'none'; script-src 'sha256-{script_hash}'; style-src 'sha256-{sheet_hash}'; img-src data:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'"
    )
    template = string.Template(_asset(folder, "page.html").replace("$body", _asset(folder, "body.html")))
    return template.substitute(
        title=html.escape(title), folder=folder, icon=ICON, policy=policy, style=sheet, script=script, data=data
    )


def _asset(folder: str, name: str) -> str:
    """Return a file as text: the page's own in `folder`, otherwise the one that pages share."""
    own = files(__package__).joinpath(folder, name)
    return (own if own.is_file() else files(__package__).joinpath(name)).read_text(encoding="utf-8")
