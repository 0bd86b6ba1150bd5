import json
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.plot import plot_run
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import run
from halfshaft.library.base.errors import InputError
from halfshaft.models.vehicle import Vehicle


@pytest.fixture(scope="module")
def result():
    return run(Vehicle.load("small-car-series"), Cycle.load("us06"))


@pytest.fixture(scope="module")
def saved(result, tmp_path_factory):
    return result.save(tmp_path_factory.mktemp("saved") / "run.nc")


def test_a_saved_run_comes_back_whole(result, tmp_path):
    path = result.save(tmp_path / "run.nc")
    again = Result.load(path)
    assert again.inputs == result.inputs
    assert again.outputs == result.outputs
    assert again.summary == result.summary
    assert again.account == result.account
    np.testing.assert_array_equal(again.history, result.history)
    np.testing.assert_array_equal(again.time, result.time)
    assert [p.name for p in tmp_path.iterdir()] == ["run.nc"]


def test_a_run_can_be_made_again_from_its_file(result, tmp_path):
    inputs = Result.load(result.save(tmp_path / "run.nc")).inputs
    again = run(Vehicle.load(inputs.vehicle).with_values(inputs.parameters), Cycle.load(inputs.cycle), dt=inputs.dt)
    np.testing.assert_array_equal(again.history, result.history)


def test_series_have_unit_and_meaning(result):
    speed = result.dataset["body.v"]
    assert speed.attrs["units"] == "m/s"
    assert speed.attrs["long_name"]
    assert speed.dims == ("time",)


def test_a_misspelt_output_is_told_the_nearest(result):
    with pytest.raises(InputError, match=r"no output is called motor.P_im, did you mean 'motor.P_in'\?"):
        result["motor.P_im"]


def full(*_, **__):
    raise OSError(28, "No space left on device")


def test_a_full_disk_leaves_the_old_file(result, tmp_path, monkeypatch):
    path = tmp_path / "run.nc"
    path.write_text("old")
    monkeypatch.setattr("os.replace", full)
    with pytest.raises(InputError, match=r"run\.nc: cannot be written: No space left on device"):
        result.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["run.nc"]
    assert path.read_text() == "old"


def test_a_missing_folder_is_an_input_error(result, tmp_path):
    with pytest.raises(InputError, match="there is no folder"):
        result.save(tmp_path / "nowhere" / "run.nc")


@pytest.mark.parametrize("content", [b"", b"no netCDF"])
def test_a_file_that_is_no_result_is_refused(content, tmp_path):
    path = tmp_path / "run.nc"
    path.write_bytes(content)
    with pytest.raises(InputError, match="is not a result of halfshaft"):
        Result.load(path)
    with pytest.raises(InputError, match="cannot be read: No such file"):
        Result.load(tmp_path / "missing.nc")


@pytest.mark.parametrize("key", ["inputs", "outputs", "energies", "highest", "last"])
@pytest.mark.parametrize("value", [None, 3, [], {}, "x"])
def test_a_result_with_a_changed_text_is_refused(saved, tmp_path, key, value):
    path = shutil.copy(saved, tmp_path / "run.nc")
    with h5py.File(path, "r+") as file:
        file.attrs["result"] = json.dumps({**json.loads(file.attrs["result"]), key: value})
    with pytest.raises(InputError, match="is not a result of halfshaft"):
        Result.load(path)


def test_doubts_about_cycle_and_vehicle_are_warnings_and_are_saved(result, tmp_path):
    cycle = Cycle.load("us06")
    noise = replace(cycle, speed=np.maximum(cycle.speed + 5 * (np.arange(len(cycle.speed)) % 2), 0))
    other = run(Vehicle.load("small-car-electric").with_parts({"motor": "pm-32kw"}), noise)
    assert any("made for 6.673" in text for text in other.warnings)
    assert any("asks for more than 6 m/s2 at" in text for text in other.warnings)
    assert Result.load(other.save(tmp_path / "run.nc")).warnings == other.warnings
    assert not any("m/s2" in text or "made for" in text for text in result.warnings)


@pytest.mark.parametrize("car", ["small-car-electric", "small-car-series", "small-car-conventional"])
@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_runs_are_drawn(car, suffix, tmp_path):
    path = tmp_path / f"run.{suffix}"
    plot_run(run(Vehicle.load(car), Cycle.load("udds")), path=path)
    start = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[suffix]
    assert path.read_bytes().startswith(start)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_drawing_leaves_the_users_settings_alone(result, tmp_path):
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    plot_run(result, path=tmp_path / "run.png")
    assert dict(mpl.rcParams) == before


def test_a_full_disk_leaves_no_half_drawing(result, tmp_path, monkeypatch):
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", full)
    with pytest.raises(InputError, match=r"run\.png: cannot be written: No space left on device"):
        plot_run(result, path=tmp_path / "run.png")
    assert list(tmp_path.iterdir()) == []


def test_a_run_without_history_cannot_be_drawn(tmp_path):
    summary = run(Vehicle.load("small-car-electric"), Cycle.load("us06"), history=False)
    with pytest.raises(InputError) as e:
        plot_run(summary, path=tmp_path / "run.bmp")
    assert e.value.problems == ("a plot is written as .png, .svg, .pdf, not as '.bmp'", "the run has no time series to draw")
