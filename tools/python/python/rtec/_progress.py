"""Progress of a long call."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple


class Progress(NamedTuple):
    """The progress of a call."""

    #: Seconds since the call began.
    seconds: float
    #: Number of steps so far: candidates tested, fits solved, control periods simulated.
    steps: int


Hook = Callable[[Progress], object]

_hook: ContextVar[Hook | None] = ContextVar("rtec.progress", default=None)


@contextmanager
def progress(hook: Hook) -> Iterator[None]:
    """Calls a hook about twenty times a second while a call within the block works.

    An exception of the hook ends the call, as Ctrl-C does. A stop button can use this.

    Parameters
    ----------
    hook : callable
        Called with a :class:`Progress`.

    Returns
    -------
    context manager
        The hook is called within its block.
    """
    token = _hook.set(hook)
    try:
        yield
    finally:
        _hook.reset(token)


def tell(seconds: float, steps: int) -> None:
    """Called by the library while it works."""
    hook = _hook.get()
    if hook is not None:
        hook(Progress(seconds, steps))
