"""Vehicle powertrains: equation-based models that run backward, forward and as FMUs."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from halfshaft.cosim.cycle import Cycle, cycle_names
    from halfshaft.cosim.fmu import build_fmu
    from halfshaft.cosim.plot import plot_run
    from halfshaft.cosim.result import Result
    from halfshaft.cosim.simulate import run
    from halfshaft.library.base.errors import HalfshaftError, InputError
    from halfshaft.library.files.component_file import component_names
    from halfshaft.models.vehicle import Vehicle, vehicle_names
    from halfshaft.studies.acceleration import accelerate
    from halfshaft.studies.batch import run_batch
    from halfshaft.studies.calibration.calibrate import calibrate
    from halfshaft.studies.calibration.record import Record
    from halfshaft.studies.compare import compare
    from halfshaft.studies.optimal import optimal
    from halfshaft.studies.pictures import plot_sweep
    from halfshaft.studies.size import size
    from halfshaft.studies.sweep import sweep
    from halfshaft.studies.uncertainty import uncertainty

__all__ = [
    "Cycle",
    "HalfshaftError",
    "InputError",
    "Record",
    "Result",
    "Vehicle",
    "__version__",
    "accelerate",
    "build_fmu",
    "calibrate",
    "compare",
    "component_names",
    "cycle_names",
    "optimal",
    "plot_run",
    "plot_sweep",
    "run",
    "run_batch",
    "size",
    "sweep",
    "uncertainty",
    "vehicle_names",
]

# Imported when first asked for: `import halfshaft` stays fast, and modules below may import the version.
_HOMES = {
    "Cycle": "cosim.cycle",
    "HalfshaftError": "library.base.errors",
    "InputError": "library.base.errors",
    "Record": "studies.calibration.record",
    "Result": "cosim.result",
    "Vehicle": "models.vehicle",
    "accelerate": "studies.acceleration",
    "build_fmu": "cosim.fmu",
    "calibrate": "studies.calibration.calibrate",
    "compare": "studies.compare",
    "component_names": "library.files.component_file",
    "cycle_names": "cosim.cycle",
    "optimal": "studies.optimal",
    "plot_run": "cosim.plot",
    "plot_sweep": "studies.pictures",
    "run": "cosim.simulate",
    "run_batch": "studies.batch",
    "size": "studies.size",
    "sweep": "studies.sweep",
    "uncertainty": "studies.uncertainty",
    "vehicle_names": "models.vehicle",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value = version("halfshaft")
    elif name in _HOMES:
        value = getattr(import_module(f"halfshaft.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module 'halfshaft' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
