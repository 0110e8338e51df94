"""Warnings, small tables and text files."""

from __future__ import annotations

import html as _html
import os
import tempfile
import warnings
from pathlib import Path

from rtec._errors import for_python


class InputWarning(UserWarning):
    """A fact about the input to know before the result is used."""


def say(said: list[str], depth: int = 3) -> tuple[str, ...]:
    """Passes messages on; warnings become Python's, at the caller's line."""
    for line in said:
        if line.startswith("warning: "):
            warnings.warn(for_python(line.removeprefix("warning: ")), InputWarning, stacklevel=depth)
    return tuple(said)


def table(title: str, head: list[str], rows: list[list[str]]) -> str:
    """A small table for a notebook."""

    def line(tag: str, cells: list[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{_html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line("td", row) for row in rows)
    return f"<table><caption>{_html.escape(title)}</caption>{line('th', head)}{body}</table>"


def whole(path: str | Path, text: str) -> None:
    """Writes a text file whole or not at all."""
    path = Path(path)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, encoding="utf-8", newline="", delete=False) as file:
        try:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        except BaseException:
            os.unlink(file.name)
            raise
    os.replace(file.name, path)
