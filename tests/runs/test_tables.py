"""Tables and TensorBoard events: numbers that read back to the bit, whole rows, nothing of a generation done again."""

import csv
import errno
import math
import os
import struct
import threading
from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import rankdata
from tensorboardX.proto.event_pb2 import Event, SessionLog

from shes.algorithms.evolution.algorithm import GenerationReport, evolve, generation_work
from shes.algorithms.evolution.populations import Population
from shes.algorithms.worker import RolloutWorker
from shes.backends.serial import SerialBackend
from shes.errors import RunFolderError, StorageError
from shes.es.level import LevelState, LevelUpdate, TrainState, UpdateRule
from shes.es.novelty import NoveltyState
from shes.es.optimizers import Adam
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.episodes import Generation
from shes.hierarchy.population import Work
from shes.hierarchy.results import PopulationResults
from shes.runs.folder import RunFolder
from shes.runs.tables import CsvTable, Records, progress_row, read_csv
from shes.training.build import build_design, build_plan, build_settings, open_noise_table
from tests.e2e import runs


def report(noise_index, novelty=None, signs=None):
    """A generation of two members with two episodes each; the last episode diverged."""
    results = PopulationResults.empty(2, 2, 2)
    results.returns[:] = [[[1, 3], [5, 7]], [[-1, -3], [0, 0]]]
    results.score[:] = [[0, 1], [2, 3]]
    results.success[:] = [[False, True], [True, True]]
    results.steps[:] = [[10, 20], [30, 40]]
    results.has_terminated[:] = [[True, False], [False, False]]
    results.has_diverged[:] = [[False, False], [False, True]]
    results.goals_reached[:] = [[0, 1], [3, 1]]
    results.seconds[:] = [3.00004, 2, 1.5]
    levels = (level("controller", [3, 4]), level("primitive", [0, 0, 0, 0, 0]))
    updates = (
        LevelUpdate(level=levels[0], gradient_norm=0.25, halves_cosine=-0.5, update_ratio=0.125),
        LevelUpdate(level=levels[1]),
    )
    generation = Generation(levels=(), sigma=0.0625, episodes_per_policy=2, is_evaluation=False)
    work = Work(
        signs=np.ones((2, 1, 2), np.int8) if signs is None else signs,
        noise_index=np.array(noise_index),
        tasks=[],
        generation=generation,
    )
    return GenerationReport(
        state=TrainState(seed=0, generation=9, env_steps=1000, levels=levels, novelty=novelty),
        population=Population(
            work=work, results=results, rules=(UpdateRule(),) * 2, learns=(True, True), learning_rate=0.03125
        ),
        branches=None,
        updates=updates,
        rollout_s=1.25,
        update_s=0.5,
    )


def level(name, theta):
    start = Adam().start(len(theta))
    return LevelState(
        name=name, theta=np.array(theta, np.float32), optimizer=start, statistics=ObservationStatistics.empty(1)
    )


def test_a_row_holds_what_the_generation_saw():
    row = progress_row(report([[2, 2], [0, 4]]), wall_time_s=12.3456, generation_s=2.0)
    nothing = {name for name, value in row.items() if math.isnan(value)}
    assert nothing == {f"primitive_{name}" for name in ("gradient_norm", "halves_cosine", "update_ratio")}
    assert {name: value for name, value in row.items() if name not in nothing} == {
        "generation": 9,
        "env_steps": 1000,
        "wall_time_s": 12.346,
        "env_steps_per_s": 50.0,
        "controller_return_mean": 2.5,  # of the members' means: 2, and 3 because 7, diverged, counts as the worst, 1
        "controller_return_max": 3.0,
        "primitive_return_mean": -1.75,  # 0, diverged, counts as -3
        "primitive_return_max": -1.5,
        "score_mean": 1.5,
        "success_rate": 0.75,
        "episode_steps_mean": 25.0,
        "terminated_rate": 0.25,
        "diverged_rate": 0.25,
        "diverged_episodes": 1,
        "episodes_per_policy": 2,
        "sigma": 0.0625,
        "learning_rate": 0.03125,
        "goals_reached_mean": 1.25,
        "controller_noise_distinct": 1,
        "controller_noise_overlapping": 2,  # twice the same place
        "controller_rank_ties": 0.0,
        "controller_gradient_norm": 0.25,
        "controller_halves_cosine": -0.5,
        "controller_update_ratio": 0.125,
        "controller_theta_norm": 5.0,
        "primitive_noise_distinct": 2,
        "primitive_noise_overlapping": 2,  # 0 and 4 share a normal in vectors of 5
        "primitive_rank_ties": 0.0,
        "primitive_theta_norm": 0.0,
        "rollout_s": 1.25,
        "update_s": 0.5,
        "physics_s": 3.0,
        "policy_s": 2.0,
        "task_s": 1.5,
    }


