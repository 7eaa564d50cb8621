"""The site of the documentation, by Sphinx: ``make docs`` writes build/docs/index.html, with no network."""

import compasslib

project = "compasslib"
author = "The compasslib authors"
version = release = compasslib.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
root_doc = "index"
exclude_patterns = ["proof/*/figures"]

myst_heading_anchors = 4
autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_type_aliases = {name: name for name in ("Bools", "Complexes", "Floats")}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90

html_theme = "furo"
html_title = f"compasslib {version}"
html_show_copyright = False
html_static_path = ["_static"]
html_css_files = ["wide.css"]
html_copy_source = False  # nor a date: the same pages for the same sources
