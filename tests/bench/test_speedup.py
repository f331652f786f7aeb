"""The projection of a generation to many workers, in simulated time, and the bench that validates it."""

import math
import os
import re
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.bench import speedup
from shes.bench.bench import bench
from shes.bench.lockstep import Lockstep, StepCost
from shes.bench.simulation import Costs, GenerationTimes, Network, simulate
from shes.bench.sleepers import Sleep, Sleeper, SleepersBackend
from shes.bench.speedup import bench_speedup, read_rows, speedup_of
from shes.bench.speedup_figure import draw_speedup
from shes.cores import core_numbers
from shes.errors import ConfigError, WorkerError
from shes.training.make_config import make_config
from tests.e2e import runs
from tests.hierarchy.made_up import make_task

TINY = {"population_size": 8, "hidden": (4,), "horizon": 10, "evaluation_horizon": 10, "noise_table_size": 1_000_000}
COST = StepCost(rows=np.array([1, 400]), seconds=np.array([0.2, 40.1]), row_s=0.1)  # 0.1, and 0.1 for each episode
NOTHING = Costs(
    draw_s=0, copy_s=0, begin_s=0, want_s=0, result_s=0, update_s=0, state_bytes=0, task_bytes=0, result_bytes=0
)  # fmt: skip
NO_NETWORK = Network(latency_s=0, bytes_per_s=math.inf)


def times(sizes, num_workers, *, steps=10, rows=None, costs=NOTHING, network=NO_NETWORK):
    """Return the times of tasks of these sizes; all episodes have as many `steps`."""
    tasks = [make_task(member, range(size)) for member, size in enumerate(sizes)]
    return simulate(
        tasks, lambda task: [steps] * len(task.slots), lambda share: (rows or share,) * 2, COST, costs, network,
        num_workers,
    )  # fmt: skip


@pytest.mark.parametrize(("running", "seconds"), [(11, 1.2), (10, 1.1), (1, 0.2)])
def test_an_episode_that_has_ended_saves_its_physics(running, seconds):
    assert COST.of(11, running) == pytest.approx(seconds)


def test_more_rows_than_were_measured_cost_in_proportion():
    assert COST.of(800, 800) == pytest.approx(80.2)


def test_a_worker_asks_again_when_a_task_is_finished_and_not_before():
    worker = Lockstep(cost=COST, rows=4)
    worker.add(0, [1, 3])
    worker.add(1, [2])
    assert worker.room == 0  # it has just asked
    assert worker.advance() == (pytest.approx(0.4), [])
    assert worker.room == 0  # a task still has an episode
    assert worker.advance() == (pytest.approx(0.3), [1])
    assert worker.room == 2


def test_one_worker_takes_as_long_as_its_episodes():
    found = times([2, 2], 1)
    assert found.rollout_s == pytest.approx(10 * 0.5)
    assert found.busy_s == pytest.approx(found.rollout_s)


