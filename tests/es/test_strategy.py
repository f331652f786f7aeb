"""`EvolutionStrategy`: with one level it is S-ES, with two the update of SHES."""

import numpy as np
import pytest

from shes.errors import ConfigError, PolicyError, ShapeError, UnknownNameError
from shes.es import EvolutionStrategy
from shes.es.level import draw_noise_index
from shes.es.noise import NoiseTable
from tests.es.textbook import TextbookES

TABLE_SIZE = 20_000
OPTIMUM = np.array([1.0, -2.0, 0.5, 3.0, 0.0])


def _make(dim=5, **changes):
    return EvolutionStrategy(
        dim, **{"population_size": 40, "sigma": 0.1, "learning_rate": 0.05, "noise_table_size": TABLE_SIZE, **changes}
    )


def _quadratic(candidates):
    return -((candidates - OPTIMUM) ** 2).sum(axis=1)


def _noise(es, generation, table, members):
    index = draw_noise_index(es.state.seed, generation, es.population_size // members, es.dims, table.size)
    return [[table.slice(int(i), dim) for i in row] for row, dim in zip(index, es.dims, strict=True)]


@pytest.mark.parametrize(("mirrored", "members"), [("quad", 2), ("none", 1)])
def test_one_level_gives_the_iterates_of_flat_es(mirrored, members):
    es = _make(mirrored=mirrored, weight_decay=0.005, seed=3)
    book = TextbookES([np.zeros(5)], mirrored=mirrored, sigma=0.1, rate=0.05, weight_decay=0.005)
    table = NoiseTable.open(TABLE_SIZE)
    for generation in range(25):
        noise = _noise(es, generation, table, members)
        candidates = es.ask()
        assert candidates == pytest.approx(np.array(book.candidates(noise))[:, 0], abs=1e-4)
        # Both hear the same fitness: rounding may swap the ranks of two members that are all but equal.
        fitness = _quadratic(candidates)
        es.tell(fitness)
        book.update([fitness.tolist()], noise)
        assert es.mean == pytest.approx(book.thetas[0], abs=1e-4)
    assert np.abs(es.mean).max() > 0.5


@pytest.mark.parametrize(
    ("perturbation", "members"), [("many_to_many", 4), ("one_to_many", 2), ("one_to_many_halves", 2)]
)
def test_two_levels_give_the_iterates_of_the_textbook(perturbation, members):
    es = _make((3, 5), mirrored="quad", seed=4, perturbation=perturbation)
    book = TextbookES([np.zeros(3), np.zeros(5)], mirrored="quad", sigma=0.1, rate=0.05, perturbation=perturbation)
    table = NoiseTable.open(TABLE_SIZE)

    def fitness(first, second):
        # The levels need each other, and each is paid by its own measure.
        return [-((first - second[:3]) ** 2).sum() - (first[0] - 1) ** 2, -((second - OPTIMUM) ** 2).sum() + first[1]]

    for generation in range(15):
        noise = _noise(es, generation, table, members)
        population = list(zip(*es.ask(), strict=True))
        for mine, theirs in zip(population, book.candidates(noise), strict=True):
            assert np.concatenate(mine) == pytest.approx(np.concatenate(theirs), abs=1e-4)
        values = np.array([fitness(a.astype(float), b.astype(float)) for a, b in population]).T
        es.tell(values)
        book.update(values.tolist(), noise)
        for mean, theta in zip(es.mean, book.thetas, strict=True):
            assert mean == pytest.approx(theta, abs=1e-4)
    assert all(np.abs(mean).max() > 0.1 for mean in es.mean)


def test_in_turns_the_level_that_is_not_perturbed_rests():
    es = _make((2, 3), perturbation="one_to_many", weight_decay=0.01, initial=[np.ones(2), np.ones(3)])
    for generation in range(4):
        before, turn = es.state.levels, generation % 2
        candidates = es.ask()
        resting = candidates[1 - turn]
        assert np.array_equal(resting, np.tile(before[1 - turn].theta, (40, 1)))
        assert len(np.unique(candidates[turn], axis=0)) == 40
        es.tell(np.random.default_rng(generation).normal(size=(2, 40)))
        assert es.state.levels[1 - turn] is before[1 - turn]
        assert es.state.levels[turn].optimizer.steps == before[turn].optimizer.steps + 1


def test_in_halves_a_level_learns_from_its_own_half_alone():
    means = []
    for other_half in (0.0, 1e6):
        es = _make((2, 3), perturbation="one_to_many_halves")
        first, second = es.ask()
        assert not first[20:].any()
        assert not second[:20].any()
        fitness = np.full((2, 40), other_half)
        fitness[0, :20], fitness[1, 20:] = first[:20, 0], second[20:, 0]
        es.tell(fitness)
        means.append(es.mean)
    for one, other in zip(*means, strict=True):
        assert np.array_equal(one, other)
        assert one[0] > 0


@pytest.mark.parametrize("mirrored", ["quad", "pair", "none"])
def test_it_converges_to_the_optimum(mirrored):
    es = _make(mirrored=mirrored)
    for _ in range(300):
        es.tell(_quadratic(es.ask()))
    assert es.mean == pytest.approx(OPTIMUM, abs=0.1)


@pytest.mark.parametrize(
    ("options", "tolerance"),
    [
        ({"fitness_shaping": "pair_rank"}, 0.1),
        ({"rank_ties": "index"}, 0.1),
        ({"optimizer": "sgd", "learning_rate": 0.5}, 0.2),
    ],
)
def test_it_converges_with_every_shaping_and_optimizer(options, tolerance):
    es = _make(**options)
    for _ in range(150):
        es.tell(_quadratic(es.ask()))
    assert es.mean == pytest.approx(OPTIMUM, abs=tolerance)


@pytest.mark.parametrize("perturbation", ["many_to_many", "one_to_many", "one_to_many_halves"])
def test_two_levels_converge_each_by_its_own_fitness(perturbation):
    es = _make((2, 3), perturbation=perturbation)
    for _ in range(240 if perturbation == "one_to_many" else 120):
        first, second = es.ask()
        es.tell([-((first - 1) ** 2).sum(axis=1), -((second + 2) ** 2).sum(axis=1)])
    assert es.mean[0] == pytest.approx([1, 1], abs=0.1)
    assert es.mean[1] == pytest.approx([-2, -2, -2], abs=0.1)


def test_it_maximises():
    es = _make(2)
    for _ in range(10):
        candidates = es.ask()
        es.tell(candidates[:, 0] - candidates[:, 1])
    assert es.mean[0] > 0.3
    assert es.mean[1] < -0.3


def test_only_the_order_of_fitness_matters():
    first, second = _make(), _make()
    for _ in range(5):
        fitness = _quadratic(first.ask())
        first.tell(fitness)
        second.tell(np.exp(fitness / 10) * 1000)
    assert np.array_equal(first.mean, second.mean)


def test_asking_twice_gives_the_same():
    es = _make((3, 5))
    for first, second in zip(es.ask(), es.ask(), strict=True):
        assert np.array_equal(first, second)


def test_every_generation_has_its_own_noise():
    es = _make(mirrored="none")
    before = es.ask() - es.mean
    es.tell(np.zeros(40))
    after = es.ask() - es.mean
    assert not {tuple(row) for row in before.round(4).tolist()} & {tuple(row) for row in after.round(4).tolist()}


def test_candidates_are_mirrored_around_the_mean():
    es = _make(initial=OPTIMUM)
    candidates = es.ask()
    assert (candidates[0::2] + candidates[1::2]) / 2 == pytest.approx(np.tile(OPTIMUM, (20, 1)), abs=1e-6)
    assert np.abs(candidates[0::2] - candidates[1::2]).min() > 0


def test_candidates_are_sigma_away_from_the_mean():
    es = _make(100, sigma=0.3, population_size=200)
    assert es.ask().std() == pytest.approx(0.3, rel=0.05)


def test_telling_leaves_the_callers_array_as_it_was():
    es = _make()
    fitness = _quadratic(es.ask())
    fitness.flags.writeable = False
    before = fitness.tolist()
    es.tell(fitness)
    assert fitness.tolist() == before


def test_the_start_vector_is_copied():
    start = np.ones(5, np.float32)
    es = _make(initial=start)
    start[:] = 7
    es.tell(_quadratic(es.ask()))
    assert np.all(start == 7)
    assert es.mean == pytest.approx(np.ones(5), abs=0.06)


def test_candidates_belong_to_the_caller():
    es = _make()
    es.ask()[:] = 99
    assert np.abs(es.ask()).max() < 1
    assert np.all(es.mean == 0)


def test_a_list_of_fitnesses_is_welcome():
    first, second = _make(), _make()
    first.tell(_quadratic(first.ask()))
    second.tell(_quadratic(second.ask()).tolist())
    assert np.array_equal(first.mean, second.mean)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"perturbation": "one_to_many"},
        {"perturbation": "one_to_many", "fitness_shaping": "pair_rank"},
        {"perturbation": "one_to_many_halves", "optimizer": "sgd"},
        {"optimizer": "sgd", "rank_ties": "index"},
    ],
)
def test_a_strategy_goes_on_from_its_state_as_if_it_had_never_stopped(options):
    def run(es, generations):
        for _ in range(generations):
            first, second = es.ask()
            es.tell([-np.abs(first).sum(axis=1), second.sum(axis=1)])
        return es

    arguments = {"dim": (3, 4), "weight_decay": 0.01, "seed": 9, **options}
    whole = run(_make(**arguments), 8)
    half = run(_make(**arguments), 5)
    resumed = run(_make(**{**arguments, "seed": 77}, state=half.state), 3)
    for mine, other in zip(resumed.mean, whole.mean, strict=True):
        assert np.array_equal(mine, other)
    assert resumed.state.generation == 8


