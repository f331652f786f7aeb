"""Everything above `algorithms` knows an algorithm by its contract alone: in the sources, and with one from outside."""

import ast
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
import pytest

import shes
from shes.agents.views import CONTROLLER_VIEWS, PRIMITIVE_VIEWS, ColumnsView, ViewChoice
from shes.algorithms.contract import PRESETS, Algorithm, Preset
from shes.errors import ConfigError, UnknownNameError
from shes.es.perturbation import MIRRORINGS, Mirroring
from shes.runs.build import build_algorithm
from shes.runs.config import TrainConfig, known_settings
from shes.runs.make_config import make_config
from shes.runs.named_algorithms import ALGORITHMS, PRESET_NAMES, algorithm_classes, find_algorithm
from shes.runs.transfer import transferred_levels
from shes.settings import Ge, Settings

SRC = Path(shes.__file__).parent
ABOVE = ("cli", "gymnasium", "runs", "training", "viewing")
SOURCES = {str(path.relative_to(SRC)): path.read_text() for package in ABOVE for path in SRC.glob(f"{package}/**/*.py")}
IMPORTS = {"cli/bench.py"}
"""Modules that may import from an algorithm: the speed of a generation is that of Algorithm 1."""
SECTIONS = "|".join(sorted({section for each in algorithm_classes() for section in each.sections}))


def test_no_module_above_knows_an_algorithm():
    """Not by an import, nor by a section of its settings, nor by comparing its name."""
    own = re.compile(r"shes\.algorithms\.(evolution|hiro)|from shes\.algorithms import (evolution|hiro)")
    assert {name for name, text in SOURCES.items() if own.search(text)} <= IMPORTS
    section = re.compile(
        rf"""\b(config|settings|source|sections)(\.|\[["'])({SECTIONS})\b|["']({SECTIONS})["'] (not )?in \b"""
    )
    assert {name: section.search(text)[0] for name, text in SOURCES.items() if section.search(text)} == {}
    assert not re.search(rf"^    ({SECTIONS}): ", SOURCES["runs/config.py"], re.MULTILINE)
    names = {"shes", "es", "hiro", "td3"}
    assert {name for name, text in SOURCES.items() if names & set(_compared(ast.parse(text)))} == set()
    words = {word for preset in PRESETS.values() for word in (*preset.values, *preset.per_environment)}
    assert not words & {"algorithm", "sigma", "population_size", "actor_learning_rate"}
    assert not re.search(r"\b(hiro|td3)\b", SOURCES["runs/config.py"])


