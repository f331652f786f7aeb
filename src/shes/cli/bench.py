"""`shes bench`: the speed of rollouts, relative to a bare loop over `mj_step` that replays the same episodes."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Annotated, Any, Literal, NamedTuple

import mujoco

from shes.backends.backend import SerialBackend
from shes.envs.named_environments import find_environment
from shes.errors import ConfigError
from shes.evolution.algorithm import roll_out
from shes.evolution.strategies import EvolutionAlgorithm
from shes.machine import on_one_core
from shes.rollout.worker import RolloutWorker
from shes.runs.build import build_algorithm, build_backend, check_limits
from shes.runs.config import TrainConfig
from shes.runs.make_config import make_config
from shes.settings import Ge, checked
from shes.sim.simulator import CpuSimulator
from shes.types import F64Array, IntArray, Listing, facts_listing


@checked
def bench(
    name: Literal["rollout"],  # noqa: ARG001 - says what is measured
    settings: dict[str, Any],
    env: str = "ant-gather",
    *,
    seconds: Annotated[float, Ge(0)] = 0.0,
) -> Listing:
    """Measure the speed of this machine, with the settings of shes train.

    shes bench rollout ant-gather --seconds 60

    Args:
        name: rollout: environment steps per second of whole generations, relative to a bare mj_step loop on one core,
            which replays the same episodes. The ratio is divided by the number of workers.
        settings: Settings of `shes.train` by name.
        env: Environment, see shes envs.
        seconds: Minimum duration of the measurement. On a shared machine a long one is more precise.
    """
    return facts_listing(bench_rollout(make_config(env, settings.pop("preset", "laptop"), settings), seconds=seconds))


def bench_rollout(
    config: TrainConfig, *, repeats: int = 5, seconds: float = 0.0, replay_s: float = 1.0
) -> dict[str, Any]:
    """Measure the speed of whole generations on the device of `config`, relative to a bare `mj_step` loop on one core.

    Every generation is the first of a run; there are at least `repeats`, for `seconds` or longer. The bare loop replays
    part of it for `replay_s` seconds before and after each, without policy or task. A single worker runs on the core of
    the loop, because on a shared machine the speeds of two cores may differ by a third.
    """
    if find_environment(config.run.env).has_own_physics:
        raise ConfigError(
            f"bench rollout compares with MuJoCo alone, but {config.run.env} has its own physics. Name one of SHES's "
            "environments, e.g. ant-gather."
        )
    algorithm = evolution_strategy(config)
    state, physics = algorithm.start(config.run.seed), record_generation(algorithm, config.run.seed)
    is_alone = config.workers.device == "cpu" and (config.workers.backend == "serial" or config.workers.count == 1)
    with on_one_core() if is_alone else nullcontext(), build_backend(config, algorithm.plan()) as backend:
        workers, pairs, start = backend.num_workers, list[tuple[float, float]](), perf_counter()
        next(algorithm.run(state, backend))  # builds the environments and warms the caches
        before = physics.steps_per_s(replay_s)
        while len(pairs) < repeats or perf_counter() - start < seconds:
            report = next(algorithm.run(state, backend))
            after, duration_s = physics.steps_per_s(replay_s), report.columns["rollout_s"] + report.columns["update_s"]
            pairs.append((report.state.env_steps / duration_s, (before + after) / 2))
            before = after  # the speed of a shared machine drifts
    named = ("env", "hidden", "integrator", "population_size", "episodes_per_policy", "device")
    return {
        **{name: config.values[name] for name in named},
        "num_workers": workers,
        "generations": len(pairs),
        "env_steps_per_s": statistics.median(whole for whole, _ in pairs),
        "bare_steps_per_s": statistics.median(bare for _, bare in pairs),
        "ratio": statistics.median(whole / bare for whole, bare in pairs) / workers,
    }


def evolution_strategy(config: TrainConfig) -> EvolutionAlgorithm:
    """Return the evolution strategy of `config`; raise ConfigError if there is none, or too little memory."""
    algorithm = build_algorithm(config)
    if not isinstance(algorithm, EvolutionAlgorithm):
        raise ConfigError(f"bench measures evolution strategies, got {config.run.algorithm}. Set --algorithm shes.")
    check_limits(config, algorithm.design)
    return algorithm


class RecordedEpisode(NamedTuple):
    """MuJoCo's integration state at the start of an episode or a branch, the time first, and all its controls [A]."""

    start: F64Array
    controls: list[F64Array]


