"""For all tests."""

import os
from functools import cache

from typer import testing

# Building takes half the time so, and what is built has the same bits.
os.environ.setdefault("HALFSHAFT_CFLAGS", "-O1")
# All commands are made anew for each call, which takes longer than most of them.
testing._get_command = cache(testing._get_command)