def test_the_same_seed_gives_the_same_run_and_another_seed_another():
    means = []
    for seed in (1, 1, 2):
        es = _make(seed=seed)
        for _ in range(3):
            es.tell(_quadratic(es.ask()))
        means.append(es.mean)
    assert np.array_equal(means[0], means[1])
    assert not np.array_equal(means[0], means[2])


@pytest.mark.parametrize(
    ("dim", "shapes", "fitness"),
    [(5, (40, 5), (40,)), ((5,), [(40, 5)], (1, 40)), ((5, 9), [(40, 5), (40, 9)], (2, 40))],
)
def test_shapes_follow_the_levels(dim, shapes, fitness):
    es = _make(dim)
    candidates = es.ask()
    if isinstance(shapes, list):
        assert [c.shape for c in candidates] == shapes
        assert [m.shape for m in es.mean] == [shape[1:] for shape in shapes]
    else:
        assert candidates.shape == shapes
        assert es.mean.shape == shapes[1:]
    es.tell(np.zeros(fitness))
    assert es.state.generation == 1


def test_several_levels_start_where_they_are_told():
    es = _make((1, 2), initial=[[3.0], [4.0, 5.0]])
    assert [m.tolist() for m in es.mean] == [[3], [4, 5]]


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"dim": 0}, ConfigError, "dim must be a positive whole number, or one per level, got 0"),
        ({"dim": ()}, ConfigError, r"dim must be .* got \(\)"),
        ({"dim": (3, -1)}, ConfigError, r"got \(3, -1\)"),
        ({"sigma": -0.1}, ConfigError, "sigma must be a positive number, got -0.1"),
        ({"sigma": 0}, ConfigError, "sigma must be a positive number, got 0"),
        ({"sigma": float("nan")}, ConfigError, "sigma must be a positive number, got nan"),
        ({"learning_rate": -1}, ConfigError, "learning_rate must be a positive number, got -1"),
        ({"learning_rate": 0}, ConfigError, "learning_rate must be a positive number, got 0"),
        ({"weight_decay": -0.5}, ConfigError, "weight_decay must be zero or a positive number, got -0.5"),
        ({"population_size": 4.5}, ConfigError, "population_size must be a whole number of at least 1, got 4.5"),
        ({"population_size": 0}, ConfigError, "population_size must be a whole number of at least 1, got 0"),
        ({"seed": -1}, ConfigError, "seed must be a whole number of at least 0, got -1"),
        ({"population_size": 41}, ConfigError, r"multiple of 2, .*got 41\. Set --population-size 40 or 42"),
        ({"dim": (2, 2), "population_size": 42}, ConfigError, "multiple of 4, .*got 42"),
        (
            {"dim": (2, 2), "population_size": 42, "perturbation": "one_to_many_halves"},
            ConfigError,
            "a group of 2 .*got 42",
        ),
        ({"noise_table_size": 9}, ConfigError, "noise_table_size is 9, but a level has 5 parameters .* at least 10"),
        (
            {"noise_table_size": 0},
            ConfigError,
            "size must be a whole number of at least 1, got 0. Set --noise-table-size",
        ),
        ({"mirrored": "quadd"}, UnknownNameError, r"mirroring 'quadd'. Did you mean 'quad'\?"),
        ({"rank_ties": "indx"}, UnknownNameError, r"'indx'. Did you mean 'index'\?"),
        ({"perturbation": "many"}, UnknownNameError, r"perturbation 'many'.*Known: .*--perturbation"),
        ({"fitness_shaping": "pair_rnk"}, UnknownNameError, r"'pair_rnk'. Did you mean 'pair_rank'\?"),
        ({"optimizer": "adm"}, UnknownNameError, r"optimizer 'adm'. Did you mean 'adam'\?"),
        ({"initial": np.zeros(4)}, ShapeError, r"initial must have the shape of dim \(5,\), got \[\(4,\)\]"),
        ({"initial": 1.0}, ShapeError, r"got \[\(\)\]"),
        ({"dim": (2, 2), "initial": [np.zeros(2)]}, ShapeError, r"dim \(2, 2\), got \[\(2,\)\]"),
    ],
)
def test_a_wrong_argument_is_refused(changes, error, message):
    with pytest.raises(error, match=message):
        _make(**changes)


def test_a_state_of_other_dimensions_is_refused():
    with pytest.raises(ShapeError, match=r"state has levels of \[5\], dim is \(6,\)"):
        _make(6, state=_make(5).state)


@pytest.mark.parametrize("shape", [(39,), (40, 1), (1, 40), ()])
def test_fitness_of_another_shape_is_refused(shape):
    with pytest.raises(ShapeError, match=r"fitness must have shape \(40,\), got "):
        _make().tell(np.zeros(shape))


def test_levels_need_a_fitness_each():
    with pytest.raises(ShapeError, match=r"fitness must have shape \(2, 40\), got \(40,\)"):
        _make((2, 3)).tell(np.zeros(40))


def test_a_fitness_of_nan_is_refused_and_changes_nothing():
    es = _make()
    fitness = _quadratic(es.ask())
    fitness[3] = np.nan
    before = es.state
    with pytest.raises(PolicyError, match="fitness of member 3 is nan"):
        es.tell(fitness)
    assert es.state is before
