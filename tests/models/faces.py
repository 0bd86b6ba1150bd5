"""Runs the faces of one component by hand."""

from halfshaft.library.base.component import arguments


def in_turn(part, *faces, **known):
    """Return all that is known after faces have run one after the other, each fed with what it takes of what is known."""
    for face in (getattr(part, name) for name in faces):
        known |= face(**{n: known[n] for n in arguments(face)[0] if n in known})
    return known
