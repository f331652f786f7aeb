"""What a worker does with the work it is handed: lanes, horizons, and the simulator's messages."""

import logging
from dataclasses import replace
from functools import lru_cache

import pytest

from shes.backends.backend import TaskList
from shes.rollout.episodes import EpisodeTask, Generation
from shes.rollout.worker import RolloutWorker, lanes_that_fit
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from tests.rollout.designs import both, levels_of
from tests.rollout.fake_task import FakeEnvironment, make_seed

SETTINGS = {"hidden": (4,), "controller_interval": 5, "noise_table_size": 5000, "horizon": 6, "evaluation_horizon": 9}


@lru_cache
def a_plan():
    """Return a plan with episodes of 6 steps, of 9 in evaluation, three members at a time."""
    return build_algorithm(make_config("point-gather", "smoke", {**SETTINGS, "chunk_size": 3})).plan()


def generation_of(plan, *, episodes=2, kind="training"):
    levels = levels_of(plan.design)
    return Generation(levels=levels, sigma=0.1, episodes_per_policy=episodes, kind=kind)


def numbered_tasks(count, episodes=2):
    """Return tasks whose seeds do not depend on how many `episodes` there are."""
    slots = tuple(range(episodes))
    return [
        (n, EpisodeTask(member=n, noise_index=(n, n), signs=((1, 1),), slots=slots,
                        seeds=tuple(10 * n + slot for slot in slots)))
        for n in range(count)
    ]  # fmt: skip


def run(worker, count=4, share=4, **generation):
    """Return the results by number of a worker that expects a `share` of the tasks."""
    worker.receive(generation_of(worker.plan, **generation))
    episodes = generation.get("episodes", 2)
    done = list(worker.run(TaskList(numbered_tasks(count, episodes)), share))
    assert len(dict(done)) == len(done)
    return dict(done)


def returns_of(results):
    return {number: result.outcomes["returns"].tobytes() for number, result in results.items()}


def test_environments_that_do_not_fit_are_closed_and_others_kept():
    made, closed = [], []

    class Counting:
        has_own_physics = False

        def make(self, num_episodes, options, simulator):
            task = a_plan().env.make(num_episodes, options, simulator)
            made.append((num_episodes, options.evaluation))
            task.close = lambda: closed.append(num_episodes)
            return task

    worker = RolloutWorker(replace(a_plan(), env=Counting()))
    for episodes, share in ((2, 2), (2, 2), (4, 2), (2, 2), (3, 2), (3, 1)):
        kind = "evaluation" if episodes == 4 else "training"
        run(worker, 2, share, episodes=episodes, kind=kind)
    # Two lanes of 2, of 4 and of 3 episodes, then a single lane of 3.
    assert made == [(4, False), (8, True), (6, False), (3, False)]
    assert closed == [4, 6]


def test_a_worker_that_got_less_asks_again_only_after_a_result():
    """Not when one of a task's two episodes ends."""
    asked, found = [], []

    class Scarce(TaskList):
        def take(self, most, least):
            asked.append(len(found))
            return super().take(1, 1)

    worker = RolloutWorker(replace(a_plan(), env=FakeEnvironment(), design=both()))
    worker.receive(generation_of(worker.plan))
    seeds = (make_seed(terminates_after=2), make_seed(terminates_after=4))
    tasks = [(number, replace(task, seeds=seeds)) for number, task in numbered_tasks(3)]
    for result in worker.run(Scarce(tasks), share=3):
        found.append(result)
    assert asked == [0, 1, 2, 3]


def test_no_more_tasks_are_taken_at_once_than_an_even_share():
    worker, work = RolloutWorker(replace(a_plan(), chunk_size=50)), TaskList(numbered_tasks(8))
    worker.receive(generation_of(worker.plan))
    next(iter(worker.run(work, share=3)))
    assert len(work.take(9, 9)) == 5


@pytest.mark.parametrize(
    ("said", "first", "most"),
    [
        (["Nan, Inf or huge value in QACC"], ("MuJoCo: Nan, Inf or huge value in QACC",), 1),
        (["the same"] * 3, ("MuJoCo: the same",), 1),
        ([f"at time {number}" for number in range(1000)], ("MuJoCo: at time 0",), 100),
    ],
)
def test_what_the_simulator_says_comes_with_the_results_once(said, first, most, caplog):
    class Saying(TaskList):
        def take(self, most, least=None):
            while said:
                logging.getLogger("shes.mujoco").warning(said.pop(0))
            return super().take(most, least)

    worker = RolloutWorker(a_plan())
    worker.receive(generation_of(worker.plan))
    logs = sorted(result.log for _, result in worker.run(Saying(numbered_tasks(4)), 8))
    assert logs[:3] == [()] * 3
    assert logs[3][:1] == first
    assert len(logs[3]) <= most
    logging.getLogger("shes.mujoco").warning("outside of a run")
    assert caplog.messages == ["outside of a run"]


@pytest.mark.parametrize(
    ("parameters", "episodes", "lanes"),
    # Small networks: 640 rows. 10 MiB of parameters: only two fit the cache, yet 32 rows must share a step.
    [(1000, 1, 640), (1000, 5, 128), (131_072, 1, 48), (10 * 2**18, 5, 7), (10**9, 100, 1)],
)
def test_lanes_share_the_cache_but_are_never_too_few(parameters, episodes, lanes):
    assert lanes_that_fit(parameters, episodes) == lanes
