"""The documentation site: `make site` builds it, without a network, with every warning an error.

The source is the whole checkout, not this folder: README and the pages beside it keep their links.
"""

from __future__ import annotations

from hil import __version__

project = "hil-4wis4wid"
author = copyright = "hil-4wis4wid maintainers"
version = release = __version__
extensions = ["myst_parser"]
root_doc = "docs/index"
include_patterns = [
    *("README.md", "CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md", "CHANGELOG.md"),
    *("docs/**", "examples/*.md", "examples/**/*.md", "firmware/**/*.md"),
]

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
default_role = "code"
highlight_language = "text"  # for a block that names no language: mostly output of a command

html_theme = "furo"
html_title = f"hil-4wis4wid {__version__}"
html_extra_path = ["site"]
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_js_files = ["copy.js"]
smartquotes = False  # they make one dash of the two before an option
html_copy_source = False
html_show_sphinx = False
