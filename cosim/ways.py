"""The ways of running, by their names; the command line shows them without importing what runs."""

from __future__ import annotations

from typing import Literal, TypeAlias

Mode: TypeAlias = Literal["hybrid", "refined", "iteration"]
MODES: tuple[Mode, ...] = ("hybrid", "refined", "iteration")
Via: TypeAlias = Literal["step", "fmu2", "fmu3", "forward"]
