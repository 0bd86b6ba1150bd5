"""How much memory a run takes, and how much there is."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

from halfshaft.library.base.errors import InputError

#: Numbers that a step takes whether its outputs are kept or not: time, length, request, grade and key, and what making them takes.
PER_STEP = 8
#: Runs that take more than this are said to [bytes].
LARGE = 2**30


class MemoryWarning(UserWarning):
    """A run that takes much of the memory."""


def check_memory(n: float, n_outputs: int, history: bool) -> None:
    """Warn of a run of `n` steps that takes much memory.

    Raises
    ------
    InputError
        If it takes more than there is.

    """
    small = 8 * n * PER_STEP
    need = 8 * n * (PER_STEP + n_outputs) if history else small
    if need < LARGE:
        return
    cure = f"take a longer dt, or history=False, which keeps the sums only and takes {_size(small)}" if history else "take a longer dt"
    text = f"{n:.3g} steps" + (f" with {n_outputs} outputs each" if history else "") + f" take {_size(need)} of memory"
    there = available()
    if need > there:
        raise InputError("run", [f"{text}, there are {_size(there)}; {cure}"])
    warnings.warn(f"{text}; {cure}", MemoryWarning, stacklevel=4)


def available() -> float:
    """Return the memory that this program can still take [bytes]; infinite where the system does not tell."""
    found = [float("inf")]
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        found += [1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
        group = Path("/sys/fs/cgroup")
        found.append(float((group / "memory.max").read_text()) - float((group / "memory.current").read_text()))
    except (OSError, ValueError):
        # No such limit, or not Linux, where the memory of the machine must do.
        if len(found) == 1 and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
            found.append(float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    return max(min(found), 0.0)


def _size(n: float) -> str:
    return f"{n / 2**30:.1f} GiB" if n < 2**43 else f"{n / 2**40:.3g} TiB"
