"""Sphinx: the documents of this folder, built by `docker/run sphinx-build -W docs results/docs`."""

from pygments.lexers.special import TextLexer
from sphinx.highlighting import lexers

from bristle import __version__

project = "bristle"
author = "the bristle authors"
release = __version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
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
