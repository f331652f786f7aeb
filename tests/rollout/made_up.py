"""Made-up tasks of a population, and made-up results of them."""

from itertools import islice

import numpy as np

from shes.es.statistics import Moments
from shes.rollout.episodes import EpisodeResults, EpisodeTask, empty_outcomes

SIZES = (2, 4)
"""Values that each level observes."""


def taking(numbered):
    """Return a function that takes up to so many of these tasks."""
    left = iter(numbered)
    return lambda room: list(islice(left, room))


def make_task(member, seeds, **changes):
    """Return the task of a member; every second one records."""
    task = {
        "member": member,
        "noise_index": (member, 2 * member),
        "signs": ((1, -1),),
        "slots": tuple(range(len(seeds))),
        "seeds": tuple(seeds),
        "records_statistics": member % 2 == 0,
    }
    return EpisodeTask(**{**task, **changes})


def outcomes(returns, **quantities):
    """Return outcomes of K episodes with these `returns` [K, L] and other quantities [K, ...]."""
    made = empty_outcomes(returns.shape[1], len(returns))
    for name, values in {"returns": returns, **quantities}.items():
        made[name] = values
    return made


def make_result(task, seed=0, log=()):
    """Return made-up results that depend on member and slot alone."""
    rows = [np.random.default_rng([seed, task.member, slot]) for slot in task.slots]
    made = empty_outcomes(2, len(rows))
    for name in made.dtype.names:
        made[name] = [rng.integers(-9, 9, made[name].shape[1:]) % (2 if name.startswith("has") else 99) for rng in rows]
    moments = tuple(
        Moments(
            count=np.array([int(rng.integers(1, 9)) for rng in rows]),
            total=np.array([rng.normal(size=size) for rng in rows]),
            total_squares=np.array([rng.normal(size=size) ** 2 for rng in rows]),
        )
        for size in SIZES
    )
    return EpisodeResults(
        outcomes=made,
        seconds=np.array([1.0, 0.5, 0.25]),
        moments=moments if task.records_statistics else None,
        log=log,
    )
