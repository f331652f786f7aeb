"""Workers of a study: each keeps to one core, and those that replace lost ones to the same cores."""

import os
import signal

import psutil
import pytest

from shes.cores import core_numbers
from shes.studies.one_core_backend import OneCoreBackend
from tests.backends.workers import Worker


def cores_of(backend):
    return sorted(tuple(psutil.Process(pid).cpu_affinity()) for pid in backend.pids())


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be kept on a core here")
@pytest.mark.parametrize("per_core", [1, 2])
def test_workers_share_the_cores_evenly_also_after_a_loss(per_core, tmp_path):
    cores = core_numbers()
    count = per_core * len(cores)
    expected = sorted((core,) for core in cores for _ in range(per_core))
    with OneCoreBackend(Worker, count) as backend:
        backend.broadcast(1)
        assert list(backend.map([("add", 1)] * 4)) == [2] * 4
        assert cores_of(backend) == expected
        lost = backend.pids()[-1]
        os.kill(lost, signal.SIGKILL)
        assert len(list(backend.map([("meet", tmp_path, count)] * 4 * count))) == 4 * count  # all are there
        assert lost not in backend.pids()
        assert cores_of(backend) == expected
    assert core_numbers() == cores  # this process is as free as before