def test_a_row_tells_how_the_search_for_novelty_stands():
    search = NoveltyState(archive=np.zeros((7, 2)), weight=0.75, best_return=-2.5, stalled=3)
    noise = [[2, 2], [0, 4]]
    plain, row = (progress_row(report(noise, novelty), 1.0, 1.0) for novelty in (None, search))
    assert {name: row[name] for name in row.keys() - plain.keys()} == {
        "novelty_weight": 0.75,
        "novelty_archive": 7,
        "novelty_best_return": -2.5,
    }


@pytest.mark.parametrize(
    ("returns", "share"),
    [
        ([1, 2, 3, 4], 0.0),
        ([1, 1, 1, 1], 1.0),
        ([1, 2, 1, 4], 0.5),
        ([2, 2, 7, 7], 1.0),
        ([0.0, -0.0, 3, 4], 0.5),
        ([1, 1, 1, 4], 0.75),
    ],
)
def test_rank_ties_are_the_share_of_members_whose_fitness_another_one_has(returns, share):
    made = report([[0], [0]], signs=np.ones((1, 4, 2), np.int8))
    results = PopulationResults.empty(2, 4, 1)
    results.returns[0, :, 0] = returns
    row = progress_row(replace(made, population=replace(made.population, results=results)), 1.0, 1.0)
    assert (row["controller_rank_ties"], row["primitive_rank_ties"]) == (share, 1.0)


def test_a_level_that_only_some_members_perturb_has_noise_and_ties_of_these_alone():
    signs = np.zeros((4, 1, 2), np.int8)
    signs[:2, :, 0] = 1  # half of the members perturb the controller, nobody the primitive
    made = report([[0, 9, 9, 9], [7, 7, 7, 7]], signs=signs)
    results = PopulationResults.empty(2, 4, 1)
    results.returns[0, :, 0] = [1, 2, 2, 2]
    row = progress_row(replace(made, population=replace(made.population, results=results)), 1.0, 1.0)
    assert (row["controller_noise_distinct"], row["controller_rank_ties"]) == (2, 0.0)
    assert (row["primitive_noise_distinct"], row["primitive_noise_overlapping"]) == (0, 0)
    assert math.isnan(row["primitive_rank_ties"])


def test_the_numbers_of_a_primitive_on_branches_are_those_of_its_pairs():
    """The returns, ties and noise of its level, and columns of their own; the other columns are whole episodes'."""
    plain = report([[2, 2], [0, 4]])
    results = PopulationResults.empty(1, 4, 1)
    results.returns[0, :, 0] = [1, 2, 2, 9]
    results.steps[:, 0] = [50, 50, 50, 30]
    results.has_terminated[3] = True
    results.seconds[:] = [1, 0.5, 0.25]
    generation = Generation(levels=(), sigma=0.3, episodes_per_policy=1, is_evaluation=False, branch_steps=50)
    work = Work(
        signs=np.array([[[1], [-1]]] * 2, np.int8), noise_index=np.array([[6, 8]]), tasks=[], generation=generation
    )
    pairs = Population(work=work, results=results, rules=(UpdateRule(),), learns=(True,), learning_rate=0.07)
    before, row = (progress_row(made, 1.0, 2.0) for made in (plain, replace(plain, branches=pairs)))
    changed = {name: value for name, value in row.items() if repr(value) != repr(before.get(name))}
    assert changed == {
        "env_steps_per_s": 140.0,
        "primitive_return_mean": 3.5,
        "primitive_return_max": 9.0,
        "primitive_rank_ties": 0.5,
        "branch_steps_mean": 45.0,
        "branch_terminated_rate": 0.25,
        "primitive_sigma": 0.3,
        "primitive_learning_rate": 0.07,
        "physics_s": 4.0,
        "policy_s": 2.5,
        "task_s": 1.75,
    }


