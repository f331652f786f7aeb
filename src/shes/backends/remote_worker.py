"""A worker in another process, as its parent sees it; `shes.backends.pull` talks to it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from shes.backends.job import Job, State
from shes.backends.serving import NUM_STATES


class RemoteWorker(ABC):
    """A worker in another process as its parent sees it, and the tasks it is working on."""

    def __init__(self) -> None:
        """Begin without work."""
        self.is_started = True
        """Whether a process for it exists; if not, it waits for a core of the cluster."""
        self.is_ended = False
        """Whether it has left the backend's workers."""
        self.is_ready = False
        """Whether it has said that it is ready."""
        self.job: Job | None = None
        """The job that it works on."""
        self.numbers: dict[int, None] = {}
        """Numbers of the job's parts at work, in the order they were given."""
        self.is_expected = False
        """Whether it has been told of the job and has not yet asked for tasks."""
        self.states: tuple[State, ...] = ()
        """The states that it has: the last `NUM_STATES` that were sent to it."""
        self.heard_s = 0.0
        """Time of its last message, on the clock of the backend."""
        self.is_told = False
        """Whether the user has been told of the silence."""

    def note_state(self, state: State) -> None:
        """Note that a state has been sent to it."""
        self.states = (*self.states, state)[-NUM_STATES:]

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the worker in messages."""

    @property
    @abstractmethod
    def ending(self) -> str:
        """How the worker ended, in short."""

    @property
    def cause(self) -> str:
        """How the worker ended, at length."""
        return self.ending

    @abstractmethod
    def send(self, *message: Any) -> None:
        """Send a message soon. If the worker is gone, the next read notices it."""

    @abstractmethod
    def receive(self) -> Sequence[tuple[Any, ...]]:
        """Return the messages that have arrived.

        Raises:
            EOFError: The worker is gone. So does OSError.
            BlockingIOError: The worker has stopped in the middle of a message.
        """

    @abstractmethod
    def end(self) -> None:
        """End the worker immediately, even if it has been stopped."""
