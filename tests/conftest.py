"""For all tests."""

import os

# Building takes half the time so, and what is built has the same bits.
os.environ.setdefault("HALFSHAFT_CFLAGS", "-O1")
