"""Runs of experiments that take a fraction of a second."""

from experiments.design import Experiment, Measure, Run
from tests.e2e import runs

TINY = {name: value for name, value in runs.TINY.items() if name not in ("preset", "seed", "backend")}
FAILING = {**TINY, "noise_table_size": 3}  # allowed, but no level fits: it shows when the run begins
SCORE = Measure("best_score", "score")


def run(variant="base", seed=5, env="point-gather", group="choices", primitive=None, **settings):
    own = {"settings": {**TINY, **settings}, "preset": "smoke"}
    return Run(group=group, variant=variant, env=env, seed=seed, primitive=primitive, **own)


def experiment(*members, **options):
    """Return an experiment of runs, compared by their score."""
    groups = {each.group: "" for each in members}
    metrics = {each.env: SCORE for each in members}
    base = (members[0].group, members[0].variant)
    return Experiment(runs=members, **{"groups": groups, "metrics": metrics, "base": base, "episodes": 3, **options})


def without_times(results):
    """Return results without what depends on how the run was made."""
    ours = ("seconds", "primitive_seconds", "workers")
    row = {name: value for name, value in results.row.items() if name not in ours}
    return row, [{name: value for name, value in point.items() if name not in ours} for point in results.curve]