# The columns of real runs, computed once more by other means.


def generation_by_hand(path, config, number):
    """Return the state before generation `number` of a run, its signs [G, M, L] and its noise [L, G]."""
    state = RunFolder.open(path).load(str(number - 1)).state
    settings = build_settings(config)
    work = generation_work(state, settings, config.evolution.noise_table_size)
    return state, work.signs, work.noise_index


@pytest.fixture(scope="module")
def every_generation(tmp_path_factory):
    """A run that keeps every checkpoint, with plain SGD: its step is the learning rate times the gradient.

    Its rewards are dense: of a sparse one, half a population may have no gradient at all.
    """
    path = tmp_path_factory.mktemp("every") / "run"
    changing = {
        "sigma_schedule": "linear",
        "sigma_end": 0.2,
        "learning_rate_schedule": "exponential",
        "learning_rate_end": 0.001,
    }
    plain = {"optimizer": "sgd", "momentum": 0.0, "weight_decay": 0.0, "population_size": 16, "sigma": 0.1}
    return runs.train_tiny(path, "point-maze", keep_checkpoints=1, schedule_generations=2, **plain, **changing)


def test_gradient_and_update_columns_are_what_the_checkpoints_say(every_generation):
    folder, table = RunFolder.open(every_generation), read_csv(every_generation / "progress.csv")
    for generation in (1, 2, 3, 4):
        before, after = (folder.load(str(number)).state.levels for number in (generation - 1, generation))
        rate = table["learning_rate"][generation - 1]
        for old, new in zip(before, after, strict=True):
            step = new.theta.astype(np.float64) - old.theta
            assert table[f"{old.name}_gradient_norm"][generation - 1] == pytest.approx(
                np.linalg.norm(new.optimizer.slots["velocity"].astype(np.float64)), rel=1e-5
            )
            assert table[f"{old.name}_gradient_norm"][generation - 1] == pytest.approx(
                np.linalg.norm(step) / rate, rel=1e-3
            )
            assert table[f"{old.name}_update_ratio"][generation - 1] == pytest.approx(
                np.linalg.norm(step) / np.linalg.norm(old.theta.astype(np.float64)), rel=1e-3
            )
            assert table[f"{old.name}_theta_norm"][generation - 1] == pytest.approx(np.linalg.norm(new.theta), rel=1e-6)


def test_schedules_are_in_the_table(every_generation):
    table = read_csv(every_generation / "progress.csv")
    np.testing.assert_allclose(table["sigma"], [0.1, 0.15, 0.2, 0.2])
    np.testing.assert_allclose(table["learning_rate"], [0.01, math.sqrt(0.01 * 0.001), 0.001, 0.001])
    assert table["episodes_per_policy"] == [1, 1, 1, 1]


