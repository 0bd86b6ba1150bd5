"""A table of vehicles: a CSV file with a column for each number that they differ in, and a line for each vehicle.

A title is the name of a number, ``body.m``, in SI, or with its unit in brackets: ``motor.P_max [kW]``.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.files.component_file import parse_quantity
from halfshaft.library.files.texts import read_text

if TYPE_CHECKING:
    from halfshaft.cosim.compiled import Array
    from halfshaft.models.vehicle import Vehicle

#: No file is larger [MB]; it holds some million vehicles that differ in five numbers.
LARGEST = 100
#: At most so many entries are told to be wrong.
NAMED = 5
_TITLE = re.compile(r"\s*(.*?)\s*(?:\[(.*)\]\s*)?")


def read_table(path: str | Path, vehicle: Vehicle) -> dict[str, Array]:
    """Return the numbers of many vehicles by name, in SI, each of shape ``(n_vehicles,)``.

    Raises
    ------
    InputError
        If the file is missing or no such table; everything that is wrong is named at once.

    """
    lines = [row for row in csv.reader(read_text(Path(path), LARGEST).splitlines()) if any(cell.strip() for cell in row)]
    known = vehicle.specs | {name: rated.spec for name, rated in vehicle.rated.items()}
    titles = [_TITLE.fullmatch(title) for title in lines[0]] if lines else []
    names = [match[1] if match else "" for match in titles]
    problems = [] if len(lines) > 1 else ["must have a line of titles and a line for each vehicle"]
    problems += [
        f"{name or 'a column without a title'} is no number of the vehicle{nearest(name, known)}" for name in names if name not in known
    ]
    problems += [f"{name} stands {names.count(name)} times" for name in dict.fromkeys(names) if names.count(name) > 1]
    uneven = [i for i, row in enumerate(lines[1:], 1) if len(row) != len(names)]
    problems += [f"vehicle {i} has {len(lines[i])} entries, there are {len(names)} titles" for i in uneven[:NAMED]]
    scales = []
    for name, match in zip(names, titles, strict=True):
        unit = match[2] if match else None
        try:
            # Units may have an offset, as degrees have.
            zero, one = ((0.0, 1.0) if unit is None or name not in known else
                         (parse_quantity(f"{x} {unit}", known[name].unit, name) for x in (0, 1)))  # fmt: skip
            scales.append((zero, one - zero))
        except InputError as error:
            problems += error.problems
    wrong = []
    table = np.full((len(lines[1:]), len(names)), np.nan)
    for i, row in enumerate(lines[1:] if not uneven else (), 1):
        for j, cell in enumerate(row):
            try:
                table[i - 1, j] = float(cell)
            except ValueError:
                wrong.append(f"vehicle {i}: {names[j]} = {cell.strip() or 'nothing'}, must be a number")
    problems += wrong[:NAMED] + ([f"and {len(wrong) - NAMED} more entries that are no numbers"] if len(wrong) > NAMED else [])
    if problems:
        raise InputError(str(path), problems)
    return {name: zero + scale * table[:, j] for j, (name, (zero, scale)) in enumerate(zip(names, scales, strict=True))}
