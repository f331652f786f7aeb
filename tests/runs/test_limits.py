"""What does not fit the machine is refused before anything is made, with the number that would fit."""

import tracemalloc
from dataclasses import replace

import pytest

import shes
from shes.algorithms.evolution.populations import generation_work
from shes.backends.processes import ProcessesBackend
from shes.cores import num_cores
from shes.errors import ConfigError
from shes.es.noise import NoiseTable
from shes.hierarchy.results import PopulationResults
from shes.runs import limits
from shes.runs.build import build_algorithm
from shes.runs.limits import Workload, check_limits, max_workers
from shes.training.make_config import make_config
from tests.e2e import runs

MEMORY = 2 * 10**9
HUGE = 10**12


@pytest.fixture
def small_machine(monkeypatch):
    """A machine with 2 GB of free memory."""
    monkeypatch.setattr(limits, "free_memory", lambda: MEMORY)


@pytest.fixture(scope="module")
def config():
    return make_config("point-gather", "smoke", {"hidden": (4,), "num_workers": 1})


@pytest.fixture(scope="module")
def design(config):
    return build_algorithm(config).design


NAMES = ["population_size", "episodes_per_policy", "evaluation_episodes", "horizon", "evaluation_horizon"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [HUGE, 10**18])
@pytest.mark.usefixtures("small_machine")
def test_a_size_that_does_not_fit_is_refused_with_the_size_that_would(tmp_path, design, name, value):
    its_flag = "--" + name.replace("_", "-")
    with pytest.raises(
        ConfigError,
        match=rf"^{name} is {value:,}, which takes [\d,.]+ GB of memory, but 2\.0 GB are free\. "
        rf"Set {its_flag} (\d+) or less\.",
    ) as error:
        runs.train_tiny(tmp_path / "run", **{name: value})
    assert list(tmp_path.iterdir()) == []
    workload = Workload.of(make_config("point-gather", "smoke", {**runs.TINY}))
    fit = int(str(error.value).split()[-3])
    check_limits(replace(workload, **{name: fit}), design)
    with pytest.raises(ConfigError, match="GB of memory"):
        check_limits(replace(workload, **{name: 3 * fit}), design)


@pytest.mark.usefixtures("small_machine")
def test_lockstep_of_too_many_policies_is_refused(config, design):
    workload = replace(Workload.of(config), population_size=3_000_000, chunk_size=2_000_000)
    with pytest.raises(ConfigError, match=r"chunk_size is 2,000,000, .* Set --chunk-size \d+ or less"):
        check_limits(workload, design)


@pytest.mark.usefixtures("small_machine")
def test_the_workers_together_must_fit(config, design):
    workload = replace(Workload.of(config), num_workers=60, population_size=1000)
    with pytest.raises(ConfigError, match=r"num_workers is 60, .* Set --workers \d\d or less"):
        check_limits(workload, design)


@pytest.mark.usefixtures("small_machine")
def test_the_horizon_of_an_evaluation_that_follows_it_is_lowered_with_it(config, design):
    workload = replace(Workload.of(config), horizon=HUGE, evaluation_horizon=HUGE)
    with pytest.raises(ConfigError, match=r"horizon is 1.*Set --horizon \d+ or less") as error:
        check_limits(workload, design)
    fit = int(str(error.value).split()[-3])
    check_limits(replace(workload, horizon=fit, evaluation_horizon=fit), design)


@pytest.mark.usefixtures("small_machine")
def test_several_sizes_that_do_not_fit_are_named_together(config, design):
    workload = replace(Workload.of(config), population_size=HUGE, evaluation_episodes=HUGE)
    with pytest.raises(ConfigError, match=r"the run takes .*Lower --population-size, .*--horizon, .*--hidden, or use"):
        check_limits(workload, design)


@pytest.mark.usefixtures("small_machine")
@pytest.mark.parametrize("env", ["point-gather", "ant-gather", "ant-maze"])
@pytest.mark.parametrize("preset", ["smoke", "laptop"])
def test_the_presets_fit_a_small_machine(env, preset):
    config = make_config(env, preset, {"num_workers": 8})
    check_limits(Workload.of(config), build_algorithm(config).design)


def test_the_estimate_covers_what_tasks_and_results_take():
    config = make_config("ant-gather", "smoke", {"population_size": 20_000, "backend": "serial"})
    algorithm = build_algorithm(config)
    estimate = Workload.of(config).memory(algorithm.design)
    state = algorithm.start(0)
    tracemalloc.start()
    work = generation_work(state, algorithm.hyperparameters, 1_000_000)
    results = PopulationResults.of_tasks(work.tasks, work.generation)
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert results.outcomes.size == 20_000
    assert estimate / 6 < taken < estimate


# Workers.


def test_workers_far_above_the_cores_are_refused(tmp_path):
    path = runs.train_tiny(tmp_path / "first", backend="processes", num_workers=1, generations=1)
    for value in (max_workers() + 1, 100_000_000):
        message = (
            rf"num_workers is {value:,}, but this machine has {num_cores()} cores: .* Set --workers {max_workers()} "
        )
        with pytest.raises(ConfigError, match=message):
            runs.train_tiny(tmp_path / "run", backend="processes", num_workers=value)
        assert list(tmp_path.iterdir()) == [path]
        with pytest.raises(ConfigError, match=message):
            shes.evaluate(path, num_workers=value, episodes=3)
        with pytest.raises(ConfigError, match=message):
            shes.resume(path, num_workers=value, generations=9)


@pytest.fixture
def started(monkeypatch):
    """The numbers of workers that are started; one is, each time."""
    numbers, original = [], ProcessesBackend.__init__

    def init(self, factory, num_workers, **options):
        numbers.append(num_workers)
        original(self, factory, 1, **options)

    monkeypatch.setattr(ProcessesBackend, "__init__", init)
    return numbers


def test_there_are_never_more_workers_than_episodes(tmp_path, started):
    path = runs.train_tiny(tmp_path / "run", backend="processes", num_workers=60, generations=1)
    assert started == [8]
    shes.evaluate(path, num_workers=60, episodes=3)
    shes.evaluate(path, num_workers=2, episodes=5)
    assert started == [8, 3, 2]


def test_the_noise_table_is_checked_before_the_run_folder_is_made(tmp_path, monkeypatch):
    monkeypatch.setenv("SHES_CACHE_DIR", str(tmp_path / "cache"))
    with pytest.raises(
        ConfigError, match=r"noise_table_size is 1,000,000,000,000, which takes 4,000\.0 GB, but .*most"
    ):
        runs.train_tiny(tmp_path / "run", noise_table_size=HUGE)
    assert list(tmp_path.iterdir()) == []
    assert NoiseTable.open(10).size == 10


BRANCHES = {"primitive_estimate": "interval", "primitive_view": "egocentric", "primitive_population_size": 30}


@pytest.mark.parametrize(
    ("settings", "policies", "episodes"),
    [
        ({"episodes_per_policy": 2}, 16, 2),
        ({"episodes_schedule": "linear", "episodes_end": 3}, 16, 3),
        (BRANCHES, 16 + 30, 1),
        ({"algorithm": "td3"}, 0, 1),
    ],
)
def test_an_algorithm_tells_how_many_policies_and_episodes_take_memory(settings, policies, episodes):
    found = Workload.of(make_config("point-gather", "smoke", settings))
    assert (found.population_size, found.episodes_per_policy) == (policies, episodes)
