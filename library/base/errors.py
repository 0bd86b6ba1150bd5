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
import re
from collections.abc import Iterable, Mapping
from typing import Any

#: Likeness from which a name may have been meant.
CLOSE = 0.6

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
    """Return ``, did you mean 'x'?`` for the known name nearest to `name`, or nothing.

    Behind a dot only what belongs to the same owner is near.  Letters count, those of a longer name's first word too, and
    where `known` says what its names mean (by `doc`), so do the words of the meaning: ``body.mass`` is ``body.m``.
    """
    # A name that is longer than any is not compared: the search takes time with the square of its length.
    if len(name) > 100:
        return ""
    names = list(known)
    owner, dot, own = name.rpartition(".")
    owners = {n.rpartition(".")[0] for n in names}
    if dot and owner not in owners:
        close = difflib.get_close_matches(owner, owners, n=1)
        owner = close[0] if close else ""
    meanings = {n: _words(_meaning(known[n])) for n in names} if isinstance(known, Mapping) else {}
    best, found = CLOSE, ""
    for n in names:
        theirs, _, leaf = n.rpartition(".")
        if owner and theirs != owner:
            continue
        # A first word that is right, or nearly, says less than a whole name.
        score = max(_likeness(own, leaf), 0.95 * _likeness(own, leaf.partition("_")[0]))
        if _words(own) & meanings.get(n, set()):
            score = max(score, 0.85)
        if score > best:
            best, found = score, n
    return f", did you mean '{found}'?" if found else ""


def _likeness(a: str, b: str) -> float:
    return difflib.SequenceMatcher(None, a.lower(), b.lower()).ratio()


def _words(text: str) -> set[str]:
    return {word for word in re.split(r"[\W_]+", text.lower()) if len(word) > 2}


def _meaning(value: Any) -> str:
    """Return what something declared means: an output or a number by its `doc`, a field by that of its declaration."""
    spec = getattr(value, "metadata", {}).get("spec", value)
    return str(getattr(spec, "doc", ""))


def number(given: Any) -> float:
    """Return what was given for a number as one; NaN, which no bound lets pass, where it is none."""
    try:
        return float(given)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def not_a(kind: type, **given: Any) -> list[str]:
    """Return what is wrong with arguments that must be of a kind that is loaded by name, such as a vehicle."""
    name = kind.__name__
    return [f"{k} must be a {name}, from {name}.load(...), not {type(v).__name__}" for k, v in given.items() if not isinstance(v, kind)]
