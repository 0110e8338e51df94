# The guide as a book: `sphinx-build -W -b html tools/guide target/guide/html` (Debian: python3-sphinx, python3-myst-parser, furo).
# The pages are plain Markdown and read well without it; `toctree` in the index pages is all that is Sphinx's own.

from pygments.lexers.special import TextLexer

project = "RTEC"
author = "the RTEC project"
copyright = author
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
# A link to a heading of another page is checked, too.
myst_heading_anchors = 4
html_theme = "furo"
html_title = "RTEC guide"
# Read from a disk without a network: nothing of it may be elsewhere.
html_theme_options = {"navigation_with_keys": False}
html_copy_source = False
html_show_sphinx = False
# The same bytes from the same pages.
html_last_updated_fmt = None
nitpicky = True


def setup(app):
    # Languages of blocks that Pygments does not know: shown as they are.
    for language in ["csv", "hal", "vcd"]:
        app.add_lexer(language, TextLexer)
