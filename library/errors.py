"""The errors of halfshaft.

::

    HalfshaftError
    |-- InputError          a file, a number or a name that the user gave
    |-- WiringError         parts that do not fit together
    |-- CompileError        the C compiler is missing or failed
    `-- SolveError          a forward-facing run that could not be continued

Each message says what is wrong, where, and what is allowed; where several things are wrong, it says all of them.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

#: A message about one thing is cut to so many characters.
LONGEST = 1000


class HalfshaftError(Exception):
    """Base of all errors that halfshaft raises on purpose."""


class InputError(HalfshaftError):
    """Something that the user gave is not usable; `problems` lists everything that is wrong."""

    def __init__(self, where: str, problems: Iterable[str]) -> None:
        self.where, self.problems = _printable(where), tuple(_printable(p) for p in problems)
        super().__init__("\n  ".join([f"{where}:", *self.problems]) if len(self.problems) > 1 else f"{where}: {self.problems[0]}")


class WiringError(HalfshaftError):
    """The parts of a model do not fit together; `problems` lists everything that is wrong."""

    def __init__(self, model: str, problems: Iterable[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n  ".join([f"model {model}:", *self.problems]))


class CompileError(HalfshaftError):
    """No C compiler, or it refused the generated code."""


class SolveError(HalfshaftError):
    """The integrator of the forward-facing model failed."""


def _printable(text: str) -> str:
    """Return a message with control characters written out: what a file holds must not steer the terminal."""
    shown = text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return shown if len(shown) <= LONGEST else f"{shown[: LONGEST - 4]} ..."


def nearest(name: str, known: Iterable[str]) -> str:
    """Return ``, did you mean 'x'?`` for the known name nearest to `name`, or nothing."""
    # A name that is longer than any is not compared: the search takes time with the square of its length.
    if len(name) > 100:
        return ""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f", did you mean '{close[0]}'?" if close else ""
