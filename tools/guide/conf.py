# The guide as a book: `sphinx-build -W -b html tools/guide target/guide/html` (Debian: python3-sphinx, python3-myst-parser, furo).
# The pages are plain Markdown and read well without it; `toctree` in the index pages is all that is Sphinx's own.

import re
from pathlib import Path

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
# Options are --long: no dashes for hyphens.
smartquotes = False
html_static_path = ["static"]
html_css_files = ["guide.css"]
html_copy_source = False
html_show_sphinx = False
# The same bytes from the same pages.
html_last_updated_fmt = None
nitpicky = True


def without_the_distribution(app, exception):
    # Debian's furo takes normalize.css from the machine that it was installed on: not there on a reader's, nor from a disk.
    sheet = Path(app.outdir, "_static", "styles", "furo.css")
    if exception is not None or not sheet.exists():
        return
    text = re.sub(r"@import[^;]*;", "", sheet.read_text())
    # And it leaves out the colours of a reader whose system is dark, but for the code's.
    dark = re.search(r'body\[data-theme="?dark"?\]\s*\{([^}]*)\}', text)
    if dark and "prefers-color-scheme" not in text:
        text += f"\n@media screen and (prefers-color-scheme:dark){{body[data-theme=auto]{{{dark[1]}}}}}\n"
    sheet.write_text(text)


def setup(app):
    app.connect("build-finished", without_the_distribution)
    # Languages of blocks that Pygments does not know: shown as they are.
    for language in ["csv", "hal", "vcd"]:
        app.add_lexer(language, TextLexer)
