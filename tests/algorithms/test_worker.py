"""What a worker does with the work it is handed: lanes, horizons, and the simulator's messages."""

import logging

import numpy as np
import pytest

from shes.algorithms.worker import RolloutWorker, WorkerPlan, lanes_that_fit
from shes.backends.backend import TaskList
from shes.envs.registry import find_environment, make_task
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import StorageError
from shes.es.level import LevelParameters
from shes.es.noise import NoiseTable
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.episodes import EpisodeTask, Generation
from shes.hierarchy.goals import AngleEncoding
from shes.hierarchy.hierarchical import HierarchicalDesign
from shes.hierarchy.outputs import VectorOutput
from shes.hierarchy.rewards import ProgressReward
from shes.policies.mlp import MLP


def _plan(**changes):
    task = make_task("point-gather", 1)
    design = HierarchicalDesign(
        controller=MLP(task.observation_size, (4,), 2),
        primitive=MLP(3 + task.observation_size, (4,), task.action_size),
        goal_encoding=AngleEncoding(),
        primitive_reward=ProgressReward(),
        controller_output=VectorOutput(),
        goal_distance=4.0,
        controller_interval=5,
        has_minimum_goal_distance=True,
        control_limit=task.control_limit,
    )
    plan = {
        "env": find_environment("point-gather"),
        "training": TaskOptions(),
        "evaluation": TaskOptions(evaluation=True),
        "design": design,
        "noise_table": NoiseTable.open(5000).path,
        "horizon": 6,
        "evaluation_horizon": 9,
        "chunk_size": 3,
    }
    return WorkerPlan(**{**plan, **changes})


def _generation(plan, *, episodes=2, is_evaluation=False):
    levels = tuple(
        LevelParameters.of(mlp.initial(np.random.default_rng(0)), ObservationStatistics.empty(mlp.sizes[0]))
        for mlp in plan.design.policies
    )
    return Generation(levels=levels, sigma=0.1, episodes_per_policy=episodes, is_evaluation=is_evaluation)


def _work(count, episodes=2):
    """Return tasks whose seeds do not depend on how many `episodes` there are."""
    slots = tuple(range(episodes))
    return [
        (
            n,
            EpisodeTask(
                member=n, noise_index=(n, n), signs=((1, 1),), slots=slots, seeds=tuple(10 * n + slot for slot in slots)
            ),
        )
        for n in range(count)
    ]


def _run(worker, generation, count=4, share=4):
    worker.receive(generation)
    return dict(worker.run(TaskList(_work(count)), share))


def test_training_and_evaluation_have_their_own_horizon():
    plan = _plan()
    worker = RolloutWorker(plan)
    for is_evaluation, steps in ((False, 6), (True, 9), (False, 6)):
        results = _run(worker, _generation(plan, is_evaluation=is_evaluation))
        assert sorted(results) == [0, 1, 2, 3]
        assert {step for result in results.values() for step in result.steps.tolist()} == {steps}


def test_the_episodes_of_a_policy_may_change_from_generation_to_generation():
    plan = _plan()
    worker, runs = RolloutWorker(plan), []
    for episodes in (2, 3, 1, 3):
        worker.receive(_generation(plan, episodes=episodes))
        runs.append(dict(worker.run(TaskList(_work(4, episodes)), 4 * episodes)))
        assert {len(result.steps) for result in runs[-1].values()} == {episodes}
    two, three, one, again = runs
    for number in range(4):
        # What a worker did before changes no bit; how many episodes share a policy's matmul changes no more than that.
        assert three[number].returns.tobytes() == again[number].returns.tobytes()
        assert two[number].returns == pytest.approx(three[number].returns[:, :2], rel=1e-4, abs=1e-4)
        assert one[number].returns == pytest.approx(three[number].returns[:, :1], rel=1e-4, abs=1e-4)


