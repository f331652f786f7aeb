"""A bare loop over `mj_step` that replays the episodes and branches of a generation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any

import mujoco
import numpy as np

from shes.algorithms.worker import RolloutWorker, WorkerPlan
from shes.backends.backend import Backend
from shes.backends.serial import SerialBackend
from shes.bench.evolution import Hyperparameters, generation_work
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.registry import EnvironmentMaker
from shes.envs.tasks.task import FRAME_SKIP, SimulatorFactory
from shes.envs.tasks.task_options import TaskOptions
from shes.es.level import TrainState
from shes.hierarchy.episodes import EpisodeResults
from shes.hierarchy.intervals import branch_work
from shes.hierarchy.population_tasks import Work
from shes.sim.cpu import CpuSimulator
from shes.types import F64Array, FloatArray, IntArray

_REPLAYED = 24  # number of whole episodes that the bare loop replays


@dataclass(frozen=True, kw_only=True, eq=False)
class Episode:
    """The physics of an episode or a branch."""

    start: F64Array
    """Physics state at its start [S]: qpos, qvel, the solver's warm start, time."""
    controls: list[F64Array] = field(default_factory=list)
    """Controls of every control step [A]."""


class BarePhysics:
    """Replays episodes one after another with `mj_step`: the limit of one core."""

    def __init__(self, model: mujoco.MjModel, episodes: Sequence[Episode]) -> None:
        self.model, self.episodes = model, episodes
        self.data = mujoco.MjData(model)
        self._ends = np.cumsum([model.nq, model.nv, model.nv])

    def replay(self, episode: Episode) -> None:
        """Replay `episode` in `data`."""
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:], (data.time,) = np.split(episode.start, self._ends)
        for control in episode.controls:
            data.ctrl[:] = control
            mujoco.mj_step(model, data, nstep=FRAME_SKIP)

    def steps_per_s(self, seconds: float) -> float:
        """Return the control steps per second of replaying all episodes repeatedly for at least `seconds`."""
        steps = 0
        start = perf_counter()
        while (elapsed := perf_counter() - start) < seconds or not steps:
            for episode in self.episodes:
                self.replay(episode)
                steps += len(episode.controls)
        return steps / elapsed


def record_generation(plan: WorkerPlan, state: TrainState, settings: Hyperparameters, table_size: int) -> BarePhysics:
    """Return the physics of the first tasks of the generation after `state`, played on the CPU.

    The share of branches is that of the whole episodes, from whose snapshots they start.
    """
    recorder = _Recorder(plan.env)
    with SerialBackend(partial(RolloutWorker, replace(plan, env=recorder, device="cpu"))) as worker:
        work = generation_work(state, settings, table_size)
        num_tasks = min(len(work.tasks), max(1, _REPLAYED // work.generation.rows_per_lane))
        results = _play(worker, work, num_tasks)
        if settings.intervals is not None and not work.generation.branch_steps:
            snapshots = [left for each in results for left in each.snapshots if left is not None]
            branches = branch_work(state, settings.intervals, table_size, snapshots)
            _play(worker, branches, max(1, len(branches.tasks) * num_tasks // len(work.tasks)))
    return BarePhysics(recorder.models[0], recorder.episodes)


def _play(worker: Backend, work: Work, num_tasks: int) -> list[EpisodeResults]:
    worker.broadcast(work.generation)
    return list(worker.map(work.tasks[:num_tasks]))


class _Recorder:
    """An environment maker that records the arguments of `reset` and `step`."""

    def __init__(self, env: EnvironmentMaker) -> None:
        self._env = env
        self.sets_goals = env.sets_goals
        self.models: list[mujoco.MjModel] = []
        self.episodes: list[Episode] = []

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> EpisodeBatch:
        """Return a batch of `num_episodes` recorded episodes."""

        def keep_model(model: mujoco.MjModel, num_sims: int) -> Any:
            self.models.append(model)
            return simulator(model, num_sims)

        batch = self._env.make(num_episodes, options, keep_model)
        running: dict[int, Episode] = {}
        batch.reset = partial(self._reset, batch, batch.reset, running)  # type: ignore[method-assign]
        batch.step = partial(self._step, batch.step, running)  # type: ignore[method-assign]
        return batch

    def _reset(
        self,
        batch: EpisodeBatch,
        reset: Callable[..., None],
        running: dict[int, Episode],
        ids: IntArray,
        seeds: Sequence[int],
        states: Sequence[F64Array | None] = (),
    ) -> None:
        reset(ids, seeds, states)
        for i, start in zip(ids.tolist(), batch.states(ids), strict=True):
            running[i] = Episode(start=start)
            self.episodes.append(running[i])

    @staticmethod
    def _step(step: Callable[..., None], running: dict[int, Episode], ids: IntArray, action: FloatArray) -> None:
        for i in ids.tolist():
            running[i].controls.append(action[i].astype(np.float64))
        step(ids, action)
