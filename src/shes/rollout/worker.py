"""The worker: creates the environments, receives a generation, and runs the episodes of its tasks."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from shes.agents.agent import AgentDesign
from shes.backends.backend import TaskSource
from shes.envs.named_environments import EnvironmentMaker
from shes.envs.tasks.task import SimulatorFactory, TaskOptions
from shes.errors import ConfigError
from shes.es.noise import NoiseTable
from shes.machine import signals_delayed
from shes.rollout.episodes import EpisodeResults, EpisodeTask, Generation
from shes.rollout.lockstep import NumberedTask, Rollout
from shes.sim.simulator import CpuSimulator
from shes.sim.warp_device import WarpDevice, is_out_of_memory

_SIMULATOR_LOG = logging.getLogger("shes.mujoco")
_MAX_LOG_LINES = 20  # of the simulator, kept with the results of one task
_CACHE_BYTES = 24 * 2**20  # more weights than this would leave the shared cache between two steps
_MIN_ROWS, _MAX_ROWS = 32, 640  # episodes in lockstep: enough to share Python's overhead, few enough for the caches
_EXTERNAL_ROWS = 16  # of an environment that is stepped alone: each is an instance, which may be large


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
    simulator: SimulatorFactory = CpuSimulator
    """Creates simulators on `device`."""


@dataclass(frozen=True, kw_only=True)
class WorkerPlan(EpisodeSetup):
    """Data that a worker receives once, at its start."""

    design: AgentDesign
    branch_design: AgentDesign | None = None
    """Design of the agents in branches, if the primitive is evaluated by intervals."""
    noise_table: Path
    """File of the noise table on the machine of the main process."""

    def of(self, generation: Generation) -> tuple[TaskOptions, int, AgentDesign]:
        """Return the task's options, the most control steps and the agents of the episodes of `generation`."""
        if generation.kind == "evaluation":
            return self.evaluation, self.evaluation_horizon, self.design
        if generation.branch_steps:
            return self.training, generation.branch_steps, self.branch_design or self.design
        return self.training, self.horizon, self.design


def lanes_that_fit(parameters: int, rows: int, *, are_external: bool = False) -> int:
    """Return how many lanes, of `parameters` parameters and `rows` episodes each, a CPU worker runs in lockstep.

    More rows share the overhead of a step in Python, but weights that do not fit the cache are slower. Each row of an
    external environment is an instance of it.
    """
    if are_external:
        return max(1, _EXTERNAL_ROWS // rows)
    cached = _CACHE_BYTES // (4 * parameters)
    return max(1, -(-_MIN_ROWS // rows), min(cached, _MAX_ROWS // rows))


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
        self._room: dict[tuple[str, int], int] = {}  # lanes that fit into a device's memory, by kind and rows
        self._lanes = 1
        self._generation: Generation | None = None
        self._collector = _LogCollector()

    def receive(self, state: Generation) -> None:
        """Store the generation that the next tasks belong to."""
        self._generation = state

    def close(self) -> None:
        """Close the environments; they are made again when they are needed."""
        while self._rollouts:
            self._rollouts.popitem()[1].batch.close()

    def run(self, tasks: TaskSource, share: int) -> Iterator[tuple[int, EpisodeResults]]:
        """Run `tasks`, of which about `share` tasks are for this worker, and yield numbered results.

        If a device runs out of memory, tasks without a result are repeated with half as many policies at a time.
        ConfigError is raised if its contact buffers are too few, or its memory too small for a single policy.
        """
        pending: dict[int, EpisodeTask] = {}
        with self._collector.listening():
            while True:
                try:
                    yield from self._run(tasks, pending, share)
                except (MemoryError, RuntimeError) as error:
                    if self.plan.device == "cpu" or not is_out_of_memory(error):
                        raise
                    self._make_room(error)
                else:
                    return

    def _run(
        self, work: TaskSource, pending: dict[int, EpisodeTask], share: int
    ) -> Iterator[tuple[int, EpisodeResults]]:
        """Run tasks that are `pending` already, then `work`. Tasks are `pending` until they have a result."""
        assert self._generation is not None, "receive() comes first"
        generation = self._generation
        # As few rounds as possible, all of the same size, for each has its own cost. Only many end with smaller ones.
        rounds = max(1, -(-share // self._most_lanes(generation, share)))
        self._lanes = least = max(1, -(-share // rounds))
        if rounds > 2:
            least = min(self._lanes, -(-_MIN_ROWS // generation.rows_per_lane))
        rollout, unfinished = self._rollout(generation), list(pending.items())
        last_asked = sys.maxsize  # number of pending tasks after the last question

        def take(room: int) -> Sequence[NumberedTask]:
            nonlocal last_asked
            taken: Sequence[NumberedTask] = unfinished[:room]
            del unfinished[:room]
            if not taken and (not pending or len(pending) < last_asked):
                taken = work.take(room, min(room, least))
                pending.update(taken)
                last_asked = len(pending)
            return taken

        table = self.table.on(rollout.batch.xp)
        for number, results in rollout.run(take, generation, table, work.note_progress):
            del pending[number]
            lines, self._collector.lines = tuple(self._collector.lines), []
            yield number, replace(results, log=lines) if lines else results
        rollout.batch.check_buffers()

    def _rollout(self, generation: Generation) -> Rollout:
        plan, kind = self.plan, generation.kind
        shape = self._lanes, generation.rows_per_lane, generation.members_per_lane
        if kind in self._rollouts and self._rollouts[kind].shape != shape:
            self._rollouts.pop(kind).batch.close()
        if kind not in self._rollouts:
            if plan.device != "cpu":
                WarpDevice(plan.device).release_memory()
            options, horizon, design = plan.of(generation)
            make = partial(plan.env.make, options=options, simulator=plan.simulator)
            with signals_delayed() if plan.env.has_own_physics else nullcontext():
                self._rollouts[kind] = Rollout(design, make, *shape[:2], horizon, generation.members_per_lane)
        return self._rollouts[kind]

    def _most_lanes(self, generation: Generation, share: int) -> int:
        """Return the maximum number of lanes in lockstep: on a device all of them, if they fit into its memory."""
        plan, rows = self.plan, generation.rows_per_lane
        asked = -(-plan.chunk_size // generation.members_per_lane)  # the setting counts policies
        if plan.device != "cpu":
            return min(asked or share, self._room.get((generation.kind, rows), share))
        size = sum(plan.of(generation)[2].dims)
        return asked or lanes_that_fit(size, rows, are_external=plan.env.has_own_physics)

    def _make_room(self, error: BaseException) -> None:
        """Close other rollouts, or if there are none halve the number of lanes; raise ConfigError if it is one."""
        assert self._generation is not None
        generation, device, lanes = self._generation, self.plan.device, self._lanes
        has_others = bool(self._rollouts.keys() - {generation.kind})
        self.close()
        if has_others:
            return
        if lanes == 1:
            raise ConfigError(
                f"device {device} has too little memory for {generation.rows_per_lane} episodes at a time ({error}). "
                "Set --nconmax or --njmax lower, use --device cpu, or start another run with fewer "
                "--episodes-per-policy or --mirrored none: they are computed together."
            ) from error
        half = self._room[generation.kind, generation.rows_per_lane] = -(-lanes // 2)
        before, now = (each * generation.members_per_lane for each in (lanes, half))
        self._collector.lines.append(
            f"{before} policies at a time are too many for the memory of device {device}: {now} from here on"
        )
