"""Sphinx: the documents of this folder, built by `docker/run sphinx-build -W docs results/docs`."""

from pygments.lexers.special import TextLexer
from sphinx.highlighting import lexers

from bristle import __version__
from bristle.studies.inputs.fields import DROP_FLAGS, LIST_FLAGS
from bristle.studies.inputs.study_fields import LOOP_FLAGS, OWN_FLAGS

project = "bristle"
author = "the bristle authors"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_gallery.gen_gallery"]
myst_heading_anchors = 3
exclude_patterns = ["examples", "gallery"]
html_theme = "alabaster"
html_theme_options = {
    "description": "impact of a bristle, in one and three dimensions",
    "page_width": "1200px",
}
smartquotes = False  # they would make one dash of the two of an option
autodoc_member_order = "bysource"
autodoc_typehints = "description"
lexers["csv"] = TextLexer()  # which Pygments does not know

# The lessons of gallery/ are run, and their pages are made in lessons/.
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "lessons",
    "filename_pattern": r"/\d\d_\w+\.py$",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_signature": False,
    "backreferences_dir": None,
}

TABLES = {"drop": DROP_FLAGS, "lists": LIST_FLAGS, "scatter": OWN_FLAGS, "loop": LOOP_FLAGS}


def table(flags):
    """Flags as a table: how the command line and Python call them, default, meaning."""
    rows = ["| option | in Python | default | meaning |", "|---|---|---|---|"]
    for flag in flags:
        cells = (f"`{flag.option}`", f"`{flag.field}`", flag.default_text(), flag.help)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def fill(app, name, text):
    """Put tables where a page asks for them by a line as `@drop@`."""
    for key, flags in TABLES.items():
        text[0] = text[0].replace(f"@{key}@", table(flags))


def setup(app):
    app.connect("source-read", fill)
