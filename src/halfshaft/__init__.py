"""Vehicle powertrains: equation-based models that run backward, forward and as FMUs."""

from importlib.metadata import version

__version__ = version("halfshaft")
