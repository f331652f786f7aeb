"""A population: what is drawn for its members, how tasks are divided, and what results are worth to each level."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.es.level import UpdateRule
from shes.es.perturbation import PERTURBATIONS, member_signs
from shes.evolution.estimates import draw_episodes
from shes.rollout.episodes import empty_outcomes
from shes.rollout.roll_out import PopulationResults, divide
from tests.es.textbook import centred_ranks, group_signs
from tests.rollout.formula import evolving, formula_state
from tests.rollout.made_up import make_task


def drawn(population=8, episodes=2, perturbation="many_to_many", generation=2, seed=3, **options):
    """Return the members of a generation and, per member, its task's quantities."""
    settings = evolving(population_size=population, episodes_per_policy=episodes, **options)
    settings = replace(settings, perturbation=perturbation)
    draws, members = draw_episodes(replace(formula_state(), generation=generation, seed=seed), settings, 50_000), []
    for task in draws.tasks:
        assert task.slots == tuple(range(len(task.signs) * episodes))
        assert all(type(number) is int for number in (*task.noise_index, *task.signs[0], *task.seeds))
        for m, signs in enumerate(task.signs):
            assert task.member + m == len(members)
            seeds = task.seeds[m * episodes : (m + 1) * episodes]
            members.append((seeds, task.noise_index, signs, task.records_statistics))
    return draws, members


def numbers_of(key, draw):
    """Return what NumPy draws from the stream of seed 3, a purpose and a generation."""
    return draw(np.random.Generator(np.random.PCG64(np.random.SeedSequence(3, spawn_key=key)))).tolist()


@pytest.mark.parametrize("name", ["off", "group", "population"])
@pytest.mark.parametrize("perturbation", PERTURBATIONS)
@pytest.mark.parametrize("mirrored", ["quad", "pair", "none"])
@pytest.mark.parametrize("episodes", [2, 3])
def test_members_are_drawn_from_the_streams_of_their_generation(name, perturbation, mirrored, episodes):
    draws, members = drawn(16, episodes, perturbation, mirrored=mirrored, common_random_numbers=name)
    groups, size, _ = draws.signs.shape
    assert draws.signs.tolist() == [list(map(list, group)) for group in
                                    group_signs(mirrored, perturbation, (True, True), groups, 2)]  # fmt: skip
    assert [list(signs) for _, _, signs, _ in members] == draws.signs.reshape(16, 2).tolist()
    shape = {"off": (groups, size), "group": (groups, 1), "population": (1, 1)}[name]
    seeds = np.array(numbers_of((2, 2), lambda rng: rng.integers(0, 2**63, (*shape, episodes))))
    seeds = np.broadcast_to(seeds, (groups, size, episodes)).reshape(16, episodes)
    assert [list(member[0]) for member in members] == seeds.tolist()
    noise = [numbers_of((1, 2, level), lambda rng, dim=dim: rng.integers(0, 50_001 - dim, groups))
             for level, dim in enumerate((3, 5))]  # fmt: skip
    assert draws.noise_index.tolist() == noise
    assert [list(member[1]) for member in members] == np.repeat(noise, size, axis=1).T.tolist()
    # Members with few episodes share a task with their group: a matmul each would have few rows.
    shared = size if episodes < 3 else 1
    assert {len(task.signs) for task in draws.tasks} == {draws.generation.members_per_lane} == {shared}


@pytest.mark.parametrize("fraction", [0.0, 0.3, 1.0])
def test_a_share_of_the_groups_is_recorded_as_a_whole(fraction):
    flags = [member[3] for generation in range(10)
             for member in drawn(80, generation=generation, statistics_fraction=fraction)[1]]  # fmt: skip
    assert all(len(set(flags[g : g + 4])) == 1 for g in range(0, 800, 4))
    assert np.mean(flags) == pytest.approx(fraction, abs=0.1 if 0 < fraction < 1 else 0)
    assert flags[160:240:4] == numbers_of((4, 2), lambda rng: rng.random(20) < fraction)


def test_a_divergence_counts_as_the_worst_of_the_others_at_most():
    for returns, has_diverged, fitness in (
        ([[-3, -5], [-1, -4], [-6, -3]], [[0, 0], [1, 0], [0, 0]], [-4, -5, -4.5]),
        ([[3], [-9], [4]], [[0], [1], [0]], [3, -9, 4]),  # it is never raised
        ([[3], [-9]], [[1], [1]], [3, -9]),  # there is nothing to compare with
        ([[1, 3], [0, 2]], [[0, 0], [0, 0]], [2, 1]),
    ):
        results = PopulationResults(outcomes=empty_outcomes(2, len(returns), len(returns[0])))
        results.returns[:] = returns, np.add(returns, 100)  # each level has its own worst
        results.has_diverged[:] = has_diverged
        assert results.fitness.tolist() == [fitness, np.add(fitness, 100).tolist()]
        assert results.returns[0].tolist() == returns  # what is reported stays what it was


@pytest.mark.parametrize("price", [0.0, 2.5])
def test_a_level_is_worth_the_ranks_of_those_who_perturb_it(price):
    """A fall takes its price off, in the mean over these members nothing."""
    (fitness, fallen), rule = np.random.default_rng(3).random((2, 8)), UpdateRule(fall_price=price)
    signs = member_signs("one_to_many_halves", "quad", 8, (True, True), 0)
    for level, own in enumerate(([0, 1, 2, 3], [4, 5, 6, 7])):
        expected = np.array(centred_ranks(fitness[own].tolist(), "average"))
        expected -= price * (fallen[own] - fallen[own].mean())
        assert rule.shape(fitness, signs[:, :, level], fallen) == pytest.approx(expected)


@given(sizes=st.lists(st.integers(1, 6), max_size=20), num_workers=st.integers(1, 60))
def test_every_episode_is_in_one_part_and_in_order(sizes, num_workers):
    tasks = [make_task(member, range(size)) for member, size in enumerate(sizes)]
    parts = divide(tasks, num_workers)
    kept = [(part.member, slot, seed) for part in parts for slot, seed in zip(part.slots, part.seeds, strict=True)]
    assert kept == [
        (task.member, slot, seed) for task in tasks for slot, seed in zip(task.slots, task.seeds, strict=True)
    ]
    assert all(part.slots for part in parts)


@pytest.mark.parametrize(
    ("num_tasks", "size", "num_workers", "part"),
    [
        (250, 20, 2, 20),
        (250, 20, 240, 5),  # five parts each: whole tasks would be two for some, and leave others idle
        (250, 20, 250, 20),
        (250, 20, 600, 10),
        (1, 20, 2, 10),
        (1, 20, 60, 1),
    ],
)
def test_tasks_are_as_small_as_workers_need_them(num_tasks, size, num_workers, part):
    parts = divide([make_task(member, range(size)) for member in range(num_tasks)], num_workers)
    assert {len(each.slots) for each in parts} == {part}
