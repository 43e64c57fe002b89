"""Sphinx configuration of the documentation; `make docs` builds it with warnings as errors."""

import os
import shutil
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE / "_ext"), str(ROOT)]
# Notebooks are executed in processes of their own, which find this checkout and the environment's commands.
os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])

from names import functions, kinds  # noqa: E402
from sphinx.ext import autosummary  # noqa: E402

project = "cablejax"
author = "the cablejax authors"
release = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
language = "en"
html_title = f"cablejax {release}"

# Where the first sentence of a docstring does not end.
autosummary.WELL_KNOWN_ABBREVIATIONS = (*autosummary.WELL_KNOWN_ABBREVIATIONS, "eq.", "eqs.", "Eq.", "Eqs.")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "mathml",
    "public",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "_templates", "**/.ipynb_checkpoints"]

# Markdown
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

# Tutorials run at build and are kept in a cache until their text changes; the notebooks of results are committed with output.
shutil.copytree(ROOT / "notebooks", HERE / "notebooks", dirs_exist_ok=True, ignore=shutil.ignore_patterns(".*"))
nb_execution_mode = "cache"
nb_execution_excludepatterns = ["notebooks/*"]
nb_execution_cache_path = str(HERE / "_build" / "jupyter-cache")
nb_execution_timeout = 900  # s a cell; they take seconds, and minutes where a machine is busy
nb_execution_raise_on_error = True
nb_merge_streams = True
suppress_warnings = ["mystnb.unknown_mime_type"]  # plotly's own form of figures that are there as images too

# Reference, from docstrings and `__all__`
autosummary_generate = True
autosummary_ignore_module_all = False
autosummary_imported_members = True
autosummary_context = {"kinds": kinds(), "public_functions": functions()}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_attr_annotations = False  # docstrings give shapes and units
default_role = "literal"  # docstrings write code in single backticks
add_module_names = False
python_maximum_signature_line_length = 90
python_use_unqualified_type_names = True
toc_object_entries = False

# References must lead somewhere; what is documented elsewhere (no network at build) is named here.
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", r"(?!cablejax).*"),
    # inside of a search tree, and of a search
    (r"py:class", r"cablejax\.ops\.neighbors\.(tree\.Tree|request\.Points)"),
    (r"py:class", r"cablejax\.simulate\.centrelines\.Foot"),  # what the simulator looks up on a centre line
    (r"py:class", r"cablejax\.report\..*\.(Cables|Measured)"),  # protocols that results of cablejax.measure meet
    (r"py:class", r"cablejax\.train\.step\.TrainState"),  # what the training loop keeps
]

html_math_renderer = "mathml"
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["cablejax.css"]
html_show_copyright = False
html_copy_source = False
html_show_sourcelink = False
html_scaled_image_link = True
