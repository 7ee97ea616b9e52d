"""How the site is built: `./x docs`, warnings are errors. What it says is in the pages."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "plugins")]
os.environ.setdefault("MPLBACKEND", "Agg")

from extensions import pictures

import tracker

project = "tracker"
author = "The tracker authors"
copyright = "The tracker authors, MIT licence"  # noqa: A001 - Sphinx's name for it
version = release = tracker.__version__
language = "en_GB"

extensions = [
    "sphinx.ext.autodoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "extensions.docstrings",
    "extensions.generated",
    "extensions.pictures",
]
exclude_patterns = ["extensions", "gallery/**/*.ipynb", "gallery/**/*.py", "gallery/**/*.zip"]
templates_path = []
default_role = "py:obj"  # `name` in a docstring links where it can and is code where it cannot

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike"}
python_maximum_signature_line_length = 88

sphinx_gallery_conf = {
    "examples_dirs": [str(HERE.parent / "examples" / "tutorials")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"__init__\.py",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "run_stale_examples": True,  # the code may have changed though the tutorial has not
    "download_all_examples": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "capture_repr": (),
    "image_scrapers": (pictures.vectors,),
    "reset_modules_order": "both",  # a tutorial's style is its own
    "matplotlib_animations": False,
    "nested_sections": False,
}
suppress_warnings = [
    "config.cache",  # the gallery's settings hold functions
    "ref.python",  # two modules may have a class of the same name
]

html_theme = "furo"
html_title = "tracker"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
