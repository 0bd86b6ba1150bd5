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
import math
from collections.abc import Iterable
from typing import Any


class HalfshaftError(Exception):
    """Base of all errors that halfshaft raises on purpose."""


class InputError(HalfshaftError):
    """Something that the user gave is not usable; `problems` lists everything that is wrong."""

    def __init__(self, where: str, problems: Iterable[str]) -> None:
        self.where, self.problems = where, tuple(problems)
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


def nearest(name: str, known: Iterable[str]) -> str:
    """Return ``, did you mean 'x'?`` for the known name nearest to `name`, or nothing."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f", did you mean '{close[0]}'?" if close else ""


def number(given: Any) -> float:
    """Return what was given for a number as one; NaN, which no bound lets pass, where it is none."""
    try:
        return float(given)
    except (TypeError, ValueError, OverflowError):
        return math.nan
