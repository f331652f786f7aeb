"""The tasks of a generation: whose noise, which signs, whose episodes; and whose observations count."""

from dataclasses import replace

import numpy as np
import pytest

from shes.es.level import LevelState, TrainState, draw_noise_index
from shes.es.optimizers import Adam
from shes.es.perturbation import PERTURBATIONS
from shes.es.statistics import ObservationStatistics
from shes.es.streams import Purpose, stream
from shes.hierarchy.population_tasks import COMMON_RANDOM_NUMBERS, members_per_lane, population_tasks

DIMS = (3, 5)
TABLE_SIZE = 50_000


def _state(seed=3, generation=2):
    levels = tuple(
        LevelState(
            name=f"level_{i}",
            theta=np.zeros(dim, np.float32),
            optimizer=Adam().start(dim),
            statistics=ObservationStatistics.empty(dim),
        )
        for i, dim in enumerate(DIMS)
    )
    return TrainState(seed=seed, generation=generation, env_steps=0, levels=levels)


def _tasks(population=8, episodes=2, perturbation="many_to_many", mirrored="quad", generation=2, seed=3, **options):
    signs = PERTURBATIONS.find(perturbation)().signs(generation, population, mirrored, (True, True))
    index = draw_noise_index(seed, generation, len(signs), DIMS, TABLE_SIZE)
    return _members(population_tasks(_state(seed, generation), signs, index, episodes, **options), episodes)


def _members(tasks, episodes):
    """Return a task for every member, whoever shared one."""
    alone = []
    for task in tasks:
        assert task.slots == tuple(range(len(task.signs) * episodes))
        for m, signs in enumerate(task.signs):
            seeds = task.seeds[m * episodes : (m + 1) * episodes]
            slots = tuple(range(episodes))
            alone.append(replace(task, member=task.member + m, signs=(signs,), seeds=seeds, slots=slots))
    return alone


OFF = [
    (955642397323993634, 2014679973056780978),
    (8914204979365002629, 3964493793996861818),
    (8915728941045978542, 4561075043264217392),
    (3782129793030925514, 5064926260752203158),
    (2347052567673787738, 8818525889307932742),
    (11036241398736512, 5907576227758005346),
    (6923016666289185934, 277484131316371652),
    (7250926677718418429, 2592574282718894118),
]
"""What eight members drew, each its own, before anything could be chosen; two groups drew the first two rows."""


@pytest.mark.parametrize(
    ("common_random_numbers", "seeds"),
    [("off", OFF), ("group", [OFF[0]] * 4 + [OFF[1]] * 4), ("population", [OFF[0]] * 8)],
)
def test_seeds_are_those_that_they_have_always_been(common_random_numbers, seeds):
    tasks = _tasks(common_random_numbers=common_random_numbers)
    assert [task.seeds for task in tasks] == seeds
    assert [task.noise_index for task in tasks] == [(41949, 28591)] * 4 + [(35608, 23554)] * 4


@pytest.mark.parametrize(("mirrored", "members"), [("quad", 4), ("pair", 2), ("none", 1)])
@pytest.mark.parametrize(("name", "shape"), [("off", (True, True)), ("group", (True, False))])
def test_seeds_are_a_single_draw_of_the_generations_stream(name, shape, mirrored, members):
    groups = 12 // members
    drawn = stream(7, Purpose.TRAINING_EPISODES, 5).integers(0, 2**63, (groups, members if shape[1] else 1, 3))
    expected = [tuple(drawn[g, m if shape[1] else 0].tolist()) for g in range(groups) for m in range(members)]
    tasks = _tasks(12, 3, mirrored=mirrored, generation=5, seed=7, common_random_numbers=name)
    assert [task.seeds for task in tasks] == expected


@pytest.mark.parametrize("perturbation", ["many_to_many", "one_to_many", "one_to_many_halves"])
@pytest.mark.parametrize("name", COMMON_RANDOM_NUMBERS)
def test_who_shares_episodes(name, perturbation):
    seeds = [task.seeds for task in _tasks(16, 3, perturbation=perturbation, common_random_numbers=name)]
    members = 4 if perturbation == "many_to_many" else 2
    distinct = {"off": 16, "group": 16 // members, "population": 1}[name]
    assert len(set(seeds)) == distinct
    assert len({seed for each in seeds for seed in each}) == distinct * 3  # and no two episodes are one
    if name == "group":
        assert all(len(set(seeds[g : g + members])) == 1 for g in range(0, 16, members))


@pytest.mark.parametrize("name", COMMON_RANDOM_NUMBERS)
def test_every_generation_and_every_run_has_other_episodes(name):
    places = [(3, 2), (3, 3), (4, 2)]
    drawn = [
        {seed for task in _tasks(generation=generation, seed=seed, common_random_numbers=name) for seed in task.seeds}
        for seed, generation in places
    ]
    assert len(set.union(*drawn)) == sum(len(seeds) for seeds in drawn)


def test_who_shares_episodes_changes_neither_noise_nor_statistics():
    plain, *others = (
        [(t.member, t.noise_index, t.signs, t.slots, t.records_statistics) for t in _tasks(
            40, common_random_numbers=name, statistics_fraction=0.5)]
        for name in COMMON_RANDOM_NUMBERS
    )  # fmt: skip
    assert others == [plain, plain]


@pytest.mark.parametrize("perturbation", ["many_to_many", "one_to_many", "one_to_many_halves"])
def test_tasks_say_who_perturbs_how(perturbation):
    signs = PERTURBATIONS.find(perturbation)().signs(1, 8, "quad", (True, True))
    index = draw_noise_index(3, 1, len(signs), DIMS, TABLE_SIZE)
    tasks = population_tasks(_state(generation=1), signs, index, 3)
    assert [task.member for task in tasks] == list(range(8))
    assert [task.signs for task in tasks] == [(tuple(row),) for row in signs.reshape(8, 2).tolist()]
    for member, task in enumerate(tasks):
        assert task.noise_index == tuple(index[:, member // signs.shape[1]].tolist())
        assert task.slots == (0, 1, 2)
        assert all(type(number) is int for number in (*task.noise_index, *task.signs[0], *task.seeds))


@pytest.mark.parametrize(("episodes", "shared"), [(1, 4), (2, 4), (3, 1), (5, 1)])
def test_members_with_few_episodes_share_a_task_with_their_group(episodes, shared):
    signs = PERTURBATIONS.find("many_to_many")().signs(1, 16, "quad", (True, True))
    index = draw_noise_index(3, 1, len(signs), DIMS, TABLE_SIZE)
    tasks = population_tasks(_state(generation=1), signs, index, episodes)
    assert members_per_lane(4, episodes) == shared
    assert members_per_lane(1, episodes) == 1
    assert [task.member for task in tasks] == list(range(0, 16, shared))
    for task in tasks:
        assert task.signs == tuple(map(tuple, signs.reshape(16, 2)[task.member : task.member + shared].tolist()))
        assert len(task.seeds) == len(task.slots) == shared * episodes


@pytest.mark.parametrize("fraction", [0.0, 0.3, 1.0])
def test_a_share_of_the_groups_is_recorded_as_a_whole(fraction):
    groups = []
    for generation in range(10):
        flags = [task.records_statistics for task in _tasks(80, generation=generation, statistics_fraction=fraction)]
        assert all(len(set(flags[g : g + 4])) == 1 for g in range(0, 80, 4))
        groups += flags[::4]
    assert np.mean(groups) == pytest.approx(fraction, abs=0.1 if 0 < fraction < 1 else 0)
