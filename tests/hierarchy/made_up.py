"""Made-up tasks of a population, and made-up results of them."""

import numpy as np

from shes.hierarchy.episodes import EpisodeResults, EpisodeTask, empty_outcomes
from shes.hierarchy.moments import Moments

SIZES = (2, 4)
"""Values that each level observes."""


def make_task(member, seeds, **changes):
    """Return the task of a member; every second one records."""
    return EpisodeTask(
        **{
            "member": member,
            "noise_index": (member, 2 * member),
            "signs": ((1, -1),),
            "slots": tuple(range(len(seeds))),
            "seeds": tuple(seeds),
            "records_statistics": member % 2 == 0,
            **changes,
        }
    )


def population(members, episodes):
    """Return the tasks of a population whose seeds say where they belong."""
    return [make_task(m, [1000 * m + e for e in range(episodes)]) for m in range(members)]


def outcomes(returns, **quantities):
    """Return outcomes of K episodes with these `returns` [K, L] and other quantities [K, ...]."""
    made = empty_outcomes(returns.shape[1], len(returns))
    for name, values in {"returns": returns, **quantities}.items():
        made[name] = values
    return made


def make_result(task, seed=0, log=()):
    """Return made-up results that depend on member and slot alone."""
    rows = [np.random.default_rng([seed, task.member, slot]) for slot in task.slots]

    def draw(*shape):
        return np.array([rng.normal(size=shape) for rng in rows])

    moments = tuple(
        Moments(
            count=np.array([int(rng.integers(1, 9)) for rng in rows]), total=draw(size), total_squares=draw(size) ** 2
        )
        for size in SIZES
    )
    return EpisodeResults(
        outcomes=outcomes(
            returns=draw(2),
            score=draw(),
            success=draw() > 0,
            steps=np.array([int(rng.integers(1, 500)) for rng in rows]),
            has_terminated=draw() > 0,
            has_fallen=draw() > 0,
            has_diverged=draw() > 0,
            goals_reached=np.array([int(rng.integers(0, 20)) for rng in rows]),
            final_position=draw(2),
            environment_returns=draw(),
        ),
        seconds=np.array([1.0, 0.5, 0.25]),
        moments=moments if task.records_statistics else None,
        log=log,
    )
