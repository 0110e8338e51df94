"""Exceptions: one base class, and for each kind Python's own class as a second base."""

from __future__ import annotations

import errno
import os
import re

#: An option of the command line, unless it is part of a whole command.
_OPTION = re.compile(r"`rtecctl [^`]*`|--([a-z][a-z0-9]*(?:-[a-z0-9]+)*)")


def for_python(text: str) -> str:
    """A message of the libraries with Python's argument names, as ``tip_mm`` for ``--tip-mm``."""
    return _OPTION.sub(lambda m: m[0] if m[1] is None else m[1].replace("-", "_"), text)


class RtecError(Exception):
    """The base of all errors of this package: what cannot be done, and why."""


class InputError(RtecError, ValueError):
    """Bad input.

    Attributes
    ----------
    file : str
        The file, or the argument, that is wrong.
    line, column : int
        From 1; 0 if there is none.
    found, expected : str
        The faulty content, and the expected one.
    """

    file: str = ""
    line: int = 0
    column: int = 0
    found: str = ""
    expected: str = ""

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        missing = isinstance(self, MissingFileError)
        return input_error, (self.args[0], self.file, self.line, self.column, self.found, self.expected, missing)


class MissingFileError(InputError, FileNotFoundError):
    """A file that is not there."""

    # OSError's own would leave out the message of the libraries.
    __str__ = RtecError.__str__


class Bug(RtecError, RuntimeError):
    """A mistake of the program, not of its input: please report it."""


def input_error(text: str, file: str, line: int, column: int, found: str, expected: str, missing: bool) -> InputError:
    """The error for a finding of the libraries."""
    error = (MissingFileError if missing else InputError)(for_python(text))
    error.file, error.line, error.column = file, line, column
    error.found, error.expected = for_python(found), for_python(expected)
    if isinstance(error, MissingFileError):
        error.errno, error.strerror, error.filename = errno.ENOENT, os.strerror(errno.ENOENT), file
    return error


def names(argument: str, given: object) -> list[str]:
    """Several names; a single string is refused, because Python would read it as letters."""
    if isinstance(given, (str, bytes)):
        raise TypeError(f"{argument}: found the string {given!r}, expected a list of names, as [{given!r}]")
    found: list[str] = list(given)  # type: ignore[call-overload]
    for name in found:
        if not isinstance(name, str):
            raise TypeError(f"{argument}: found {name!r}, expected names")
    return found


def needs(module: str, extra: str) -> ModuleNotFoundError:
    """Raises an error that says what to install if an optional package is missing."""
    return ModuleNotFoundError(f"{module} is not installed; pip install 'rtec[{extra}]' brings it", name=module)