class BarePhysics:
    """Replays episodes one after another with `mj_step`: the limit of one core."""

    def __init__(self, model: mujoco.MjModel, episodes: Sequence[RecordedEpisode], frame_skip: int) -> None:
        self.model, self.episodes, self.data, self.frame_skip = model, episodes, mujoco.MjData(model), frame_skip

    def replay(self, episode: RecordedEpisode) -> None:
        """Replay `episode` in `data`."""
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        mujoco.mj_setState(model, data, episode.start, mujoco.mjtState.mjSTATE_INTEGRATION)
        for control in episode.controls:
            data.ctrl[:] = control
            mujoco.mj_step(model, data, nstep=self.frame_skip)

    def steps_per_s(self, seconds: float) -> float:
        """Return the control steps per second of replaying all episodes repeatedly for at least `seconds`."""
        steps, start = 0, perf_counter()
        while (elapsed := perf_counter() - start) < seconds or not steps:
            for episode in self.episodes:
                self.replay(episode)
                steps += len(episode.controls)
        return steps / elapsed


def record_generation(algorithm: EvolutionAlgorithm, seed: int, num_episodes: int = 24) -> BarePhysics:
    """Return the physics of about `num_episodes` whole episodes of the first generation, played on the CPU.

    The share of branches, which start from snapshots of these episodes, is that of the whole episodes.
    """
    settings, table_size, state = algorithm.hyperparameters, algorithm.table.size, algorithm.start(seed)
    recorders = list[_RecordingSimulator]()
    plan = replace(algorithm.plan(), device="cpu", simulator=partial(_RecordingSimulator, recorders))
    with SerialBackend(partial(RolloutWorker, plan)) as worker:
        draw, *others = settings.estimates
        draws = draw(state, settings, table_size, ())
        num_tasks = min(len(draws.tasks), max(1, num_episodes // draws.generation.rows_per_lane))
        episodes = roll_out(replace(draws, tasks=draws.tasks[:num_tasks]), worker)
        for draw_branches in others:
            branches = draw_branches(state, settings, table_size, (episodes,))
            share = max(1, len(branches.tasks) * num_tasks // len(draws.tasks))
            roll_out(replace(branches, tasks=branches.tasks[:share]), worker)
    robot = algorithm.problem.sample().robot
    assert robot is not None, "an external environment is refused"
    recorded = [episode for each in recorders for episode in each.episodes]
    return BarePhysics(recorders[0].model, recorded, robot.frame_skip)


class _RecordingSimulator(CpuSimulator):
    """A simulator that records the state of every simulation at its first step after a reset, and all its controls."""

    def __init__(self, recorders: list[_RecordingSimulator], model: mujoco.MjModel, num_sims: int) -> None:
        super().__init__(model, num_sims)
        recorders.append(self)
        self.episodes: list[RecordedEpisode] = []
        self._running: dict[int, RecordedEpisode] = {}

    def reset(self, ids: IntArray) -> None:
        super().reset(ids)
        for i in ids.tolist():
            self._running.pop(i, None)

    def step(self, ids: IntArray, nstep: int) -> None:
        for i in ids.tolist():
            if i not in self._running:
                self._running[i] = RecordedEpisode(self._batch.state[i].copy(), [])
                self.episodes.append(self._running[i])
            self._running[i].controls.append(self.ctrl[i].copy())
        super().step(ids, nstep)
