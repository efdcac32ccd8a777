"""Plays films in the pages: in HTML, a link to a .webm becomes the film. GitHub shows it as the link that it is."""

import html
import posixpath
from typing import Any

from docutils import nodes
from sphinx.addnodes import download_reference
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator


def visit(self: HTML5Translator, node: download_reference) -> None:
    """Write a film in place of its link."""
    if not node.get("filename", "").endswith(".webm"):
        HTML5Translator.visit_download_reference(self, node)
        return
    file = html.escape(posixpath.join(self.builder.dlpath, node["filename"]))
    label = html.escape(node.astext())
    self.body.append(f'<video src="{file}" aria-label="{label}" autoplay loop muted playsinline controls></video>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension; called by Sphinx."""
    app.add_node(download_reference, override=True, html=(visit, HTML5Translator.depart_download_reference))
    return {"parallel_read_safe": True}
