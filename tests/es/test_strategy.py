"""`EvolutionStrategy`: with one level it is S-ES, with two the update of SHES."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from shes.errors import ConfigError, ShapeError, UnknownNameError
from shes.es import EvolutionStrategy
from shes.es.noise import NoiseTable
from shes.es.perturbation import MIRRORINGS, PERTURBATIONS
from tests.messages import raises
from tests.rollout.formula import DIMS, evolving, formula, formula_run, formula_state

TABLE_SIZE = 20_000
OPTIMUM = np.array([1.0, -2.0, 0.5, 3.0, 0.0])


def _make(dim=5, **changes):
    arguments = {"population_size": 40, "sigma": 0.1, "learning_rate": 0.05, "noise_table_size": TABLE_SIZE}
    return EvolutionStrategy(dim, **{**arguments, **changes})


def _quadratic(candidates):
    return -((candidates - OPTIMUM) ** 2).sum(axis=1)


def _run(es, generations, fitness=_quadratic):
    for _ in range(generations):
        es.tell(fitness(es.ask()))
    return es


def _tuple(value):
    return value if isinstance(value, tuple) else (value,)


@pytest.mark.parametrize("perturbation", PERTURBATIONS)
@pytest.mark.parametrize("mirrored", MIRRORINGS)
def test_the_iterates_are_those_of_a_run(perturbation, mirrored):
    """They are the textbook's, which `evolution/test_algorithm.py` says."""
    settings = replace(evolving(mirrored=mirrored), perturbation=perturbation)
    _, reports = formula_run(NoiseTable.open(TABLE_SIZE), 4, settings)
    options = {"population_size": 8, "learning_rate": 0.02, "weight_decay": 0.005, "seed": formula_state().seed}
    initial = [level.theta for level in formula_state().levels]
    es = _make(DIMS, initial=initial, mirrored=mirrored, perturbation=perturbation, **options)
    for report in reports:
        paid, (population,) = [formula(*pair) for pair in zip(*es.ask(), strict=True)], report.populations
        assert population.results.fitness == pytest.approx(np.transpose(paid), rel=1e-4, abs=1e-4)
        es.tell(population.results.fitness)
        assert [mean.tolist() for mean in es.mean] == [level.theta.tolist() for level in report.state.levels]


def test_one_level_evolves_as_one_of_two_that_are_alike():
    one, two = _make(seed=3, mirrored="none"), _make((5, 5), seed=3, mirrored="none")
    for _ in range(5):
        fitness = _quadratic(one.ask())
        assert two.ask()[0].tolist() == one.ask().tolist()
        one.tell(fitness)
        two.tell([fitness, fitness])
    assert two.mean[0].tolist() == one.mean.tolist() != [0] * 5


def test_arrays_of_the_caller_are_neither_kept_nor_changed():
    start = np.ones(5, np.float32)
    es, other = _make(initial=start), _make(initial=np.ones(5))
    start[:] = 7
    es.ask()[:] = 99
    es.mean[:] = 99
    fitness = _quadratic(es.ask())
    fitness.flags.writeable = False
    es.tell(fitness)
    other.tell(_quadratic(other.ask()).tolist())
    assert es.mean.tolist() == other.mean.tolist()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"perturbation": "one_to_many", "fitness_shaping": "pair_rank"},
        {"perturbation": "one_to_many_halves", "optimizer": "sgd"},
    ],
)
def test_a_resumed_strategy_equals_one_that_never_stopped(options):
    def fitness(candidates):
        return [-np.abs(candidates[0]).sum(axis=1), candidates[1].sum(axis=1)]

    def make(**changes):
        return _make((3, 4), **{"weight_decay": 0.01, "seed": 9, **options, **changes})

    whole, half = _run(make(), 8, fitness), _run(make(), 5, fitness)
    for again in (make(seed=77, state=half.state), copy.deepcopy(half), pickle.loads(pickle.dumps(half))):  # noqa: S301
        resumed = _run(again, 3, fitness)
        assert [mean.tolist() for mean in resumed.mean] == [mean.tolist() for mean in whole.mean]
        assert resumed.state.generation == 8


@pytest.mark.parametrize(
    ("dim", "shapes", "fitness"),
    [(5, [(40, 5)], (40,)), ((5,), [(40, 5)], (1, 40)), ((5, 9), [(40, 5), (40, 9)], (2, 40))],
)
def test_shapes_follow_the_levels(dim, shapes, fitness):
    es = _make(dim)
    assert isinstance(es.ask(), tuple) == isinstance(es.mean, tuple) == (dim != 5)
    assert [each.shape for each in _tuple(es.ask())] == shapes
    assert [each.shape for each in _tuple(es.mean)] == [shape[1:] for shape in shapes]
    es.tell(np.zeros(fitness))
    for shape in {(39,), (40,), (40, 1), (1, 40), (2, 40), ()} - {fitness}:
        with pytest.raises(ShapeError) as raised:
            es.tell(np.zeros(shape))
        assert str(raised.value) == f"fitness must have shape {fitness}, got {shape}."


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"dim": 0}, ConfigError, "dim must be a positive whole number, or one per level, got 0"),
        ({"dim": ()}, ConfigError, "dim must be ... got ()"),
        ({"dim": (3, -1)}, ConfigError, "got (3, -1)"),
        ({"sigma": 0}, ConfigError, "sigma must be a number greater than 0, got 0"),
        ({"seed": -1}, ConfigError, "seed must be a whole number of at least 0, got -1"),
        ({"population_size": 41}, ConfigError, "multiple of 2, ... got 41. Set --population-size 40 or 42"),
        ({"dim": (2, 5), "noise_table_size": 9}, ConfigError, "is 9, but a level has 5 parameters ... 10. Raise --n"),
        ({"mirrored": "quadd"}, UnknownNameError, "mirroring 'quadd' ... --mirrored"),
        ({"perturbation": "many"}, UnknownNameError, "perturbation 'many' ... Known: ... --perturbation"),
        ({"fitness_shaping": "pair_rnk"}, UnknownNameError, "shaping 'pair_rnk' ... --fitness-shaping"),
        ({"optimizer": "adm"}, UnknownNameError, "optimizer 'adm' ... --optimizer"),
        ({"initial": np.zeros(4)}, ShapeError, "initial must have the shape of dim (5,), got [(4,)]"),
        *(({"dim": 1, "initial": [x]}, ConfigError, "initial holds NaN, infinity") for x in (np.nan, np.inf, 1e39)),
        ({"dim": (2, 2), "initial": [np.zeros(2)]}, ShapeError, "dim (2, 2), got [(2,)]"),
    ],
)  # fmt: skip
def test_a_wrong_argument_is_refused(changes, error, message):
    with raises(error, message):
        _make(**changes)


def test_a_state_of_another_strategy_is_refused():
    with raises(ShapeError, "state has levels of [5], dim is (6,)"):
        _make(6, state=_make(5).state)
    with raises(ConfigError, "'sgd' keeps velocity, but state is of an optimizer that keeps first"):
        _make(optimizer="sgd", state=_make().state)
