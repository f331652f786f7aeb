"""`shes compare`: the difference between two runs, or two groups of repetitions, with an interval and a p value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal

import numpy as np

from shes.errors import ConfigError, MissingExtraError, ShesError
from shes.runs.config import TrainConfig
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.runs_folder import find_runs
from shes.settings import Ge, checked
from shes.types import F64Array, Listing, Table

MEASURES = {"score": "scores", "return": "returns", "success": "successes"}
"""Measures that can be compared: name -> field of `Evaluation`."""
_DIVISIONS = 10_000  # divisions into two samples up to which all are counted, for a test of means
_DIGITS = 12  # to this many digits, differences of means do not depend on the order of summation


@dataclass(frozen=True, kw_only=True)
class RunComparison:
    """The comparison of two runs over episodes, or of two groups of runs over runs."""

    first: str
    second: str
    measure: str
    unit: str
    """Unit of the samples: `runs`, or `episodes` of a single run on each side."""
    first_count: int
    """Number of runs or episodes."""
    second_count: int
    first_mean: float
    second_mean: float
    difference: float
    """Second minus first mean."""
    low: float
    """Lower end of the 95 % interval of the difference (Welch's t)."""
    high: float
    p: float
    """Two-sided p of a permutation test of the difference."""

    def listing(self) -> Listing:
        """Return the means, the difference, its interval and p."""
        rows = [
            (self.first, f"{self.first_mean:.3f}", str(self.first_count)),
            (self.second, f"{self.second_mean:.3f}", str(self.second_count)),
        ]
        interval = f"95 % interval [{self.low:+.3f}, {self.high:+.3f}]"
        parts = [
            Table(("run", f"mean {self.measure}", self.unit), rows),
            f"difference {self.difference:+.3f}, {interval}, p {self.p:.4f}",
        ]
        if self.unit == "episodes":
            parts.append(
                "Over episodes: this says nothing of other seeds of training. Compare folders of several seeds for "
                "that."
            )
        return Listing(asdict(self), parts)


@checked
def compare(
    first: Path | str,
    second: Path | str,
    *,
    episodes: Annotated[int, Ge(2)] = 50,
    checkpoint: str = "best",
    measure: Literal["score", "return", "success"] = "score",
    num_workers: int = 0,
    seed: Annotated[int, Ge(0)] = 0,
) -> RunComparison:
    """Compare two runs, or two folders of runs that differ in the seed, on the same fresh episodes.

    The interval of the difference is Welch's; p is that of a permutation test. Needs SciPy (extra compare).

    With several runs on each side, the samples are the means of the runs: the result holds for other seeds of training,
    too. With one run on each side, they are its episodes: the result holds for these two agents alone.

    shes compare runs/base runs/sweep/sigma-0.05

    Args:
        first: A run folder, a folder of runs that differ in the seed only, or a shipped agent.
        second: The run, folder of runs or agent to compare with FIRST.
        episodes: Number of episodes of each run.
        checkpoint: Checkpoint: `best`, `last` or the number of a generation.
        measure: What is compared.
        num_workers: Worker processes; 0 is one for every core.
        seed: Seed of the episodes.
    """
    check_scipy()
    sides = [_repetitions(each) for each in (first, second)]
    counts = [len(side) for side in sides]
    if (counts[0] == 1) != (counts[1] == 1):
        raise ConfigError(
            f"one run cannot be compared with several: {first} has {counts[0]} and {second} has {counts[1]}. "
            "Train more seeds: shes train ... --seed 1 2 3"
        )
    envs = [side[0].read_config().run.env for side in sides]
    if envs[0] != envs[1]:
        raise ConfigError(f"{first} is a run of {envs[0]}, {second} of {envs[1]}. Compare runs of one environment.")

    def values(run: RunFolder) -> F64Array:
        found = evaluate(run.path, episodes=episodes, checkpoint=checkpoint, num_workers=num_workers, seed=seed)
        return getattr(found, MEASURES[measure])

    of_runs = [[values(run) for run in side] for side in sides]
    is_single = counts[0] == 1
    one, other = (side[0] if is_single else np.array([each.mean() for each in side]) for side in of_runs)
    low, high = mean_difference_interval(one, other)
    return RunComparison(
        first=str(first),
        second=str(second),
        measure=measure,
        unit="episodes" if is_single else "runs",
        first_count=len(one),
        second_count=len(other),
        first_mean=float(one.mean()),
        second_mean=float(other.mean()),
        difference=float(other.mean() - one.mean()),
        low=low,
        high=high,
        p=permutation_test(one, other),
    )


def _repetitions(run: Path | str) -> list[RunFolder]:
    """Return the runs of one side; raise ConfigError if they differ in more than the seed, or two are the same."""
    folders = find_runs(run)
    settings, seeds = zip(*map(settings_and_seeds, folders), strict=True)
    others = differing_settings(settings)
    if others:
        raise ConfigError(
            f"the runs below {run} differ in {', '.join(others[:3])}. Give the folder of one group, such as "
            f"{folders[0].path.parent}."
        )
    if any(each in seeds[:number] for number, each in enumerate(seeds)):
        raise ConfigError(f"two runs below {run} have the same seed and settings: they are one run. Remove one.")
    return folders


def mean_difference_interval(first: F64Array, second: F64Array) -> tuple[float, float]:
    """Return the 95 % interval of the difference of means, second minus first, of two samples. Source: Welch (1947).

    A bootstrap interval would be too short for the few runs that there usually are.
    """
    if np.ptp(first) == np.ptp(second) == 0:  # which SciPy does not handle
        return (difference := float(second[0] - first[0])), difference
    found = check_scipy().ttest_ind(second, first, equal_var=False).confidence_interval(0.95)
    return float(found.low), float(found.high)


def check_scipy() -> ModuleType:
    """Return `scipy.stats`; raise MissingExtraError if SciPy is not installed."""
    try:
        from scipy import stats
    except ImportError as error:
        told = f"comparing runs needs SciPy ({error}). Install it: pip install 'shes[compare]'."
        raise MissingExtraError(told) from error
    return stats


def permutation_test(first: F64Array, second: F64Array) -> float:
    """Return the two-sided p of the difference of means between two samples.

    p is the share of divisions of all values into two such samples whose difference is at least as large. Of more than
    10,000 divisions, as many random ones count and the given one (Phipson and Smyth 2010).
    """
    scale = max(1.0, float(np.abs(np.concatenate([first, second])).max()))

    def difference(one: F64Array, other: F64Array, axis: int) -> F64Array:
        return np.round(np.abs(one.mean(axis=axis) - other.mean(axis=axis)) / scale, _DIGITS)

    found = check_scipy().permutation_test(
        (first, second), difference, vectorized=True, n_resamples=_DIVISIONS, alternative="greater", rng=0
    )
    return float(found.pvalue)


# Repetitions are runs that differ only in the seed, their own and those of the runs from which they have a level. The
# path of such a run says nothing of what it is; its settings count instead, and its planned length.


def settings_and_seeds(folder: RunFolder) -> tuple[dict[str, Any], dict[str, int]]:
    """Return the settings that repetitions of a run have in common, and the seeds in which they differ, by name.

    Those of a run that trained the primitive are called `primitive's sigma`, and `primitive` is then `of ENV`.
    """
    traced = _traced(folder.read_config(), folder.read_record())
    seeds = {name: value for name, value in traced.items() if name.split()[-1] == "seed"}
    return {name: value for name, value in traced.items() if name not in seeds}, seeds


def differing_settings(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the names of settings with more than one value among those of `settings` that have them."""
    names = dict.fromkeys(name for each in settings for name in each)
    values = {name: [each[name] for each in settings if name in each] for name in names}
    return [name for name, found in values.items() if any(value != found[0] for value in found)]


def _traced(config: TrainConfig, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a run, and of the runs from which it has a level."""
    found = config.numbers()
    for level in config.algorithm.transfers:
        try:
            theirs = TrainConfig.from_dict(record[level]["config"])
        except (ShesError, KeyError, TypeError, AttributeError):  # a shipped agent, or a class not registered here
            continue
        lengths = {"generations": theirs.run.generations, "env_steps": theirs.run.env_steps}
        of_level = {**_traced(theirs, record[level]), **lengths}
        found[level] = f"of {of_level.pop('env')}, checkpoint {record[level].get('checkpoint', 'best')}"
        found |= {f"{level}'s {name}": value for name, value in of_level.items()}
    return found
