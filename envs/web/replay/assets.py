"""The parts of a page: a template, a style sheet and scripts, put together into one file that asks for nothing else."""

import base64
import hashlib
import html
import json
import string
from collections.abc import Sequence
from importlib.resources import files

from ...rendering.css import themes

DRAWING = ("brush.js", "bodies.js", "world.js")  # what draws a snapshot, in the order that they need each other


def asset(name: str) -> str:
    """A file of this folder as text."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def assemble(template: str, title: str, scripts: Sequence[str], data: str = "", connect: str = "'none'") -> str:
    """A page from the template's file name, with style.css and the scripts of these file names inlined.

    data: base64, which the scripts find as the text of #data. connect: what the page may talk to, as in
    Content-Security-Policy's connect-src. The colours are the constant COLORS. Everything else is forbidden by the
    page's policy, and only these very scripts run.
    """
    code = ['"use strict";', f"const COLORS = {json.dumps(themes())};", *(asset(name) for name in scripts)]
    style, script = asset("style.css"), "\n".join(code)
    return string.Template(asset(template)).substitute(
        title=html.escape(title),
        policy="; ".join(
            [
                "default-src 'none'",
                f"script-src {_digest(script)}",
                f"style-src {_digest(style)}",
                "img-src data:",
                f"connect-src {connect}",
                "base-uri 'none'",
                "form-action 'none'",
            ]
        ),
        style=style,
        script=script,
        data=data,
    )


def _digest(source: str) -> str:
    """By which a policy allows exactly this inline element."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()}'"
