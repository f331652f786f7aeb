"""The ray backend: workers on every node of a Ray cluster. Lost ones are replaced, and nodes that join are used.

A worker is an actor that needs one CPU. An answer is a call of the actor, which returns the worker's next request. The
state travels through Ray's object store, once to every node.
"""

from __future__ import annotations

import logging
import os
import pickle
import socket
import sys
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic
from types import ModuleType
from typing import Any

from shes.backends.backend import WorkerFactory
from shes.backends.serving import Answer, ClosedError, ParentConnection, import_path, pickle_factory, serve
from shes.backends.supervision import CLOSE_S, REPORTED_S, RemoteWorker, SupervisingBackend
from shes.errors import ConfigError, import_extra
from shes.machine import num_cores

_ANSWER_S = 10.0  # wait for the head node of a cluster


class RayBackend(SupervisingBackend):
    """Workers on the nodes of a Ray cluster, one per CPU, and at most --workers.

    The environment variable RAY_ADDRESS names the cluster; `local` starts one on this machine. Without it, join the
    cluster that runs on this machine, or start one.
    """

    advice = f"Ray's logs on the node say more: see `ray logs`. {SupervisingBackend.advice}"

    def __init__(self, factory: WorkerFactory, num_workers: int) -> None:
        """Join or start the cluster, and start at most `num_workers` workers; raise ConfigError if that fails."""
        super().__init__(1)
        self._most = num_workers
        self._factory = pickle_factory(factory)
        self._ray = import_extra("ray", "--backend ray needs Ray", "Install it: pip install 'shes[ray]'.")
        self._has_joined = False
        self._stored: tuple[bytes, Any] | None = None  # the last state, and its reference in Ray's object store
        self.ready: SimpleQueue[RemoteWorker] = SimpleQueue()
        """Workers that have sent a request or are gone. Ray's threads fill it."""
        self._waits_since = monotonic()  # for a worker to start
        # Ray's head node would keep a record of every call, 3 kB each for the last 100,000.
        options = {"num_cpus": 1, "max_restarts": 0, "max_concurrency": 2, "enable_task_events": False}
        self._actor = self._ray.remote(**options)(_RayActor)
        self.start_workers()

    @classmethod
    def all_workers(cls) -> int:
        """Return no limit: the cluster decides, and may grow."""
        return sys.maxsize

    def close(self) -> None:
        """Close every worker, and leave the cluster if this object has joined or started it."""
        super().close()
        self._stored = None
        if self._has_joined:
            self._ray.shutdown()
            self._has_joined = False

    def store(self, state: bytes) -> Any:
        """Return a reference to the last state in Ray's object store, which every node fetches once."""
        if self._stored is None or self._stored[0] is not state:
            self._stored = state, self._ray.put(state)
        return self._stored[1]

    def start_workers(self) -> None:
        """Create a worker for every CPU of the cluster that has none. Ray starts it when the CPU is free."""
        if not self._ray.is_initialized():
            _join(self._ray)
            self._has_joined = True
        self.num_workers = self._num_cpus()
        while len(self.workers) < self.num_workers:
            actor = self._actor.options(scheduling_strategy="SPREAD").remote(self._factory, import_path())
            self.workers.append(_RayWorker(self, self._ray, actor))

    def _num_cpus(self) -> int:
        return max(1, min(self._most, int(self._ray.cluster_resources().get("CPU", 0))))

    def look_around(self) -> None:
        """Use the nodes that have joined the cluster. Tell of one that has no CPU for any worker."""
        if self._num_cpus() > self.num_workers:
            self.start_workers()
        if any(worker.is_started for worker in self.workers):
            self._waits_since = monotonic()
        elif monotonic() >= self._waits_since + REPORTED_S:
            self._waits_since = monotonic()
            self.on_event("no worker has started yet: every CPU of the Ray cluster is taken (see `ray status`)")

    def wait(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for requests; return the workers that have sent some, or are gone."""
        found: list[RemoteWorker] = []
        with suppress(Empty):
            found.append(self.ready.get(timeout=timeout_s))
            while True:
                found.append(self.ready.get_nowait())
        return found


class _RayWorker(RemoteWorker):
    def __init__(self, backend: RayBackend, ray: ModuleType, actor: Any) -> None:
        super().__init__("that has not started", is_started=False)
        self._backend, self._ray, self._actor = backend, ray, actor
        self._stop: Any = None
        self._call(None, None)

    def _call(self, *arguments: Any) -> None:
        self._request: Future[Any] = self._actor.next_request.remote(*arguments).future()
        self._request.add_done_callback(lambda _: self._backend.ready.put(self))

    def answer(self, message: tuple[Any, ...], state: bytes | None = None) -> None:
        stored = None if state is None else self._backend.store(state)
        self._call(pickle.dumps(message, pickle.HIGHEST_PROTOCOL), stored)

    def requests(self) -> Sequence[tuple[Any, ...]]:
        try:
            self.name, request = self._request.result()
        except self._ray.exceptions.RayError as error:
            raise EOFError(str(error).strip().partition("\n")[0].rstrip(".")) from error
        self.is_started = True
        return [pickle.loads(request)]

    def stop(self) -> None:
        if self.is_started:
            self._stop = self._actor.stop.remote()

    def has_stopped(self) -> bool:
        return self._stop is None or bool(self._ray.wait([self._stop], timeout=0)[0])

    def end(self) -> str:
        with suppress(Exception):  # Ray raises various errors for actors that are gone
            self._ray.kill(self._actor)
        return ""


class _RayActor(ParentConnection):
    """A worker's process: a thread does the tasks, for which this is the connection, while calls bring answers."""

    def __init__(self, factory: bytes, path: list[str]) -> None:
        sys.path += [entry for entry in path if entry not in sys.path]
        self._name = f"{os.getpid()} on {socket.gethostname()}"
        self._answers: SimpleQueue[Answer] = SimpleQueue()
        self._requests: SimpleQueue[bytes] = SimpleQueue()
        self._is_closed = False
        self._thread = Thread(target=serve, args=(self, factory), name="shes-worker", daemon=True)
        self._thread.start()

    def next_request(self, message: bytes | None, state: bytes | None) -> tuple[str, bytes]:
        """Bring the worker an answer, except at first; return its name and its next request."""
        if message is not None:
            self._answers.put((pickle.loads(message), state))
        return self._name, self._requests.get()

    def stop(self) -> None:
        self._is_closed = True
        self._answers.put(((), None))
        self._thread.join(CLOSE_S)

    def receive(self) -> Answer:
        answer = self._answers.get()
        self.check()
        return answer

    def tell(self, *request: Any) -> None:
        self._requests.put(pickle.dumps(request, pickle.HIGHEST_PROTOCOL))

    def check(self) -> None:
        if self._is_closed:
            raise ClosedError


def _join(ray: ModuleType) -> None:
    """Join the cluster that RAY_ADDRESS names, or that runs on this machine; start one if it is `local`, or none runs.

    A named cluster that does not answer is an error: a job for 600 cores must not run on one node.
    """
    asked = os.environ.get("RAY_ADDRESS")
    quiet = {"log_to_driver": False, "logging_level": logging.WARNING}
    try:
        if asked not in (None, "", "auto", "local"):  # Ray itself would ask for minutes
            host, port = asked.rsplit(":", 1)
            socket.create_connection((host, int(port)), timeout=_ANSWER_S).close()
        if asked != "local":
            ray.init(address=asked or "auto", **quiet)
            return
    except (OSError, ValueError, RuntimeError, ray.exceptions.RayError) as error:
        if asked:
            raise ConfigError(
                f"no Ray cluster answers at {asked!r}: {error}. Set the environment variable RAY_ADDRESS to HOST:PORT "
                "as `ray start --head` prints it, or to local for a cluster on this machine, or unset it. If the "
                "cluster asks for a token, set the environment variable RAY_AUTH_MODE=token."
            ) from error
    ray.init(address="local", num_cpus=num_cores(), include_dashboard=False, **quiet)
