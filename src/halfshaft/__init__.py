"""Vehicle powertrains: required quantities from the road to the source, available ones back, from one set of equations."""

from importlib.metadata import version

__all__ = ["__version__"]

__version__ = version("halfshaft")