@given(policies=st.integers(1, 60), episodes=st.integers(1, 5), workers=st.integers(1, 100))
def test_without_other_costs_the_share_of_a_worker_sets_the_time(policies, episodes, workers):
    share = -(-policies * episodes // workers)
    assert times([episodes] * policies, workers).rollout_s == pytest.approx(10 * (0.1 + 0.1 * share))


def test_several_rounds_cost_their_overhead_each():
    assert times([1] * 12, 2, rows=2).rollout_s == pytest.approx(3 * 10 * 0.3)


def test_the_parent_answers_one_message_after_the_other():
    slow = replace(NOTHING, draw_s=1.0, begin_s=0.5, want_s=0.25, result_s=2.0, update_s=4.0)
    found = times([1] * 4, 4, costs=slow, steps=1)
    # Drawn after 1 s; the last of four is told at 3 s, asks at once and is answered at 4 s. From then on the parent is
    # never without messages: each worker brings its result with its second question, and is done.
    assert found.start_s == pytest.approx(4.0)
    assert found.rollout_s == pytest.approx(1 + 4 * (0.5 + 0.25 + 2.0 + 0.25 + 0.5))
    assert found.update_s == 4.0


def test_the_parent_copies_the_state_for_every_worker_unless_nodes_pass_it_on():
    costs = replace(NOTHING, copy_s=1.0)
    assert times([1] * 4, 4, costs=costs).start_s == 0
    alone = replace(NO_NETWORK, cores_per_node=0)
    assert times([1] * 4, 4, costs=costs, network=alone).start_s == pytest.approx(4.0)


def test_messages_take_the_time_of_the_network():
    network = Network(latency_s=0.5, bytes_per_s=100, cores_per_node=2)
    sizes = replace(NOTHING, state_bytes=100, task_bytes=50, result_bytes=200)
    # Three nodes are two levels of a tree.
    state_s, ask_s, tasks_s, result_s = 2 * (0.5 + 1), 0.5, 0.5 + 0.5, 0.5 + 2
    found = times([1] * 6, 6, costs=sizes, network=network)
    assert found.start_s == pytest.approx(state_s + ask_s + tasks_s)
    end_s = 0.5 + 0.5  # there is no more; it is done
    assert found.rollout_s == pytest.approx(found.start_s + 10 * 0.2 + result_s + end_s)


def test_measured_speed_ups_are_relative_to_the_mean_speed_of_the_cores_and_projected_ones_to_one_core():
    def report(seconds):
        results = SimpleNamespace(seconds=np.array([seconds]))
        return SimpleNamespace(rollout_s=seconds, update_s=0.0, populations=[SimpleNamespace(results=results)])

    def simulate(num_workers, network):
        return GenerationTimes(start_s=0.0, rollout_s=12 / num_workers, update_s=0.0, busy_s=12.0)

    alone = [report(10.0), report(30.0)]  # a generation takes 15 s on a core of the mean speed
    stage, measured = SimpleNamespace(num_episodes=3, simulate=simulate), {1: alone[0], 2: report(8.0)}
    rows = speedup._rows([stage], alone, measured, NO_NETWORK, (2,), ())
    found = [(row["kind"], row["cores"], row["speedup"], row["efficiency"], row["bound"]) for row in rows]
    assert found == [
        ("alone", 1, 1.5, 1.5, 1.0),
        ("alone", 1, 0.5, 0.5, 1.0),
        ("measured", 1, 1.0, 1.0, 1.0),
        ("measured", 2, 15 / 8, 15 / 16, 0.75),
        ("projected here", 1, 1.0, 1.0, 1.0),
        ("projected here", 2, 2.0, 1.0, 0.75),
        ("projected", 2, 2.0, 1.0, 0.75),
    ]


def test_a_node_of_sleeping_workers_outlives_ctrl_c_and_not_its_parent():
    sleep = Sleep(cost=COST, steps=np.zeros(1, np.int64), episodes_per_policy=1, rounds={})
    with SleepersBackend(partial(Sleeper, sleep), 3, per_node=3) as backend:
        (node,) = backend._nodes
        os.kill(node.pid, signal.SIGINT)  # as in a terminal, where it reaches the whole group

        def ignores_ctrl_c():
            status = Path(f"/proc/{node.pid}/status").read_text(encoding="utf-8")
            return int(re.search(r"SigIgn:\s+(\w+)", status)[1], 16) & 1 << signal.SIGINT - 1

        runs.wait_until(ignores_ctrl_c, "the node ignores it")
        assert node.poll() is None
        os.close(backend._pipe.pop())  # the end that closes with the parent
        assert node.wait(runs.patient(10)) == 1
        with pytest.raises(WorkerError, match=r"a process of sleeping workers died; none is replaced"):
            backend.start_worker()


BRANCHES = {"primitive_estimate": "interval", "primitive_view": "proprioception"}


@pytest.mark.parametrize(
    ("settings", "workers"),
    [({}, 1), pytest.param(BRANCHES, 1, marks=pytest.mark.extras), pytest.param({}, 2, marks=pytest.mark.extras)],
    ids=["episodes", "branches", "two processes"],
)
def test_the_bench_measures_projects_and_validates(tmp_path, settings, workers):
    def make(algorithm):
        own = settings if algorithm == "shes" else {}
        where = {"backend": "serial" if workers == 1 else "processes", "num_workers": workers}
        return make_config("point-gather", "smoke", {**TINY, **own, **where, "algorithm": algorithm})

    found = bench_speedup(make, tmp_path, network=Network(latency_s=1e-4, bytes_per_s=1e9), cores=(1, 4), sleepers=(3,))
    for algorithm in ("shes", "es"):
        for name in ("measured_efficiency_1", "projected_efficiency_4", "error_measured_1", "error_asleep_3"):
            assert math.isfinite(found[f"{algorithm}_{name}"])
    rows = read_rows(tmp_path / "speedup.csv")
    here = [(kind, n) for kind in ("measured", "projected here") for n in range(1, workers + 1)]
    kinds = [*[("alone", 1)] * len(core_numbers()[:workers]), *here, ("projected", 1), ("projected", 4), ("asleep", 3),
             ("projected asleep", 3)]  # fmt: skip
    assert [(row["algorithm"], row["kind"], row["cores"]) for row in rows] == [
        (algorithm, *kind) for algorithm in ("shes", "es") for kind in kinds
    ]
    assert all(row["generation_s"] == pytest.approx(row["rollout_s"] + row["update_s"], rel=1e-4) for row in rows)
    assert (tmp_path / "speedup.png").read_bytes().startswith(b"\x89PNG")
    draw_speedup(rows[:3], tmp_path / "again.png")  # the figure is built from the table


@pytest.mark.parametrize(
    ("name", "value"),
    [("latency_us", -1), ("latency_us", math.inf), ("gigabits_per_s", 0), ("seconds", -1), ("seconds", math.nan)],
)
def test_an_argument_out_of_range_is_refused(name, value):
    with pytest.raises(ConfigError, match=rf"{name} must be .*positive number, got {value}\. Set --{name[:5]}"):
        bench("speedup", {}, "point-gather", **{name: value})


def test_a_device_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="bench speedup measures the CPU, got device"):
        speedup_of("point-gather", {"preset": "smoke", "device": "warp-cpu"}, tmp_path, 50, 10, 0.0)
