"""The worker: creates the environments, receives a generation, and runs the episodes of its tasks."""

from __future__ import annotations

import logging
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from typing import Protocol

import mujoco

from shes.agents.agent import AgentDesign
from shes.envs.named_environments import EnvironmentMaker
from shes.envs.tasks.task import FRAME_SKIP, SimulatorFactory
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import ConfigError
from shes.es.noise import NoiseTable
from shes.rollout.episodes import EpisodeResults, EpisodeTask, Generation
from shes.rollout.lockstep import NumberedTask, Rollout
from shes.sim.cpu import CpuSimulator
from shes.sim.simulator import Simulator
from shes.sim.warp import WarpSimulator, bytes_per_sim
from shes.sim.warp_device import WarpDevice, is_out_of_memory

_SIMULATOR_LOG = logging.getLogger("shes.mujoco")
_MAX_LOG_LINES = 20  # of the simulator, kept with the results of one task
_CACHE_BYTES = 24 * 2**20  # more weights than this would leave the shared cache between two steps
_MIN_ROWS, _MAX_ROWS = 32, 640  # episodes in lockstep: enough to share Python's overhead, few enough for the caches
_EXTERNAL_ROWS = 16  # of an environment that is stepped alone: each is an instance, which may be large
_SHARE_OF_MEMORY = 0.75  # of a GPU's memory; tasks and policies need some as well


@dataclass(frozen=True, kw_only=True)
class EpisodeSetup:
    """The environment of a run, its options, and the settings by which its episodes are computed."""

    env: EnvironmentMaker
    """Makes the episodes. Sent instead of a name, because a worker's registry lacks the classes of a user's script."""
    training: TaskOptions
    evaluation: TaskOptions
    horizon: int
    evaluation_horizon: int
    chunk_size: int = 0
    device: str = "cpu"
    nconmax: int | None = None
    njmax: int | None = None


@dataclass(frozen=True, kw_only=True)
class WorkerPlan(EpisodeSetup):
    """Data that a worker receives once, at its start."""

    design: AgentDesign
    branch_design: AgentDesign | None = None
    """Design of the agents in branches, if the primitive is evaluated by intervals."""
    noise_table: Path
    """File of the noise table on the machine of the main process."""

    @property
    def simulator(self) -> SimulatorFactory:
        """Function that creates a simulator."""
        return simulator_factory(self.device, self.nconmax, self.njmax)


