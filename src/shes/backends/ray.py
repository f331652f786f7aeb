"""The ray backend: workers on every node of a Ray cluster. Lost ones are replaced, and nodes that join are used.

A worker is an actor that needs one CPU. Its messages (`shes.backends.serving`) are calls of the actor: `send` brings
one to the worker, and `receive` waits for those of the worker and returns them. The state travels through Ray's object
store, once to every node.
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
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic
from types import ModuleType
from typing import Annotated, Any, ClassVar

from shes.backends.backend import WorkerFactory
from shes.backends.factory import import_path, pickle_factory
from shes.backends.job import State
from shes.backends.pull import PullBackend, SilenceSettings
from shes.backends.remote_worker import RemoteWorker
from shes.backends.serving import serve, use_one_thread
from shes.cores import num_cores
from shes.errors import ConfigError, MissingExtraError
from shes.settings import Example, Execution, Settings

_ANSWER_S = 10.0  # wait for the head node of a cluster
_LOOK_S = 1.0  # between two looks for nodes that have joined


@dataclass(frozen=True, kw_only=True)
class RaySettings(SilenceSettings):
    """The cluster, and limits for workers that give no answer."""

    ray_address: Annotated[str, Execution(), Example("head-node:6379")] | None = None
    """Address of the Ray cluster; `local` starts one on this machine. If None, join the cluster named by RAY_ADDRESS
    or running on this machine; if there is none, start one."""


class RayBackend(PullBackend):
    """Workers on the nodes of a Ray cluster, one per CPU, and at most --workers."""

    Options: ClassVar[type[Settings]] = RaySettings

    def __init__(
        self,
        factory: WorkerFactory,
        num_workers: int,
        *,
        worker_warning_s: float | None = None,
        worker_timeout_s: float | None = None,
        ray_address: str | None = None,
    ) -> None:
        """Join or start the cluster, and start at most `num_workers` workers.

        Raises:
            MissingExtraError: Ray is not installed.
            ConfigError: There is no cluster at `ray_address`, or `factory` cannot be pickled.
        """
        super().__init__(1, worker_warning_s, worker_timeout_s)
        self._most, self._address = num_workers, ray_address
        self._factory = State(pickle_factory(factory))
        self._ray = _import_ray()
        self._has_joined = False
        # Ray's head node would keep a record of every call, 3 kB each for the last 100,000.
        options = {"num_cpus": 1, "max_restarts": 0, "concurrency_groups": {"out": 1}, "enable_task_events": False}
        self._actor = self._ray.remote(**options)(RayActor)
        self._events: SimpleQueue[_RayWorker] = SimpleQueue()
        self._looked_at = 0.0
        self._waits_since: float | None = None
        self.start_workers()

    @staticmethod
    def check_installed() -> None:
        """Check that Ray is installed; see the base class."""
        _import_ray()

    @classmethod
    def all_workers(cls) -> int:
        """Return no limit: the cluster decides, and may grow."""
        return sys.maxsize

    def close(self) -> None:
        """End every worker, and leave the cluster if this object has joined or started it."""
        workers, self.workers = self.workers, []
        for worker in workers:
            worker.end()
        if self._has_joined:
            self._ray.shutdown()
            self._has_joined = False
            for state in filter(None, (self._factory, self._state)):
                state.stored = None

    def send_state(self, worker: RemoteWorker, state: State) -> None:
        """Send a reference to `state`, which every node fetches once."""
        worker.note_state(state)
        worker.send("state", state.number, self._put(state))

    def _put(self, state: State) -> Any:
        """Return the reference to the factory or a state in Ray's object store."""
        if state.stored is None:
            state.stored = self._ray.put(state.pickled)
        return state.stored

    def _join(self) -> None:
        """Join or start the cluster, unless this process is in one already."""
        if not self._ray.is_initialized():
            _join(self._ray, self._address)
            self._has_joined = True

    def start_workers(self) -> None:
        """Create a worker for every CPU of the cluster that has none. Ray starts it when the CPU is free."""
        self._join()
        self._looked_at = monotonic()
        self.num_workers = max(1, min(self._most, int(self._ray.cluster_resources().get("CPU", 0))))
        # Those that wait for a CPU of a node that was lost would never start.
        surplus = max(0, len(self.workers) - self.num_workers)
        for worker in [each for each in self.workers if not each.is_started][:surplus]:
            self.workers.remove(worker)
            worker.is_ended = True
            worker.end()
        while len(self.workers) < self.num_workers:
            actor = self._actor.options(scheduling_strategy="SPREAD").remote(self._put(self._factory), import_path())
            self.workers.append(_RayWorker(self._ray, actor, self._events))

    def look_around(self) -> None:
        """Now and then, use the nodes that have joined the cluster. Tell of one that has no CPU for any worker."""
        if monotonic() >= self._looked_at + _LOOK_S and not self.pauses:
            self.start_workers()
        if any(worker.is_started for worker in self.workers):
            self._waits_since = None
        elif self._waits_since is None:
            self._waits_since = monotonic()
        elif self.worker_warning_s is not None and monotonic() >= self._waits_since + self.worker_warning_s:
            self._waits_since = monotonic()
            self.tell("no worker has started yet: every CPU of the Ray cluster is taken (see `ray status`)")

    def ready_workers(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for the calls that fetch messages; return the workers whose calls have ended."""
        found: list[_RayWorker] = []
        with suppress(Empty):
            found.append(self._events.get(timeout=timeout_s))
            while True:
                found.append(self._events.get_nowait())
        return [worker for worker in found if worker in self.workers]

    def advice(self, worker: RemoteWorker) -> str:
        """Return where the reason is to be found."""
        return "Ray's logs on the node say more: see `ray logs`. --backend serial does the same work in this process."


class RayActor:
    """The process of a worker. A thread does the work, while calls bring and fetch messages."""

    def __init__(self, factory: bytes, path: list[str]) -> None:
        """Make the worker by the pickled `factory`, whose modules are found on this import `path`."""
        use_one_thread()
        sys.path += [entry for entry in path if entry not in sys.path]
        self._incoming: SimpleQueue[tuple[Any, ...]] = SimpleQueue()
        self._outgoing: SimpleQueue[bytes] = SimpleQueue()
        connection = _Queues(self._incoming, self._outgoing)
        connection.send(("started", os.getpid(), socket.gethostname()))
        Thread(target=serve, args=(connection, factory), name="shes-worker", daemon=True).start()

    def send(self, *message: Any) -> None:
        """Bring a message to the worker. Ray replaces references in it by their objects."""
        self._incoming.put(message)

    def receive(self) -> list[bytes]:
        """Wait for messages of the worker and return them, pickled."""
        messages = [self._outgoing.get()]
        with suppress(Empty):
            while True:
                messages.append(self._outgoing.get_nowait())
        return messages


class _Queues:
    """The connection of an actor's worker to its parent."""

    def __init__(self, incoming: SimpleQueue[tuple[Any, ...]], outgoing: SimpleQueue[bytes]) -> None:
        self.recv = incoming.get
        self._outgoing = outgoing

    def send(self, message: tuple[Any, ...]) -> None:
        self._outgoing.put(pickle.dumps(message, pickle.HIGHEST_PROTOCOL))


class _RayWorker(RemoteWorker):
    """An actor as its parent sees it."""

    def __init__(self, ray: ModuleType, actor: Any, events: SimpleQueue[_RayWorker]) -> None:
        super().__init__()
        self.is_started = False
        self._ray, self._actor, self._events = ray, actor, events
        self._name = "that has not started"
        self._error: BaseException | None = None
        self._answer: Future[list[bytes]] | None = None
        self._listen()

    @property
    def name(self) -> str:
        return self._name

    @property
    def ending(self) -> str:
        return str(self._error).strip().partition("\n")[0].rstrip(".")

    def send(self, *message: Any) -> None:
        self._actor.send.remote(*message)

    def _listen(self) -> None:
        """Ask the actor for its next messages."""
        answer = self._actor.receive.options(concurrency_group="out").remote().future()
        self._answer = answer
        answer.add_done_callback(self._note)

    def _note(self, _: Future[list[bytes]]) -> None:
        self._events.put(self)

    def receive(self) -> Sequence[tuple[Any, ...]]:
        assert self._answer is not None
        try:
            messages = [pickle.loads(message) for message in self._answer.result()]
        except self._ray.exceptions.RayError as error:
            self._error = error
            raise EOFError from error
        self._listen()
        for kind, *content in messages:
            if kind == "started":
                self.is_started = True
                self._name = "{} on {}".format(*content)
        return messages

    def end(self) -> None:
        with suppress(Exception):  # Ray raises various errors for actors that are gone
            self._ray.kill(self._actor)


def _import_ray() -> ModuleType:
    """Return the package `ray`; raise MissingExtraError if it is not installed."""
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError(f"--backend ray needs Ray ({error}). Install it: pip install 'shes[ray]'.") from error
    return ray


def _join(ray: ModuleType, address: str | None) -> None:
    """Join the cluster at `address`; start one on this machine if that is `local`, or None and there is none.

    Raises:
        ConfigError: There is no such cluster.
    """
    # Asked for either way, a cluster that does not answer is an error: a job for 600 cores must not run on one node.
    asked = address or os.environ.get("RAY_ADDRESS") or "auto"
    if asked not in ("auto", "local"):
        _check_answer(asked, is_variable=address is None)
    quiet = {"log_to_driver": False, "logging_level": logging.WARNING}
    try:
        if asked != "local":
            ray.init(address=asked, **quiet)
            return
    except (ConnectionError, ValueError, RuntimeError, ray.exceptions.RayError) as error:
        if asked != "auto" or address is not None:
            raise _no_cluster(asked, error, is_variable=address is None) from error
    ray.init(address="local", num_cpus=num_cores(), include_dashboard=False, **quiet)


def _check_answer(address: str, *, is_variable: bool) -> None:
    """Raise ConfigError unless something answers at `address`: Ray itself would ask for minutes."""
    try:
        host, port = address.rsplit(":", 1)
        socket.create_connection((host, int(port)), timeout=_ANSWER_S).close()
    except (OSError, ValueError) as error:
        raise _no_cluster(address, error, is_variable=is_variable) from error


def _no_cluster(address: str, error: Exception, *, is_variable: bool) -> ConfigError:
    fix = (
        "Set the environment variable RAY_ADDRESS to HOST:PORT as `ray start --head` prints it, or unset it."
        if is_variable
        else "Set --ray-address to HOST:PORT as `ray start --head` prints it, to local for a cluster on this machine, "
        "or omit it."
    )
    return ConfigError(
        f"no Ray cluster answers at {address!r}: {error}. {fix} If the cluster asks for a token, set the environment "
        "variable RAY_AUTH_MODE=token."
    )
