"""Builds trips: cycles one after the other, with rests between them.

A trip is a cycle like any other; it can be saved, run, smoothed and joined again.  Where two cycles meet with another grade or
another key, the second one's begins a microsecond later; where nothing differs, they share the point.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, pairwise

import numpy as np

from halfshaft.cosim.cycle import Array, Cycle, Grades, cut
from halfshaft.library.base.errors import InputError, not_a, number
from halfshaft.library.files.texts import name_problem

#: Time [s] and way [m] from the end of one cycle to what is new at the start of the next.
JOINT = 1e-6
#: Speeds closer than this meet without a jump [m/s].
SAME_SPEED = 1e-9


def rest(duration: float | str, *, key_on: bool = True) -> Cycle:
    """Return a time at rest [s]: a pause with the key on, or a soak with the key off."""
    seconds = number(duration)
    if not 2 * JOINT < seconds < np.inf:
        raise InputError("rest", [f"duration = {duration} s, must be a number > 0 s"])
    key = None if key_on else np.zeros(2)
    return Cycle(name=f"{'pause' if key_on else 'soak'} {seconds:g} s", time=np.array([0.0, seconds]), speed=np.zeros(2), key_on=key)


def join(*cycles: Cycle, between: Cycle | None = None, name: str = "", title: str = "") -> Cycle:
    """Return cycles one after the other, as one.

    A cycle that says nothing of grade or key is flat, with the key on.  With a grade over distance in one of them the trip has one,
    which holds where the trace is met; a grade by time can stand beside it only where it is constant.

    Parameters
    ----------
    cycles
        What is joined; `rest` makes a pause or a soak.
    between
        What stands between each two of them, such as a rest.
    name, title
        Of the trip; without them, made of those of its cycles.

    Raises
    ------
    InputError
        If a cycle ends at another speed than the next one starts with, or their grades do not go together.

    """
    problems = [] if cycles else ["there is nothing to join"]
    if between is not None:
        cycles = tuple(part for c in cycles for part in (c, between))[:-1]
    problems += [text for cycle in cycles for text in not_a(Cycle, cycle=cycle)]
    if problems:
        raise InputError("trip", problems)
    for one, other in pairwise(cycles):
        if abs(one.speed[-1] - other.speed[0]) > SAME_SPEED:
            ends = f"{one.name} ends at {one.speed[-1] * 3.6:.3g} km/h and {other.name} starts at {other.speed[0] * 3.6:.3g} km/h"
            problems.append(f"{ends}; no vehicle jumps")
    over_distance = any(c.grade_by_distance is not None for c in cycles)
    if over_distance:
        mixed = dict.fromkeys(c.name for c in cycles if c.grade_by_distance is None and c.grade is not None and np.ptp(c.grade) > 0)
        problems += [f"{name} has a grade by time, another one has it over distance" for name in mixed]
    if problems:
        raise InputError("trip", problems)
    runs = [(c, len(list(same))) for c, same in groupby(cycles)]
    told = [f"{n} {c.name}" if n > 1 else c.name for c, n in runs]
    made = " + ".join(told)
    sources = dict.fromkeys(f"{c.name}: {c.source}" for c in cycles if c.source)
    notes = dict.fromkeys(note if len(cycles) == 1 else f"{c.name}: {note}" for c in cycles for note in c.notes)
    by_time = not over_distance and any(c.grade is not None for c in cycles)
    keyed = any(c.key_on is not None for c in cycles)
    rows = _chained(cycles, by_time=by_time, keyed=keyed)
    return Cycle(
        name=name or (made if not name_problem(made) else "trip"),
        title=title or ", ".join(told),
        source="; ".join(sources),
        time=rows[0],
        speed=rows[1],
        grade=rows[2] if by_time else None,
        key_on=rows[3] if keyed else None,
        grade_by_distance=_roads(cycles) if over_distance else None,
        notes=tuple(notes),
    )


def _chained(cycles: Sequence[Cycle], *, by_time: bool, keyed: bool) -> Array:
    """Return time, speed, grade and key of cycles one after the other."""
    joined: list[Array] = []
    for c in cycles:
        grade = c.grade if by_time and c.grade is not None else np.zeros(len(c.time))
        key = c.key_on if keyed and c.key_on is not None else np.ones(len(c.time))
        rows = np.vstack([c.time, c.speed, grade, key])
        if joined:
            before = joined[-1][:, -1]
            rows[0] += before[0] - c.time[0]
            rows[0, 0] += JOINT
            if np.array_equal(rows[2:, 0], before[2:]):
                rows = rows[:, 1:]
        joined.append(rows)
    return np.hstack(joined)


def _roads(cycles: Sequence[Cycle]) -> Grades:
    """Return the grades over distance of cycles one after the other."""
    places: list[Array] = []
    grades: list[Array] = []
    travelled = 0.0
    for c in cycles:
        length = c.statistics().distance
        if length <= 2 * JOINT:
            continue
        even = np.array([0.0]), np.array([0.0 if c.grade is None else c.grade[0]])
        known, there = c.grade_by_distance or even
        x, grade = cut(known, there, 0.0, length)
        x = x + travelled
        if grades and grade[0] == grades[-1][-1]:
            x, grade = x[1:], grade[1:]
        elif grades:
            x[0] += JOINT
        places.append(x)
        grades.append(grade)
        travelled += length
    return np.concatenate(places), np.concatenate(grades)