def test_environments_that_do_not_fit_any_more_are_closed_and_others_kept():
    plan = _plan()
    made, closed = [], []

    class Counting:
        has_own_physics = False

        def make(self, num_episodes, options, simulator):
            task = plan.env.make(num_episodes, options, simulator)
            made.append((num_episodes, options.evaluation))
            task.close = lambda: closed.append(num_episodes)
            return task

    worker = RolloutWorker(_plan(env=Counting()))
    for episodes, share, is_evaluation in (
        (2, 2, False), (2, 2, False), (4, 2, True), (2, 2, False), (3, 2, False), (3, 1, False)
    ):  # fmt: skip
        worker.receive(_generation(plan, episodes=episodes, is_evaluation=is_evaluation))
        list(worker.run(TaskList(_work(2, episodes)), share))
    # Two lanes of 2, of 4 and of 3 episodes, then a single lane of 3.
    assert made == [(4, False), (8, True), (6, False), (3, False)]
    assert closed == [4, 6]


@pytest.mark.parametrize("share", [1, 2, 100])
def test_the_share_of_a_worker_changes_no_bit(share):
    plan = _plan()
    worker = RolloutWorker(plan)
    expected = _run(worker, _generation(plan))
    results = _run(worker, _generation(plan), share=share)
    assert {n: r.returns.tobytes() for n, r in results.items()} == {n: r.returns.tobytes() for n, r in expected.items()}


def test_no_more_tasks_are_taken_at_once_than_an_even_share():
    plan = _plan(chunk_size=50)
    worker = RolloutWorker(plan)
    worker.receive(_generation(plan))
    work = TaskList(_work(8))
    next(iter(worker.run(work, share=3)))
    assert len(list(work)) == 5


def _logs_of_a_run_in_which_the_simulator_says(message, times):
    plan = _plan()
    worker = RolloutWorker(plan)
    worker.receive(_generation(plan))

    class Saying(TaskList):
        def take(self, most, least=None):
            for number in range(times if self.is_new else 0):
                logging.getLogger("shes.mujoco").warning(message.format(number=number))
            self.is_new = False
            return super().take(most, least)

        is_new = True

    return [result.log for _, result in worker.run(Saying(_work(4)), 8)]


def test_what_the_simulator_says_comes_with_the_results_once():
    logs = _logs_of_a_run_in_which_the_simulator_says("Nan, Inf or huge value in QACC", 1)
    assert sorted(logs) == [(), (), (), ("MuJoCo: Nan, Inf or huge value in QACC",)]


def test_a_flood_of_messages_is_cut():
    logs = _logs_of_a_run_in_which_the_simulator_says("at time {number}", 1000)
    assert 1 <= sum(len(lines) for lines in logs) <= 100


def test_what_the_simulator_repeats_in_a_generation_comes_once():
    logs = _logs_of_a_run_in_which_the_simulator_says("the same", 3)
    assert sorted(logs) == [(), (), (), ("MuJoCo: the same",)]


def test_outside_its_runs_a_worker_leaves_the_simulators_log_alone(caplog):
    RolloutWorker(_plan())
    logging.getLogger("shes.mujoco").warning("heard elsewhere")
    assert caplog.messages == ["heard elsewhere"]


def test_a_worker_without_its_noise_table_says_so(tmp_path):
    with pytest.raises(StorageError, match="cannot be opened"):
        RolloutWorker(_plan(noise_table=tmp_path / "gone.f32"))


@pytest.mark.parametrize(
    ("parameters", "episodes", "lanes"),
    # Small networks: 640 rows. 10 MiB of parameters: only two fit the cache, yet 32 rows must share a step.
    [(1000, 1, 640), (1000, 5, 128), (131_072, 1, 48), (10 * 2**18, 5, 7), (10**9, 100, 1)],
)
def test_lanes_share_the_cache_but_are_never_too_few(parameters, episodes, lanes):
    assert lanes_that_fit(parameters, episodes) == lanes
