"""A recorder of what a run does: the rollouts of its worker, its updates, its simulators.

Tests compare these with the settings of the run. The serial backend is recorded; worker processes are not.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shes.es.level import update_level
from shes.es.noise import NoiseTable
from shes.evolution import way_search
from shes.evolution.state import TrainState
from shes.rollout import worker
from shes.rollout.episodes import Generation
from shes.rollout.lockstep import Rollout
from shes.runs.build import build_algorithm, build_backend
from shes.runs.evaluate import evaluate_state
from shes.runs.make_config import make_config
from shes.sim.simulator import CpuSimulator


class Record(SimpleNamespace):
    """Rollouts, updates and simulators of a run.

    A rollout has `rollout`, `generation`, `table`, `tasks` and `results`; an update has `before`, `shaped`, `rule`,
    `learning_rate` and `result`.
    """

    def of(self, kind: str) -> list[SimpleNamespace]:
        """Return the rollouts of `training`, `branch` or `evaluation`."""
        return [each for each in self.rolled_out if each.generation.kind == kind]

    def seeds(self, kind: str) -> list[int]:
        """Return the seeds of the episodes of a kind, in order."""
        return [seed for each in self.of(kind) for task in each.tasks for seed in task.seeds]


@contextmanager
def recording() -> Iterator[Record]:
    """Record what is done in this process meanwhile. The machine has one core, and the CPU simulates every device."""
    record = Record(rolled_out=[], updates=[], device_simulators=[])

    class RecordedRollout(Rollout):
        def run(self, take: Any, generation: Generation, table: NoiseTable, *_: Any) -> Iterator[Any]:
            own = SimpleNamespace(rollout=self, generation=generation, table=table, tasks=[], results=[])
            record.rolled_out.append(own)

            def noted(room: int) -> Any:
                taken = take(room)
                own.tasks.extend(task for _, task in taken)
                return taken

            for number, results in super().run(noted, generation, table):
                own.results.append(results)
                yield number, results

    class DeviceSimulator(CpuSimulator):
        def __init__(self, model: Any, num_sims: int, **arguments: Any) -> None:
            super().__init__(model, num_sims)
            record.device_simulators.append(arguments)

    def device(name: str) -> SimpleNamespace:
        return SimpleNamespace(name=name, xp=np, release_memory=lambda: None)

    def record_update(level, shaped, signs, noise_index, table, rule, learning_rate, pool):  # noqa: PLR0917 - its own
        result = update_level(level, shaped, signs, noise_index, table, rule, learning_rate, pool)
        own = SimpleNamespace(before=level, shaped=shaped, rule=rule, learning_rate=learning_rate, result=result)
        record.updates.append(own)
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("shes.runs.config.num_cores", lambda: 1)
        patch.setattr("shes.backends.backend.num_cores", lambda: 1)
        patch.setattr(worker, "Rollout", RecordedRollout)
        patch.setattr("shes.runs.build.WarpSimulator", DeviceSimulator)
        patch.setattr(worker, "WarpDevice", device)
        patch.setattr("shes.evolution.strategies.WarpDevice", device)
        patch.setattr(way_search, "SLICE_STEPS", min(4000, way_search.SLICE_STEPS))
        patch.setattr("shes.evolution.algorithm.update_level", record_update)
        yield record


def record_generations(env: str, settings: dict[str, Any], generations: tuple[int, ...] = (0,)) -> Record:
    """Return the record of `generations` and an evaluation of a run with the preset `smoke` and these settings.

    Each generation begins with the parameters of the start. The last few records are cached: reset their tasks before
    use, and change nothing else.
    """
    return _record(env, tuple(sorted(settings.items())), generations)


@lru_cache(maxsize=24)
def _record(env: str, settings: tuple[tuple[str, Any], ...], generations: tuple[int, ...]) -> Record:
    config = make_config(env, "smoke", {"backend": "serial", **dict(settings)})
    with recording() as record:
        record.algorithm = algorithm = build_algorithm(config)
        start: TrainState = algorithm.start(config.run.seed)
        with build_backend(config, algorithm.plan()) as backend:
            for generation in generations:
                record.state = next(algorithm.run(replace(start, generation=generation), backend)).state
            record.evaluation = evaluate_state(algorithm, record.state, range(16), backend)
    return record
