"""Random streams: the only place where they derive from seeds.

Every random number of a run derives from its seed, a purpose and a generation. A generation draws the seed of each
episode, from which the random numbers of the episode derive.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """Purpose of a random stream. The values determine a run's numbers and must not be changed."""

    INITIAL_PARAMETERS = 0
    NOISE_INDEX = 1
    TRAINING_EPISODES = 2
    EVALUATION_EPISODES = 3
    STATISTICS_SAMPLE = 4
    FRESH_EPISODES = 5
    SNAPSHOTS = 7
    BRANCHES = 8
    EXPLORATION = 9
    REPLAY = 10
    ARCHIVE = 11
    STARTS = 12


class EpisodePurpose(IntEnum):
    """Purpose of a random stream of one episode. The values determine a run's numbers and must not be changed."""

    RESET = 0
    EXPLORATION_NOISE = 1
    RANDOM_GOALS = 2
    WANDERING = 3


def stream(seed: int, purpose: Purpose | EpisodePurpose, *key: int) -> np.random.Generator:
    """Return the generator of a run, whose `key` is a generation, then a level or a task, or of an episode."""
    return _generator(seed, int(purpose), *key)


def table_stream(seed: int, block: int) -> np.random.Generator:
    """Return the generator of a block of the noise table."""
    return _generator(seed, block)


def _generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
