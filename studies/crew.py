"""Who works a sweep out: processes on the cores of this machine, or a cluster that is there already."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from halfshaft.library.base.errors import InputError
from halfshaft.studies.job import Done, Row, work

#: A cluster that does not answer for so long is not there [s].
PATIENCE = 5.0


@dataclass(frozen=True)
class Crew:
    """Workers: how they are given work, how many there are, and what asks them to stop after the point that they are at."""

    executor: Executor
    call: Callable[..., Done]
    size: int
    stop: Callable[[], None]

    def submit(self, job: bytes, rows: Sequence[Row]) -> Future[Done]:
        """Hand out some rows."""
        return self.executor.submit(self.call, job, rows)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def processes(n: int) -> Iterator[Crew]:
    """Start processes on this machine."""
    # A fork of a process with threads, such as those of a cluster's client, may hang.
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    with ProcessPoolExecutor(n, mp_context=context, initializer=_begin, initargs=(stop,)) as executor:
        yield Crew(executor, _work, n, stop.set)


#: What asks the workers of this process to stop.
_stopped: list[Any] = []


def _begin(stop: Any) -> None:
    """Prepare a worker: an interrupt is for its parent to act on, and without a parent it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _stopped[:] = [stop]
    threading.Thread(target=_follow, daemon=True).start()


def _follow() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(job: bytes, rows: Sequence[Row]) -> Done:
    return work(job, rows, _stopped[0].is_set)


@contextmanager
def cluster(address: str) -> Iterator[Crew]:
    """Use the cluster at an address, such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    InputError
        If nothing answers there, or no worker is there.

    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise InputError("cluster", ["the package distributed is missing; 'pip install halfshaft[cluster]' brings it"]) from None
    logger = logging.getLogger("distributed")
    before = logger.level
    # What it has to say of a cluster that is not there is said below, once.
    logger.setLevel(logging.CRITICAL)
    try:
        try:
            client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError("cluster", [f"none answers at {address}: {str(error) or type(error).__name__}"]) from error
        with client:
            threads = sum(client.nthreads().values())
            if not threads:
                raise InputError("cluster", [f"the one at {address} has no workers"])
            yield Crew(client.get_executor(pure=False), work, threads, lambda: None)
    finally:
        logger.setLevel(before)