def lanes_that_fit(parameters: int, rows: int, *, are_external: bool = False) -> int:
    """Return how many lanes, of `parameters` parameters and `rows` episodes each, a CPU worker runs in lockstep.

    More rows share the overhead of a step in Python, but weights that do not fit the cache are slower. Each row of an
    external environment is an instance of it.
    """
    if are_external:
        return max(1, _EXTERNAL_ROWS // rows)
    cached = _CACHE_BYTES // (4 * parameters)
    return max(1, -(-_MIN_ROWS // rows), min(cached, _MAX_ROWS // rows))


def simulator_factory(device: str, nconmax: int | None, njmax: int | None) -> SimulatorFactory:
    """Return the function that creates a simulator on `device`. The CPU ignores `nconmax` and `njmax`."""
    return CpuSimulator if device == "cpu" else partial(WarpSimulator, device=device, nconmax=nconmax, njmax=njmax)


def lanes_in_memory(free_bytes: int, sim_bytes: float, design: AgentDesign, episodes: int, horizon: int) -> int:
    """Return how many lanes of `episodes` episodes fit into `free_bytes` of a GPU, with `sim_bytes` for a simulation.

    A lane's parameters are stored twice, flat and as contiguous matrices, and so is exploration noise while it is
    replaced.
    """
    decisions = -(-horizon // design.controller_interval)
    noise = 4 * (horizon * design.policies[-1].sizes[-1] + decisions * design.decision_size)
    per_lane = 2 * 4 * sum(design.dims) + episodes * (sim_bytes + 2 * noise)
    return max(1, int(_SHARE_OF_MEMORY * free_bytes / per_lane))


class EpisodeSource(Protocol):
    """The tasks of all workers, from which one takes its own."""

    def take(self, most: int, least: int) -> Sequence[NumberedTask]:
        """Return the next tasks, at most `most`, or near the end at least `least`; none at the end."""
        ...

    def note_progress(self) -> None:
        """Show that the worker is alive."""


def _pending_tasks(
    work: EpisodeSource, pending: dict[int, EpisodeTask], lanes: int, least: int
) -> Generator[NumberedTask | None, None, None]:
    """Yield tasks of `work` and note them in `pending`, so that there are up to `lanes` of them.

    None stands for no task until another one has its result.
    """
    asked_at = sys.maxsize  # number of pending tasks after the last question
    while True:
        room = lanes - len(pending)
        if room > 0 and (not pending or len(pending) < asked_at):
            taken = work.take(room, min(room, least))
            if not taken:
                return
            pending.update(taken)
            asked_at = len(pending)
            yield from taken
        else:
            yield None


class _LogCollector(logging.Handler):
    """Collects the simulator's warnings for the results of the current task, each once per generation."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []
        self._told: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        line = f"MuJoCo: {record.getMessage()}"
        if line not in self._told and len(self.lines) < _MAX_LOG_LINES:
            self._told.add(line)
            self.lines.append(line)

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Collect the simulator's messages instead of passing them to other handlers."""
        self._told.clear()
        propagated, _SIMULATOR_LOG.propagate = _SIMULATOR_LOG.propagate, False
        _SIMULATOR_LOG.addHandler(self)
        try:
            yield
        finally:
            _SIMULATOR_LOG.removeHandler(self)
            _SIMULATOR_LOG.propagate = propagated


class RolloutWorker:
    """Runs the episodes of tasks. It is the `Worker` of every backend."""

    def __init__(self, plan: WorkerPlan) -> None:
        """Open the noise table. Environments are created on first use."""
        self.plan = plan
        self.table = NoiseTable.open_copy(plan.noise_table)
        self._rollouts: dict[str, Rollout] = {}  # by kind of generation
        self._room: dict[tuple[str, int], int] = {}  # lanes that fit into a device's memory, by kind of generation
        self._lanes = 1
        self._generation: Generation | None = None
        self._collector = _LogCollector()

    def receive(self, state: Generation) -> None:
        """Store the generation that the next tasks belong to."""
        self._generation = state

    def close(self) -> None:
        """Close the environments; they are made again when they are needed."""
        while self._rollouts:
            _, rollout = self._rollouts.popitem()
            rollout.batch.close()

    def run(self, tasks: EpisodeSource, share: int) -> Iterator[tuple[int, EpisodeResults]]:
        """Run `tasks`, of which about `share` tasks are for this worker, and yield numbered results.

        If a device runs out of memory, tasks without a result are repeated with half as many policies at a time.

        Raises:
            ConfigError: A device has too few contact buffers, or too little memory for a single policy.
        """
        pending: dict[int, EpisodeTask] = {}
        with self._collector.listening():
            while True:
                try:
                    yield from self._run(tasks, pending, share)
                except (MemoryError, RuntimeError) as error:
                    if self.plan.device == "cpu" or not is_out_of_memory(error):
                        raise
                    self._halve(error)
                else:
                    return

    def _run(
        self, work: EpisodeSource, pending: dict[int, EpisodeTask], share: int
    ) -> Iterator[tuple[int, EpisodeResults]]:
        """Run tasks that are `pending` already, then `work`. Tasks are `pending` until they have a result."""
        assert self._generation is not None, "receive() comes first"
        generation = self._generation
        self._lanes, least = self.lockstep(generation, share)
        rollout = self._rollout(generation)
        tasks = chain(tuple(pending.items()), _pending_tasks(work, pending, self._lanes, least))
        table = self.table.on(rollout.batch.xp)
        for number, results in rollout.run(tasks, generation, table, work.note_progress):
            del pending[number]
            lines, self._collector.lines = tuple(self._collector.lines), []
            yield number, replace(results, log=lines) if lines else results
        rollout.batch.check_buffers()

    def lockstep(self, generation: Generation, share: int) -> tuple[int, int]:
        """Return how many of `share` tasks to run in lockstep, and how few suffice near the end.

        There are as few rounds as possible, all of the same size. Only many rounds end with smaller ones: each round
        has a cost of its own.
        """
        rounds = max(1, -(-share // self._most_lanes(generation, share)))
        lanes = max(1, -(-share // rounds))
        return lanes, min(lanes, -(-_MIN_ROWS // generation.rows_per_lane)) if rounds > 2 else lanes

    def _rollout(self, generation: Generation) -> Rollout:
        """Return the rollout for this generation. Create it if needed."""
        plan, shape = self.plan, (generation.rows_per_lane, generation.members_per_lane)
        rollout = self._rollouts.get(generation.kind)
        is_old = rollout is not None and (rollout.rows_per_lane, rollout.members_per_lane) != shape
        if is_old or (rollout is not None and rollout.num_lanes != self._lanes):
            rollout = self._drop(generation)
        if rollout is None:
            if plan.device != "cpu":
                WarpDevice(plan.device).release_memory()
            options = plan.evaluation if generation.is_evaluation else plan.training
            make = partial(plan.env.make, options=options, simulator=plan.simulator)
            horizon, design = self._horizon(generation), self._design(generation)
            rollout = Rollout(design, make, self._lanes, generation.rows_per_lane, horizon, generation.members_per_lane)
            self._rollouts[generation.kind] = rollout
        return rollout

    def _drop(self, generation: Generation) -> None:
        """Close the rollout for generations of this kind, if any."""
        rollout = self._rollouts.pop(generation.kind, None)
        if rollout is not None:
            rollout.batch.close()

    def _most_lanes(self, generation: Generation, share: int) -> int:
        """Return the maximum number of lanes in lockstep: on a device all of them, if they fit into its memory."""
        plan, kind = self.plan, (generation.kind, generation.rows_per_lane)
        asked = -(-plan.chunk_size // generation.members_per_lane)  # the setting counts policies
        if plan.device == "cpu":
            size, is_external = sum(self._design(generation).dims), plan.env.has_own_physics
            return asked or lanes_that_fit(size, generation.rows_per_lane, are_external=is_external)
        if kind not in self._room and not plan.chunk_size:
            self._lanes = 1  # if even the measurement fails, a single lane does not fit
            self._room[kind] = self._measure_room(generation)
        return max(1, min(asked or share, self._room.get(kind, share)))

    def _measure_room(self, generation: Generation) -> int:
        free = WarpDevice(self.plan.device).free_bytes()
        if free is None:
            return sys.maxsize
        design = self._design(generation)
        return lanes_in_memory(free, self._sim_bytes, design, generation.rows_per_lane, self._horizon(generation))

    @cached_property
    def _sim_bytes(self) -> float:
        """Device memory of one simulation. Evaluation uses nearly the same world."""
        plan, models = self.plan, list[mujoco.MjModel]()

        def note(model: mujoco.MjModel, num_sims: int) -> Simulator:
            models.append(model)
            return CpuSimulator(model, num_sims)

        plan.env.make(1, plan.training, note).close()
        return bytes_per_sim(models[0], plan.device, FRAME_SKIP, plan.nconmax, plan.njmax)

    def _halve(self, error: BaseException) -> None:
        """Halve the number of lanes; raise ConfigError if it is one already."""
        assert self._generation is not None
        generation, device, lanes = self._generation, self.plan.device, self._lanes
        if lanes == 1:
            raise ConfigError(
                f"device {device} has too little memory for {generation.rows_per_lane} episodes at a time ({error}). "
                "Set --nconmax or --njmax lower, use --device cpu, or start another run with fewer "
                "--episodes-per-policy or --mirrored none: they are computed together."
            ) from error
        half = self._room[generation.kind, generation.rows_per_lane] = -(-lanes // 2)
        self._drop(generation)
        before, now = (each * generation.members_per_lane for each in (lanes, half))
        self._collector.lines.append(
            f"{before} policies at a time are too many for the memory of device {device}: {now} from here on"
        )

    def _design(self, generation: Generation) -> AgentDesign:
        plan = self.plan
        return plan.branch_design if generation.branch_steps and plan.branch_design is not None else plan.design

    def _horizon(self, generation: Generation) -> int:
        if generation.branch_steps:
            return generation.branch_steps
        return self.plan.evaluation_horizon if generation.is_evaluation else self.plan.horizon
