"""The rollout on a task without physics: what a plain loop makes of each task, in whatever lanes and company."""

import random
from dataclasses import replace

import numpy as np
import pytest

from shes.errors import PolicyError
from shes.es.noise import NoiseTable
from shes.rollout.episodes import EpisodeTask, Generation
from shes.rollout.lockstep import Rollout
from tests.messages import raises
from tests.rollout import designs
from tests.rollout.fake_task import FakeEnvironment, FakeTask, make_seed
from tests.rollout.formula import bits
from tests.rollout.made_up import taking
from tests.rollout.plain_loop import assert_equal, play

HORIZON = 23
EPISODES = 3
DESIGN = designs.both(hidden=(16,))
FREE, GOALS = FakeEnvironment(), FakeEnvironment(goal_interval=designs.INTERVAL)
TRAINING = {"sigma": 0.2, "episodes_per_policy": EPISODES}
EVALUATION = {**TRAINING, "kind": "evaluation"}
GROUPS = {**TRAINING, "episodes_per_policy": 1, "members_per_lane": 4}
CASES = {
    "both": (DESIGN, FREE, TRAINING),
    "evaluation": (designs.both("one_hot", clock=designs.CLOCK, is_minimum=False, distance=1.0), FREE, EVALUATION),
    "frozen control": (designs.both("direction", reward="metres"), FREE, {**TRAINING, "has_frozen_control": True}),
    "one episode": (DESIGN, FREE, {**TRAINING, "episodes_per_policy": 1}),  # another path through BLAS
    "groups": (DESIGN, FREE, GROUPS),
    "groups, two episodes": (designs.flat(designs.CLOCK), FREE, {**GROUPS, "episodes_per_policy": 2}),
    "alone": (designs.primitive("vector", "cosine", designs.CLOCK), GOALS, TRAINING),
    "flat": (designs.flat(), FREE, TRAINING),
    "every step": (designs.both(controller_interval=1), FREE, TRAINING),
    "once": (designs.both(controller_interval=100), FREE, TRAINING),
    **{f"{decisions} decisions": (DESIGN, FREE, {**EVALUATION, "decisions": decisions})
       for decisions in ("zero", "random", "wander", 0.5)},
    "wander in training": (DESIGN, FREE, {**TRAINING, "decisions": "wander"}),
}  # fmt: skip
"""Designs, environments, and generations."""


def table_of(size=2000):
    return NoiseTable(np.random.default_rng(0).standard_normal(size, dtype=np.float32))


def generation_of(design=DESIGN, of=TRAINING, scale=1.0):
    return Generation(levels=designs.levels_of(design, scale), **of)


def tasks_of(design=DESIGN, of=TRAINING, number=10):
    """Return tasks whose episodes end in every way, with every sign; every fifth records nothing."""
    rng, members = random.Random(0), of.get("members_per_lane", 1)  # noqa: S311 - seeds of a test
    signs = [(1, 1), (1, -1), (-1, 1), (-1, -1), (0, 1), (0, 0)]
    levels, slots = len(design.dims), tuple(range(members * of["episodes_per_policy"]))
    return [
        EpisodeTask(
            member=members * m,
            noise_index=(7 * m, 100 + 11 * m)[:levels],
            signs=tuple(signs[(m + i) % 6][:levels] for i in range(members)),
            slots=slots,
            seeds=tuple(rng.randrange(2**63) for _ in slots),
            records_statistics=m % 5 > 0,
        )
        for m in range(number)
    ]


def rollout_of(lanes=1, design=DESIGN, of=TRAINING, make=FREE.make):
    members, episodes = of.get("members_per_lane", 1), of["episodes_per_policy"]
    return Rollout(design, make, lanes, members * episodes, HORIZON, members)


def results_of(rollout, tasks, generation=None, table=None):
    """Return the results by the tasks' first members; each comes once."""
    done = list(rollout.run(taking(enumerate(tasks)), generation or generation_of(), table or table_of()))
    assert sorted(number for number, _ in done) == list(range(len(tasks)))
    return {tasks[number].member: results for number, results in done}


