"""A sweep on a cluster: two workers on this machine."""

import time

import pytest

from halfshaft import Cycle, InputError, Vehicle
from halfshaft.studies import crew
from halfshaft.studies.sweep import sweep
from halfshaft.studies.task import Drive

distributed = pytest.importorskip("distributed")
CAR = Vehicle.load("small-car-electric")
OWN = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "scheduler_kwargs": {"dashboard": False}}
AXES = {"body.m": "1000..1600:6", "motor": "ac-75kw,ac-83kw"}


@pytest.fixture(scope="module")
def address():
    with distributed.LocalCluster(2, threads_per_worker=1, **OWN) as found:
        yield found.scheduler_address


def test_a_cluster_finds_what_this_process_finds(address, tmp_path):
    task = Drive(Cycle.load("nycc"))
    told = []
    found = sweep(CAR, AXES, task, scheduler=address, folder=tmp_path, progress=lambda done, total: told.append(done))
    assert found.equals(sweep(CAR, AXES, task, workers=1))
    assert told[-1] == 12
    assert sweep(CAR, AXES, task, folder=tmp_path).identical(found)


def test_a_cluster_that_is_not_there_is_said_soon(monkeypatch):
    assert crew.PATIENCE <= 5
    monkeypatch.setattr(crew, "PATIENCE", 0.5)
    begin = time.monotonic()
    with pytest.raises(InputError, match=r"cluster: none answers at tcp://127.0.0.1:1"):
        sweep(CAR, AXES, Drive(Cycle.load("nycc")), scheduler="tcp://127.0.0.1:1")
    assert time.monotonic() - begin < 5
    with pytest.raises(InputError, match="cluster: none answers at nonsense"):
        sweep(CAR, AXES, Drive(Cycle.load("nycc")), scheduler="nonsense://x")


def test_a_cluster_without_workers_is_refused():
    with (
        distributed.LocalCluster(n_workers=0, threads_per_worker=1, **OWN) as empty,
        pytest.raises(InputError, match="has no workers"),
    ):
        sweep(CAR, AXES, Drive(Cycle.load("nycc")), scheduler=empty.scheduler_address)


def test_workers_go_with_this_machine_only():
    with pytest.raises(InputError, match="workers on this machine or the scheduler of a cluster, not both"):
        sweep(CAR, AXES, Drive(Cycle.load("nycc")), scheduler="tcp://127.0.0.1:1", workers=2)
    with pytest.raises(InputError, match="workers = 0, must be a whole number from 1"):
        sweep(CAR, AXES, Drive(Cycle.load("nycc")), workers=0)
