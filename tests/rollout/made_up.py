"""Made-up tasks of a population, and made-up outcomes of them."""

from itertools import islice

from shes.rollout.episodes import EpisodeTask, empty_outcomes


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