@pytest.mark.parametrize("name", CASES)
def test_every_task_has_the_numbers_of_a_plain_loop(name):
    """In one lane and in many, in any order and company, whole and in parts, whatever the rollout did before."""
    design, environment, of = CASES[name]
    tasks, generation = tasks_of(design, of), generation_of(design, of)
    parts = [
        replace(task, slots=slots, seeds=tuple(task.seeds[slot] for slot in slots))
        for task, slots in zip(tasks, ((0,), (2, 0), (1,)), strict=False)
        if max(slots) < len(task.slots)
    ]
    played = {
        (task.member, task.slots): play(design, environment.make, task, generation, table_of(), HORIZON)
        for task in (*tasks, *parts)
    }
    for lanes, some in ((1, tasks[:2]), (3, tasks), (12, tasks[::-2])):
        rollout = rollout_of(lanes, design, of, environment.make)
        for again in range(2):
            found = results_of(rollout, some, generation)
            for task in some:
                assert (found[task.member].moments is None) == (not task.records_statistics)
                assert_equal(found[task.member], played[task.member, task.slots])
            if not again:
                results_of(rollout, some[:2], generation_of(design, EVALUATION | of, scale=3))
    for part in parts:
        assert_equal(results_of(rollout, [part], generation)[part.member], played[part.member, part.slots])
    if name == "both":
        every = np.concatenate([each.outcomes for each in played.values()])
        ends = {(*end, fall == 1) for *end, fall in every[["has_terminated", "has_diverged", "fall"]].tolist()}
        assert {(False, False, False), (True, False, False), (False, True, False), (True, False, True)} == ends
        assert len(np.unique(every["fall"])) > len(every) / 2  # the greatest tilt of each episode
        assert len(np.unique(every["returns"], axis=0)) == sum(len(task.slots) for task in tasks)
        assert every["goals_reached"].any()


def test_tasks_are_taken_when_a_lane_is_free():
    taken, seen, of = [], [], {**TRAINING, "episodes_per_policy": 1}
    ends = [make_seed(), *[make_seed(terminates_after=2)] * 3]

    def work():
        for number, (task, seed) in enumerate(zip(tasks_of(of=of), ends, strict=False)):
            taken.append(10 * number)
            yield 10 * number, replace(task, seeds=(seed,))

    for number, _ in rollout_of(2, of=of).run(taking(work()), generation_of(of=of), table_of()):
        seen.append((number, len(taken)))
    assert seen == [(10, 2), (20, 3), (30, 4), (0, 4)]
    assert results_of(rollout_of(3), []) == {}


def test_a_policy_of_nan_is_refused_by_member_and_level():
    message = "member 3 returned NaN or infinity at step 0 (parameters of its controller are not finite) ... --sigma"
    table = table_of(8000)
    tasks = [replace(task, noise_index=(500 * m, 4000), signs=((1, 1),)) for m, task in enumerate(tasks_of()[:4])]
    table.values[1500 + DESIGN.dims[0] - 1] = np.nan
    rollout, sound = rollout_of(4), tasks_of()
    for order in (tasks, tasks[::-1]):
        with raises(PolicyError, message):
            results_of(rollout, order, table=table)
        for some in (sound[:1], sound):  # it works again; lanes without work may be left with anything
            assert bits(results_of(rollout, some)) == bits(results_of(rollout_of(3), some))
    group, generation = tasks_of(of=GROUPS)[3], generation_of(of=GROUPS)
    generation.levels[1].theta[0] = np.nan
    with raises(PolicyError, "member 14 ... parameters of its primitive are not finite"):
        results_of(rollout_of(2, of=GROUPS), [replace(group, slots=(2,), seeds=group.seeds[2:3])], generation)


def test_an_observation_of_nan_does_not_blame_parameters():
    def on_step(task, *_):
        task.observes_nan[4] = task.age[4] == 6

    seeds = [tuple(make_seed(draw=10 * m + k) for k in range(3)) for m in range(len(tasks_of()))]
    tasks = [replace(task, seeds=own) for task, own in zip(tasks_of(), seeds, strict=True)]
    with raises(PolicyError, f"member 9 returned NaN ... at step 7; episode seed {tasks[9].seeds[1]}."):
        results_of(rollout_of(2, make=lambda n: FakeTask(n, on_step)), tasks[8:10])
