"""The serial backend: in this process, with one thread of linear algebra."""

import os

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from shes.backends.serial import SerialBackend
from shes.errors import ConfigError, WorkerError
from tests.backends.workers import Worker, start_refusing


class ThreadCounter(Worker):
    """Tells how many threads linear algebra has."""

    def threads(self, argument):
        np.ones((2, 2)) @ np.ones((2, 2))
        return max(pool["num_threads"] for pool in threadpool_info())


def test_the_work_is_done_in_this_process():
    with SerialBackend(Worker) as backend:
        assert list(backend.map([("where", 0)])) == [(os.getpid(), None)]
        assert backend.num_workers == 1


def test_linear_algebra_has_one_thread_during_the_work():
    with threadpool_limits(2), SerialBackend(ThreadCounter) as backend:
        assert list(backend.map([("threads",)])) == [1]
        assert max(pool["num_threads"] for pool in threadpool_info()) == 2


def test_a_worker_that_refuses_its_settings_is_not_started():
    with pytest.raises(ConfigError, match="sigma must be positive"):
        SerialBackend(start_refusing)


def test_a_worker_error_keeps_its_cause():
    with SerialBackend(Worker) as backend, pytest.raises(WorkerError) as raised:
        list(backend.map([("divide", 0)]))
    assert isinstance(raised.value.__cause__, ZeroDivisionError)
