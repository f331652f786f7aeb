"""Stands in for Optuna: the calls of `examples/optuna_search.py`."""

import math
from types import SimpleNamespace


class Trial:
    def __init__(self, number):
        self.number, self.params, self.value = number, {}, -math.inf

    def suggest_float(self, name, low, high, *, log=False):
        assert 0 < low < high
        return self.params.setdefault(name, math.sqrt(low * high) if log else (low + high) / 2)


def create_study(*, direction):
    assert direction == "maximize"
    study = SimpleNamespace(trials=[], best_params={})

    def optimize(objective, n_trials):
        for number in range(n_trials):
            study.trials.append(Trial(number))
            study.trials[-1].value = float(objective(study.trials[-1]))
        study.best_params = max(study.trials, key=lambda trial: trial.value).params

    study.optimize = optimize
    return study
