"""The best that a hybrid can do on a cycle that is known, beside what its control does."""

from halfshaft.studies.optimal.optimum import Optimum, Way, optimal

__all__ = ["Optimum", "Way", "optimal"]