def test_the_cosine_is_that_of_the_gradients_of_two_half_populations(every_generation):
    folder, table = RunFolder.open(every_generation), read_csv(every_generation / "progress.csv")
    config = folder.read_config()
    seen = {}

    class Listening(SerialBackend):
        def map(self, tasks):
            for task, result in zip(tasks, super().map(tasks), strict=True):
                for slot, returns in zip(task.slots, result.returns.T, strict=True):  # one episode a member
                    seen[task.member + slot] = returns
                yield result

    design = build_design(config)
    noise = open_noise_table(config, design)
    for generation in (1, 3):
        state, signs, noise_index = generation_by_hand(every_generation, config, generation)
        with Listening(partial(RolloutWorker, build_plan(config, design, noise))) as backend:
            next(evolve(state, build_settings(config), noise, backend))
        fitness = np.array([seen[member] for member in range(16)]).T
        groups, members, _ = signs.shape
        for i, level in enumerate(state.levels):
            ranks = rankdata(fitness[i]) / 15
            estimates = np.zeros((2, len(level.theta)))
            for group in range(groups):
                vector = noise.slice(int(noise_index[i, group]), len(level.theta))
                weight = sum(ranks[group * members + m] * signs[group, m, i] for m in range(members))
                estimates[group // (groups // 2)] += weight * vector.astype(np.float64)
            expected = estimates[0] @ estimates[1] / np.linalg.norm(estimates[0]) / np.linalg.norm(estimates[1])
            assert table[f"{level.name}_halves_cosine"][generation - 1] == pytest.approx(expected, abs=1e-4)
            counts = Counter(fitness[i].tolist())
            tied = sum(count for count in counts.values() if count > 1) / 16
            assert table[f"{level.name}_rank_ties"][generation - 1] == tied


@pytest.fixture(scope="module")
def in_turns(tmp_path_factory):
    """A run whose levels are perturbed in turns."""
    return runs.train_tiny(tmp_path_factory.mktemp("turns") / "run", "point-maze", perturbation="one_to_many")


def test_a_level_that_was_not_perturbed_has_no_gradient(in_turns):
    table = read_csv(in_turns / "progress.csv")
    for name in ("gradient_norm", "halves_cosine", "update_ratio"):
        assert [math.isnan(value) for value in table[f"controller_{name}"]] == [False, True, False, True]
        assert [math.isnan(value) for value in table[f"primitive_{name}"]] == [True, False, True, False]
    assert not any(math.isnan(value) for name in table if "theta" in name for value in table[name])


def test_tensorboard_gets_no_number_that_is_none(in_turns):
    found = scalars(in_turns / "tensorboard")
    assert all(math.isfinite(value) for _, _, value in found)
    steps = {step for tag, step, _ in found if tag == "progress/controller_gradient_norm"}
    assert steps == {1, 3}
    assert {step for tag, step, _ in found if tag == "progress/primitive_update_ratio"} == {2, 4}
    assert {step for tag, step, _ in found if tag == "progress/controller_theta_norm"} == {1, 2, 3, 4}


def test_the_time_of_an_evaluation_is_in_its_generations_row(tiny_run):
    """It is no part of the roll-out's time, nor of the steps per second."""
    table = read_csv(tiny_run / "progress.csv")
    assert [seconds > 0 for seconds in table["evaluation_s"]] == [True, True, False, True]
    assert table["evaluation_s"][2] == 0
    assert table["wall_time_s"][-1] >= sum(table["rollout_s"]) + sum(table["update_s"]) + sum(
        table["evaluation_s"][:-1]
    )


def test_the_parts_of_a_rollout_add_up_to_it(tmp_path):
    """In this process there is one worker: its parts are no more than the time of the roll-out, and most of it."""
    table = read_csv(runs.train_tiny(tmp_path / "run", horizon=200, evaluation_horizon=5) / "progress.csv")
    parts = sum(np.array(table[f"{name}_s"]) for name in ("physics", "policy", "task"))
    assert all(min(table[f"{name}_s"]) > 0 for name in ("physics", "policy", "task"))
    rollout = np.array(table["rollout_s"])
    assert (parts <= rollout + 1e-3).all()
    assert (parts[1:] >= 0.6 * rollout[1:]).all()  # the first one builds the environments


ONE_LEVEL = [("point-gather", {"algorithm": "es"}, "policy"), ("point-flagrun", {}, "primitive")]


@pytest.mark.parametrize(("env", "settings", "name"), ONE_LEVEL)
def test_a_run_of_one_level_has_the_columns_of_that_level_alone(tmp_path, env, settings, name):
    table = read_csv(runs.train_tiny(tmp_path / "run", env, generations=2, **settings) / "progress.csv")
    others = {"controller", "primitive", "policy"} - {name}
    assert {f"{name}_return_mean", f"{name}_halves_cosine", f"{name}_rank_ties", f"{name}_theta_norm"} <= set(table)
    assert not [
        column for column in table if column.startswith(tuple(f"{other}_" for other in others)) and column != "policy_s"
    ]
    assert ("goals_reached_mean" in table) is (name == "primitive")
    assert all(len(column) == 2 for column in table.values())


def test_goals_are_counted_once_each_time_they_are_reached(tmp_path):
    """Goals lie where the robot can be within a step: as many are reached as set, and no more."""
    near = {"goal_distance": 0.1, "minimum_goal_distance": False, "controller_interval": 5}
    table = read_csv(runs.train_tiny(tmp_path / "run", **near) / "progress.csv")
    assert table["goals_reached_mean"] == [4, 4, 4, 4]  # in 20 steps
    far = read_csv(runs.train_tiny(tmp_path / "far", goal_distance=1000.0) / "progress.csv")
    assert far["goals_reached_mean"] == [0, 0, 0, 0]


VALUES = [0.1 + 0.2, 1e-310, -0.0, 1.7976931348623157e308, math.inf, math.nan, 2.0**53 + 2]


def test_numbers_read_back_to_the_bit(tmp_path):
    table = CsvTable(tmp_path / "a.csv", 0)
    for generation, value in enumerate(VALUES, 1):
        table.add({"generation": generation, "x": value})
    read = read_csv(tmp_path / "a.csv")["x"]
    assert np.array(read).tobytes() == np.array(VALUES).tobytes()


def fill(path, last):
    table = CsvTable(path, 0)
    for generation in range(1, last + 1):
        table.add({"generation": generation, "x": generation / 3})
    return path.read_text()


def test_a_header_comes_once(tmp_path):
    path = tmp_path / "a.csv"
    whole = fill(path, 4)
    path.unlink()
    fill(path, 2)
    table = CsvTable(path, 2)
    for generation in (3, 4):
        table.add({"generation": generation, "x": generation / 3})
    assert path.read_text() == whole
    assert whole.startswith("generation,x\n1,0.333")


@pytest.mark.parametrize("more", ["", "5", "5,", "5,0.3", "5,0.3\n", "5,0.3\n6,0.1\n7"])
def test_rows_after_the_checkpoint_are_dropped_however_they_end(tmp_path, more):
    path = tmp_path / "a.csv"
    whole = fill(path, 4)
    with path.open("a") as file:
        file.write(more)
    CsvTable(path, 4)
    assert path.read_text() == whole


@pytest.mark.parametrize("length", range(0, 40, 3))
def test_a_table_cut_anywhere_goes_on_as_if_nothing_had_happened(tmp_path, length):
    """Half a header counts as none; half a row is of a generation that no checkpoint has."""
    path = tmp_path / "a.csv"
    whole = fill(path, 4)
    path.write_text(whole[:length])
    kept = max(0, whole[:length].count("\n") - 1)
    table = CsvTable(path, kept)
    for generation in range(kept + 1, 5):
        table.add({"generation": generation, "x": generation / 3})
    assert path.read_text() == whole


def test_a_damaged_table_is_refused_and_kept(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("generation,x\none,2\n")
    with pytest.raises(RunFolderError, match=r"a\.csv is damaged: .*'one'.*Restore it from a copy"):
        CsvTable(path, 4)
    assert path.read_text() == "generation,x\none,2\n"


@pytest.mark.parametrize("text", ["generation,x\n1,abc\n", "generation,x\n1\n"])
def test_a_table_that_holds_no_numbers_cannot_be_read(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(RunFolderError, match=r"a\.csv cannot be read as a table of numbers"):
        read_csv(path)


def test_a_table_without_rows_has_no_columns(tmp_path):
    with pytest.raises(RunFolderError, match=r"a\.csv cannot be read"):
        read_csv(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text("")
    assert read_csv(tmp_path / "a.csv") == {}


# TensorBoard.


def events(folder):
    """Return the events of all files of a folder, file after file, as TensorBoard reads them."""
    found = []
    for path in sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime_ns):
        data = path.read_bytes()
        while data:
            (length,) = struct.unpack("Q", data[:8])
            found.append(Event.FromString(data[12 : 12 + length]))
            data = data[16 + length :]
    return found


def scalars(folder):
    return [
        (event.summary.value[0].tag, event.step, event.summary.value[0].simple_value)
        for event in events(folder)
        if event.summary.value
    ]


@pytest.fixture
def folder(tmp_path):
    return RunFolder.create(tmp_path / "run")


def test_events_hold_every_column_by_generation(folder):
    records = Records(folder, 0)
    records.add_progress({"generation": 1, "x": 0.5, "y": 2})
    records.add_evaluation({"generation": 1, "score_mean": 1.5})
    records.close()
    assert scalars(folder.tensorboard) == [
        ("progress/x", 1, 0.5),
        ("progress/y", 1, 2.0),
        ("evaluation/score_mean", 1, 1.5),
    ]
    assert events(folder.tensorboard)[0].file_version == "brain.Event:2"


def test_a_run_that_goes_on_hides_later_events_and_keeps_earlier_files(folder):
    """Even within a second, which is all that the library's file names hold."""
    for generation in (0, 1):
        records = Records(folder, generation)
        records.add_progress({"generation": generation + 1, "x": generation + 0.5})
        records.close()
    assert len(list(folder.tensorboard.iterdir())) == 2
    assert sorted(scalars(folder.tensorboard)) == [("progress/x", 1, 0.5), ("progress/x", 2, 1.5)]
    starts = [e for e in events(folder.tensorboard) if e.session_log.status == SessionLog.START]
    assert [event.step for event in starts] == [2]


def test_events_need_no_thread(folder):
    before = threading.active_count()
    records = Records(folder, 0)
    records.add_progress({"generation": 1, "x": 0.5})
    assert threading.active_count() == before
    records.close()


def test_a_full_disk_is_told_at_once(folder, monkeypatch):
    records = Records(folder, 0)

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tensorboardX.record_writer.RecordWriter.write", full)
    with pytest.raises(StorageError, match=r"cannot write .*tensorboard: the disk is full"):
        records.add_progress({"generation": 1, "x": 0.5})
    records.close()


def test_the_tables_of_a_run_have_the_columns_of_the_design(tiny_run):
    with (tiny_run / "progress.csv").open(newline="") as file:
        progress = next(csv.reader(file))
    with (tiny_run / "evaluation.csv").open(newline="") as file:
        evaluation = next(csv.reader(file))
    assert progress[:8] == [
        "generation",
        "env_steps",
        "wall_time_s",
        "env_steps_per_s",
        "controller_return_mean",
        "controller_return_max",
        "primitive_return_mean",
        "primitive_return_max",
    ]
    assert evaluation[:6] == ["generation", "env_steps", "wall_time_s", "episodes", "score_mean", "score_std"]
    assert {"return_mean", "success_rate"} <= set(evaluation)
    assert read_csv(tiny_run / "progress.csv")["generation"] == [1, 2, 3, 4]
    assert read_csv(tiny_run / "evaluation.csv")["generation"] == [1, 2, 4]
    assert read_csv(tiny_run / "progress.csv")["env_steps"] == [160, 320, 480, 640]


def test_wall_time_goes_on_after_a_resume(run_copy):
    import shes

    shes.resume(run_copy, generations=6)
    times = read_csv(run_copy / "progress.csv")["wall_time_s"]
    assert len(times) == 6
    assert times == sorted(times)
