"""How the site is made: Markdown pages by MyST, and a page for each room from the docstrings of its modules."""

import os
import sys
from pathlib import Path

os.environ["NUMBA_DISABLE_JIT"] = "1"  # kernels are plain functions then, with docstrings and signatures
DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]

import fibercontact  # noqa: E402

project = "fibercontact"
author = "The fibercontact authors"
copyright = author
version = release = fibercontact.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.viewcode", "mathml", "rooms"]
html_math_renderer = "mathml"
highlight_language = "text"
smartquotes = False  # mathematics has primes

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
add_module_names = False

html_theme = "furo"
html_title = f"fibercontact {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
