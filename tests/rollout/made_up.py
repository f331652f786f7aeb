"""Made-up tasks of a population, and made-up outcomes of them."""

from itertools import islice

from shes.rollout.episodes import EpisodeTask, empty_outcomes


def taking(numbered):
    """Return a function that takes up to so many of these tasks."""
    left = iter(numbered)
    return lambda room: list(islice(left, room))


def make_task(member, seeds):
    """Return the task of a member."""
    slots = tuple(range(len(seeds)))
    noise_index = (member, 2 * member)
    return EpisodeTask(member=member, noise_index=noise_index, signs=((1, -1),), slots=slots, seeds=tuple(seeds))


def outcomes(returns, **quantities):
    """Return outcomes of K episodes with these `returns` [K, L] and other quantities [K, ...]."""
    made = empty_outcomes(returns.shape[1], len(returns))
    for name, values in {"returns": returns, **quantities}.items():
        made[name] = values
    return made
