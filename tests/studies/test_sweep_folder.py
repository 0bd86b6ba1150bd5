"""What a sweep keeps in its folder: it goes on after an interrupt or a kill, and no other sweep or process gets in."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest
import xarray as xr

from halfshaft import Cycle, HalfshaftError, InputError, Vehicle
from halfshaft.studies import crew, folder
from halfshaft.studies.folder import LOCK, MANIFEST, PARTS, WHOLE
from halfshaft.studies.identity import differences, plain
from halfshaft.studies.sweep import sweep
from halfshaft.studies.task import Drive, Found

CAR = Vehicle.load("small-car-electric")
AXES = {"body.m": "1000..1600:30", "body.c_d": "0.2..0.4:5"}
#: Small portions, written at once; in a process of its own, which can be killed.
SCRIPT = """
import sys
from halfshaft import Cycle, Vehicle
from halfshaft.studies import folder, sweep
from halfshaft.studies.task import Drive

folder.PERIOD = sweep.PORTION = 0.02
if __name__ == "__main__":
    print("begun", flush=True)
    car, axes = Vehicle.load("small-car-electric"), {"body.m": "1000..1600:30", "body.c_d": "0.2..0.4:5"}
    sweep.sweep(car, axes, Drive(Cycle.load("nycc")), folder=sys.argv[1], workers=int(sys.argv[2]))
