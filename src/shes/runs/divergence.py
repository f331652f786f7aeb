"""Generations in which every episode diverged: from them nothing is learned, so a run of them ends with an error."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from shes.errors import DivergenceError
from shes.runs.config import TrainConfig


class Divergence:
    """The diverged generations of a run during one call."""

    def __init__(self, config: TrainConfig) -> None:
        self._env, self._limit = config.run.env, config.run.max_diverged_generations
        self._in_a_row = 0
        self._is_any_sound = False

    def add(self, row: Mapping[str, Any]) -> str | None:
        """Count a generation by its row of `progress.csv`; return a warning if all its episodes diverged."""
        returns = [value for name, value in row.items() if name.endswith("_return_mean")]
        has_returns = not returns or any(map(math.isfinite, returns))
        if has_returns and row.get("diverged_rate") != 1:
            self._in_a_row, self._is_any_sound = 0, True
            return None
        self._in_a_row += 1
        if not has_returns:
            return f"no return of generation {row['generation']} is finite: nothing can be learned from it"
        episodes = f"all {row['diverged_episodes']} episodes" if "diverged_episodes" in row else "every episode"
        return (
            f"{episodes} of generation {row['generation']} diverged (physics, observation or reward not finite): "
            "nothing can be learned from it"
        )

    def check(self, *, is_over: bool) -> None:
        """Raise DivergenceError if every episode of the last `max_diverged_generations` has diverged.

        If the run ends here, also if every episode since its start has.
        """
        is_never_sound = is_over and self._in_a_row > 0 and not self._is_any_sound
        if self._in_a_row < self._limit and not is_never_sound:
            return
        raise DivergenceError(
            f"every episode of the last {self._in_a_row} generation{'s' * (self._in_a_row > 1)} diverged. Likely "
            f"cause: a reward or an observation of {self._env} is NaN or infinite, or its physics is unstable. Check "
            "what its reset and step return. Everything up to the last checkpoint is kept; "
            "--max-diverged-generations sets after how many such generations a run ends."
        )
