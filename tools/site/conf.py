"""Settings of Sphinx for `tools/docs`; its sources are the pages of the repository, where they stand."""

project = "friction_hil"
author = "friction_hil contributors"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "tools/site/index"
include_patterns = [
    *("README.md", "CHANGELOG.md", "friction_hil/**.md", "drivers/**.md", "tests/**.md", "tools/**.md"),
    "out/generated/*.md",
]
exclude_patterns = [".venv/**", "out/site/**"]
source_suffix = {".md": "markdown"}
html_theme = "furo"
html_title = "friction_hil"
html_copy_source = False
myst_heading_anchors = 4
myst_links_external_new_tab = False
autodoc_typehints = "none"  # the signatures have them, and the docstrings what they mean
autodoc_member_order = "bysource"
# a name that two classes have as an attribute has no link
suppress_warnings = ["misc.highlighting_failure", "ref.python"]