"""


@dataclass(frozen=True)
class Weigh:
    """A task that costs nothing, and that is stopped at a mass."""

    stops_at: float = 0.0
    name: str = "weigh"

    def __call__(self, vehicle):
        if vehicle.mass == self.stops_at:
            raise KeyboardInterrupt
        return Found({"mass_kg": vehicle.mass, "never_s": None if vehicle.mass < 1500 else 1.0}, ("a note", "another"))


def begun(path, workers, tmp_path):
    """Start the sweep in a process of its own, and wait until it has written something."""
    script = tmp_path / "study.py"
    script.write_text(SCRIPT)
    process = subprocess.Popen([sys.executable, str(script), str(path), str(workers)], stderr=subprocess.PIPE, text=True)
    before = parts(path)
    while parts(path) <= before and process.poll() is None:
        time.sleep(0.01)
    return process


def parts(path):
    return len(list((path / PARTS).glob("*.nc")))


def refused(path, axes=None, tasks=None, **kwargs):
    with pytest.raises(InputError) as error:
        sweep(CAR, axes or AXES, tasks or Weigh(), folder=path, **kwargs)
    return list(error.value.problems)


def children(pid):
    return [int(x) for thread in Path(f"/proc/{pid}/task").glob("*/children") for x in thread.read_text().split()]


def runs(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_sweep_that_was_killed_or_interrupted_goes_on_and_ends_as_if_it_had_not_been(tmp_path):
    path = tmp_path / "study"
    cycle = Cycle.load("nycc")
    killed = begun(path, 2, tmp_path)
    while not (workers := children(killed.pid)) and killed.poll() is None:
        time.sleep(0.01)
    (problem,) = refused(path, tasks=Drive(cycle))
    assert problem == f"another process works in it (process {killed.pid} on {os.uname().nodename}); wait for it, or stop it"
    killed.kill()
    killed.communicate()
    interrupted = begun(path, 1, tmp_path)
    interrupted.send_signal(signal.SIGINT)
    interrupted.communicate()
    assert -signal.SIGINT == interrupted.returncode
    # The workers of the process that was killed have ended by themselves.
    assert workers
    end = time.monotonic() + 10
    while any(map(runs, workers)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(runs, workers))
    told = []
    found = sweep(CAR, AXES, Drive(cycle), folder=path, workers=1, progress=lambda done, total: told.append(done))
    assert 0 < told[0] < 150
    whole = sweep(CAR, AXES, Drive(cycle), workers=1)
    assert found.equals(whole)
    assert {name: x.attrs for name, x in found.variables.items()} == {name: x.attrs for name, x in whole.variables.items()}
    with xr.open_dataset(path / WHOLE, engine="h5netcdf") as saved:
        assert saved.equals(whole)


def test_an_interrupt_keeps_what_is_finished(tmp_path):
    axes = {"body.m": "1000..1600:7"}
    with pytest.raises(KeyboardInterrupt):
        sweep(CAR, axes, Weigh(stops_at=1300.0), folder=tmp_path, workers=1)
    content = json.loads((tmp_path / MANIFEST).read_text())
    content["sweep"]["tasks"] = {"weigh": plain(Weigh())}
    (tmp_path / MANIFEST).write_text(json.dumps(content))
    told = []
    found = sweep(CAR, axes, Weigh(), folder=tmp_path, progress=lambda done, total: told.append(done))
    assert told == [3, 4, 5, 6, 7]
    assert found.equals(sweep(CAR, axes, Weigh()))
    assert found.attrs["history"].startswith(content["origin"]["date"])


def test_a_finished_sweep_is_read_and_not_worked_out_again(tmp_path):
    first = sweep(CAR, {"body.m": "1000..1600:4"}, Weigh(), folder=tmp_path)
    told = []
    again = sweep(CAR, {"body.m": "1000..1600:4"}, Weigh(), folder=tmp_path, progress=lambda *n: told.append(n))
    assert told == [(4, 4)]
    assert again.identical(first)
    only = sweep(CAR, {"body.m": "1000..1600:4"}, Weigh(), folder=tmp_path, responses=["mass_kg"])
    assert list(only.data_vars) == ["mass_kg", "failure", "notes"]


def test_a_folder_of_another_sweep_is_refused_and_says_what_differs(tmp_path):
    axes = {"body.m": "1000..1600:4"}
    sweep(CAR, axes, Weigh(), folder=tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.nc")}
    said = refused(tmp_path, {"body.m": "1000..1700:4"}, Weigh(5.0))
    assert said[0] == "is that of another sweep; name another folder"
    values = "axes: body.m: values is [1000.0, 1200.0, 1400.0, 1600.0] in the folder and"
    assert f"{values} [1000.0, 1233.33333333, 1466.66666667, 1700.0] now" in said
    assert "tasks: weigh: stops_at is 0.0 in the folder and 5.0 now" in said
    assert refused(tmp_path, {"body.m": "1000..1600"}, sample="lhs:4")[1:] == [
        "axes: body.m: values is [1000.0, 1200.0, 1400.0, 1600.0] in the folder and [1000.0, 1600.0] now",
        "axes: body.m: open is false in the folder and true now",
        'sample is null in the folder and {"is": "Sample", "kind": "lhs", "n": 4, "seed": 0} now',
    ]
    with pytest.raises(InputError, match=r"values: body.c_d is 0.335 in the folder and 0.4 now"):
        sweep(CAR.with_values({"body.c_d": 0.4}), axes, Weigh(), folder=tmp_path)
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*.nc")}


def test_a_part_of_other_content_under_the_same_name_is_another_sweep(tmp_path):
    path = CAR.parts["motor"].save(tmp_path / "own.toml")
    axes = {"motor": [str(path), "ac-83kw"]}
    sweep(CAR, axes, Weigh(), folder=tmp_path / "study")
    path.write_text(path.read_text().replace("Westinghouse", "Other"))
    assert any("axes: motor: parts" in problem for problem in refused(tmp_path / "study", axes))


def test_a_folder_that_is_none_of_a_sweep_is_refused_and_left_as_it_is(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    assert refused(tmp_path) == ["is not that of a sweep, it has notes.txt; name a new or an empty one"]
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
    assert "cannot be used" in refused(tmp_path / "notes.txt")[0]


@pytest.mark.parametrize(
    ("content", "said"), [("{", "is not that of a sweep"), ("[]", "is not that of a sweep"), ('{"format": 9, "sweep": {}}', "format 9")]
)
def test_a_manifest_that_cannot_be_read_is_refused(tmp_path, content, said):
    (tmp_path / MANIFEST).write_text(content)
    assert said in refused(tmp_path)[0]


def test_a_damaged_part_is_worked_out_again(tmp_path):
    first = sweep(CAR, {"body.m": "1000..1600:4"}, Weigh(), folder=tmp_path)
    (part,) = (tmp_path / PARTS).glob("*.nc")
    part.write_bytes(part.read_bytes()[:1000])
    with pytest.warns(UserWarning, match="worked out again"):
        assert sweep(CAR, {"body.m": "1000..1600:4"}, Weigh(), folder=tmp_path).identical(first)


def test_what_a_killed_process_was_writing_is_cleared_away(tmp_path):
    sweep(CAR, {"body.m": "1000..1600:4"}, Weigh(), folder=tmp_path)
    for place in (tmp_path, tmp_path / PARTS):
        (place / ".part-x").mkdir()
        (place / ".part-x" / "half.nc").write_text("")
    sweep(CAR, {"body.m": "1000..1600:4"}, Weigh(), folder=tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [LOCK, PARTS, MANIFEST, WHOLE]
    assert not list((tmp_path / PARTS).glob(".part-*"))


def test_parts_are_written_now_and_then_and_seldomer_the_longer_it_takes(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(folder.time, "monotonic", lambda: now[0])
    written = []
    keeper = folder.Kept({}, tmp_path)
    monkeypatch.setattr(keeper, "write", lambda: (written.append(now[0]), setattr(keeper, "_written", now[0])))
    for second in range(1, 401):
        now[0] = float(second)
        keeper.add({second: None})
    assert written[:5] == [2, 4, 6, 8, 10]
    assert all(b - a >= 0.05 * b for a, b in pairwise(written))


def test_options_of_a_task_are_told_apart_by_what_they_hold():
    cycle = Cycle.load("nycc")
    assert plain(Drive(cycle)) == plain(Drive(Cycle.load("nycc")))
    changed = Cycle(name="nycc", title=cycle.title, source=cycle.source, time=cycle.time, speed=cycle.speed * 1.01)
    (difference,) = differences(plain(Drive(cycle)), plain(Drive(changed)))
    assert difference.startswith("cycle: speed is")
    assert differences(plain(Drive(cycle)), plain(Drive(cycle, dt=0.5))) == ["dt is 1.0 in the folder and 0.5 now"]
    assert plain({"a": (Path("x"), {2.0}, None)}) == {"a": ["x", ["2.0"], None]}
    with pytest.raises(InputError, match="is no option of a task"):
        plain(len)


def test_a_worker_that_is_lost_is_said(tmp_path):
    with crew.processes(1) as one:
        broken = one.executor.submit(os._exit, 3)
        with pytest.raises(Exception, match="terminated abruptly"):
            broken.result()
        from halfshaft.studies import sweep as module

        job = module._planned(CAR, AXES, Weigh(), None, 0, None, None)[0]
        with pytest.raises(HalfshaftError, match="a process was lost"):
            module._share_out(job, module.deque([(0, (1000.0, 0.3))]), one, lambda found: None)