def _compared(tree):
    """Yield every string that is compared, or a key of a dictionary that is looked up."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            yield from (part.value for each in (node.left, *node.comparators) for part in ast.walk(each)
                        if isinstance(part, ast.Constant))  # fmt: skip


# An algorithm from outside.


@dataclass(frozen=True, kw_only=True)
class OwnSettings(Settings):
    """Own."""

    few: Annotated[int, Ge(1)] = 5
    """A number."""
    many: Annotated[int, Ge(1)] = 10
    """A larger number."""
    primitive: float = 0.5
    """No level."""


class Alone(Algorithm):
    """Stands in."""

    level_names: ClassVar = ("primitive",)
    sections: ClassVar = {"evolution": OwnSettings}

    def __init__(self, problem):
        super().__init__(problem, problem.flat_design(hidden=()))

    start = run = to_arrays = from_arrays = parameters = None


class Own(Alone):
    """Learns in its own way. And this is not shown."""

    level_names: ClassVar = ("policy",)
    without_controller: ClassVar = Alone
    presets: ClassVar = {
        "smoke": Preset(values={"few": 1, "horizon": 7}, per_environment={"point-maze": {"many": 70}}),
        "own-paper": Preset(values={"many": 99}),
    }

    @staticmethod
    def check(settings):
        if settings.evolution.few >= settings.evolution.many:
            raise ConfigError("few must be less than many")

    @staticmethod
    def check_effects(settings, asked):
        if "few" in asked and settings.evolution.many == 3:
            raise ConfigError("few has no effect with many 3")


@pytest.fixture
def own():
    """An algorithm from outside; what a test registers is forgotten after it."""
    before = set(ALGORITHMS)
    shes.register_algorithm("own", Own)
    yield
    for name in set(ALGORITHMS) - before:
        del ALGORITHMS[name]


def test_its_check_is_that_of_a_configuration(own):
    values = {"env": "point-gather", "algorithm": "own"}
    for make in (lambda: TrainConfig.of(**values, few=10),
                 lambda: TrainConfig.from_dict({"run": values, "evolution": {"few": 10}})):  # fmt: skip
        with pytest.raises(ConfigError, match="few must be less than many"):
            make()
    assert TrainConfig.of(**values, few=9).evolution.few == 9
    with pytest.raises(ConfigError, match="few has no effect with many 3"):
        make_config("point-gather", "laptop", {"algorithm": "own", "few": 1, "many": 3})
    assert make_config("point-gather", "smoke", {"algorithm": "own", "many": 3}).evolution.few == 1


def test_it_brings_values_of_presets_and_presets_of_its_own(own):
    smoke = {env: make_config(env, "smoke", {"algorithm": "own"}) for env in ("point-gather", "point-maze")}
    assert [(each.evolution.few, each.evolution.many) for each in smoke.values()] == [(1, 10), (1, 70)]
    assert (smoke["point-maze"].episodes.horizon, smoke["point-maze"].run.generations) == (7, 3)
    paper = make_config("point-gather", "own-paper")
    assert (paper.run.algorithm, paper.evolution.many, paper.run.preset) == ("own", 99, "own-paper")
    assert "own-paper" in PRESET_NAMES
    assert "own-paper" in known_settings()["preset"].choices
    with pytest.raises(ConfigError, match="preset 'own-paper' is for algorithm own, got algorithm 'es'"):
        make_config("point-gather", "own-paper", {"algorithm": "es"})
    assert make_config("point-gather", "paper").evolution.population_size == 1000  # of others nothing changes


def test_a_preset_is_unknown_before_its_algorithm_is_registered():
    with pytest.raises(UnknownNameError, match="unknown preset 'own-paper'"):
        make_config("point-gather", "own-paper")


def test_its_help_its_levels_and_its_generations_are_its_own(own):
    text = known_settings()["algorithm"].text
    assert "; own: Learns in its own way." in text
    assert all(f"{name}: {cls.__doc__.partition('.')[0]}" in text for name, cls in ALGORITHMS.items())
    assert set(transferred_levels()) == {"controller", "primitive"}
    assert make_config("point-gather", "smoke", {"algorithm": "own", "primitive": 2}).evolution.primitive == 2.0
    lengths = {"own": 7, "td3": 500, "es": 16 * 50}
    for name, steps in lengths.items():
        config = make_config("point-gather", "smoke", {"algorithm": name})
        assert find_algorithm(name, sets_goals=False).steps_per_generation(config) == steps


def test_it_says_who_learns_where_the_environment_sets_the_goals(own):
    """A class that stands in is checked as well; it may be a subclass."""
    assert [find_algorithm("own", sets_goals=sets_goals) for sets_goals in (False, True)] == [Own, Alone]
    assert TrainConfig.of(env="point-flagrun", algorithm="own").level_names == ("primitive",)
    assert {Own, Alone} <= set(algorithm_classes())
    with pytest.raises(ConfigError, match=r"hiro has nothing to learn\. Set --algorithm to shes, .*own"):
        TrainConfig.of(env="point-flagrun", algorithm="hiro")
    alone = type("Taken", (Alone,), {"sections": {"run": OwnSettings}})
    with pytest.raises(ConfigError, match="Taken has a section 'run', a name that is taken"):
        shes.register_algorithm("other", type("Other", (Own,), {"without_controller": alone}))
    whole = type("Whole", (Own,), {})
    whole.without_controller = type("Part", (whole,), {"level_names": ("primitive",)})
    shes.register_algorithm("whole", whole)
    assert TrainConfig.of(env="point-flagrun", algorithm="whole").level_names == ("primitive",)


# Parts of an evolution strategy that were once branches of a function.


class Threefold(Mirroring):
    """Three members."""

    def rows(self, num_levels):
        return [(1,) * num_levels] * 3


class First(ViewChoice):
    """The first value."""

    def of(self, task):
        return ColumnsView((0,))


def test_mirrorings_and_views_can_be_registered(monkeypatch):
    monkeypatch.setitem(MIRRORINGS, "threefold", Threefold)
    monkeypatch.setitem(PRIMITIVE_VIEWS, "first", First)
    monkeypatch.setitem(CONTROLLER_VIEWS, "first", First)
    asked = {"mirrored": "threefold", "population_size": 6, "primitive_view": "first", "controller_view": "first"}
    built = build_algorithm(make_config("point-gather", "smoke", {**asked, "hidden": ()}))
    assert built.hyperparameters.signs(0).tolist() == [[[1, 1]] * 3] * 2
    assert [policy.sizes[0] for policy in built.design.policies] == [1, 3 + 1]
    assert "threefold: Three members" in known_settings()["mirrored"].text
    assert np.array_equal(MIRRORINGS["none"]().rows(2), [[1, 1]])
