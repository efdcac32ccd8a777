"""The configuration of the site, which is built with: python -m sphinx -W docs SOMEWHERE (pip install '.[docs]')."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

import outlast

project = "outlast"
author = "The outlast authors"
version = release = outlast.__version__
html_title = f"outlast {version}"

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "film", "replay", "tables"]
nb_execution_mode = "off"  # notebooks hold their outputs, which docs/notebooks.py makes
exclude_patterns = ["_build", "examples", "pull_request_template.md"]
default_role = "code"  # for single backticks in docstrings
napoleon_use_ivar = True  # show the attributes of a class as a list
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["gallery.css"]
html_copy_source = False
html_show_copyright = False
pygments_style = "friendly"

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3

# Adapters are documented without their libraries, which take seconds to load, and need not be installed.
autodoc_mock_imports = [
    *("benchmarl", "pettingzoo", "pufferlib", "ray", "stable_baselines3", "tensordict", "torch", "torchrl")
]
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
