"""The smallest whole number that will do: two ways to find it with few trials.

What is sought is given by its margin, which is at least 0 where a number will do and in general grows with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from scipy.optimize import brentq

#: First step of a search away from where it starts, and the largest; each is this power of the one before.
FIRST, MOST, GROWTH = 1.05, 1.6, 1.5
#: Most halvings.
HALVINGS = 10


class Least(NamedTuple):
    """What was found, and whether it will do; if nothing does it is the one with the largest margin."""

    k: int
    does: bool


def by_root(margin: Callable[[int], float], low: int, high: int, start: int, slack: float = 0.0) -> Least:
    """Return the smallest number between two that will do.

    From the start it goes up or down in growing steps until the margin changes its sign, then on by Brent's method.  One less than what
    is returned does not do; where the margin does not grow throughout, that may hold for others too.
    """
    ratio, k = FIRST, min(max(start, low), high)
    tried = [k]
    if margin(k) >= 0:
        good, bad = k, low - 1
        while good > low:
            k = max(math.floor(good / ratio), low)
            if margin(k) < 0:
                bad = k
                break
            good, ratio = k, min(ratio**GROWTH, MOST)
        if good == low:
            return Least(low, True)
    else:
        while margin(k) < 0:
            if k == high:
                return Least(max([*tried, low], key=lambda k: (margin(k), -k)), False)
            bad, k, ratio = k, min(math.ceil(k * ratio), high), min(ratio**GROWTH, MOST)
            tried.append(k)
        good = k
    # Brent's method takes a margin of 0 for a root; the next number down may have it too.
    k = round(brentq(lambda x: margin(round(x)), bad, good, xtol=0.5, rtol=1e-9)) if good - bad > 1 else good
    while margin(k) < 0:
        k += 1
    while k - 1 > bad and margin(k - 1) >= 0:
        k -= 1
    return Least(k, True)


def by_halving(margin: Callable[[int], float], low: int, high: int, start: int = 0, slack: float = 0.0) -> Least:
    """Return a number between two that will do, as the original does: both ends are tried, then the middle, at most ten times.

    It ends where the margin is within the slack of nothing; else at the last number that did.
    """
    if margin(low) >= 0:
        return Least(low, True)
    if margin(high) < 0:
        return Least(high, False)
    for _ in range(HALVINGS):
        if high - low <= 1:
            break
        middle = (low + high) // 2
        reached = margin(middle)
        low, high = (low, middle) if reached >= 0 else (middle, high)
        if 0 <= reached <= slack:
            break
    return Least(high, True)
