"""Transfer: what a level brings, what stays as it was, and what does not fit."""

import shutil
from typing import Any

import numpy as np
import pytest

import shes
from shes.errors import ShesError
from shes.runs.folder import RunFolder
from shes.runs.make_config import make_config
from shes.runs.tables import read_csv
from tests.e2e import runs
from tests.messages import raises
from tests.runs.recorder import recording

EVERY = {"generations": 3, "evaluation_interval": 1, "keep_checkpoints": 1}
ANT = {**EVERY, "population_size": 4, "evaluation_episodes": 2}
BROUGHT = {"goal_encoding": "unit_vector", "clock_frequency": 1.5}
"""What a primitive brings. No value is a default."""
WALKER = {"primitive_view": "egocentric", "symmetry": "dihedral", "clock_frequency": 1.2}
BY_CONTROLLER = {"controller_output": "one_hot", "controller_view": "egocentric", "hidden": (4,)}
SUGGESTED = {"controller_interval": 7, "goal_distance": 2.5, "minimum_goal_distance": False}
"""What a controller brings unless another value is asked for. No value is a default."""
NETWORK = {"controller_network": "equivariant", "controller_view": "sectors", "controller_output": "heading_direction"}


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Return a function that returns the folder of a run with a level to take. Not to be changed."""
    settings = {
        "ant of hiro": ("ant-flagrun", {**ANT, "hidden": (5,), "spec": "hiro"}),
        "walker": ("ant-flagrun", {**ANT, **WALKER, "generations": 1, "primitive_estimate": "interval",
                                   "controller_interval": 4, "hidden": (5,)}),
        "point": ("point-flagrun", {**ANT, "hidden": (3, 2), **BROUGHT}),
        "plain": ("point-flagrun", ANT),
        "flat": ("point-gather", {"algorithm": "es", "generations": 1}),
        "two levels": ("point-push", {"primitive_hidden": (3,)}),
        "equivariant": ("point-gather", {**NETWORK, "generations": 1}),
        "controller": ("point-gather", {**BY_CONTROLLER, **SUGGESTED, "generations": 2, "evaluation_interval": 2}),
    }  # fmt: skip
    return runs.trained_once(tmp_path_factory.mktemp("source"), settings)


def level(path, checkpoint, name="primitive"):
    """Return a level of a checkpoint."""
    (found,) = [each for each in runs.state(path, checkpoint).levels if each.name == name]
    return found


def same(one, other):
    """Return whether the parameters and statistics of two levels are bit-identical."""
    pairs = [(one.theta, other.theta)]
    pairs += [(getattr(one.statistics, name), getattr(other.statistics, name)) for name in ("total", "total_squares")]
    counts = one.statistics.count == other.statistics.count
    return counts and all(mine.tobytes() == theirs.tobytes() for mine, theirs in pairs)


def test_an_unfrozen_primitive_learns_on_from_where_it_was(sources, tmp_path, tiny_run):
    settings = {"primitive": f"{sources('point')}@2", "freeze_primitive": False}
    with recording() as record:
        path = runs.train_tiny(tmp_path / "run", **settings, generations=2)
    assert not any(each.generation.has_frozen_control for each in record.rolled_out)
    brought, start, end = level(sources("point"), "2"), level(path, "0"), level(path, "last")
    assert not same(brought, level(sources("point"), "best"))
    assert same(start, brought)
    assert same(level(path, "0", "controller"), level(tiny_run, "0", "controller"))  # as it begins without
    assert not np.array_equal(end.theta, brought.theta)
    assert end.statistics.count == brought.statistics.count + 2 * 8 * 20
    assert (start.optimizer.steps, end.optimizer.steps) == (0, 2)


TRANSFERS: dict[str, tuple[str, str, dict[str, Any], dict[str, Any]]] = {
    # The level's run: the level; the environment; settings that are asked for; settings that it has then.
    "point": (
        "primitive", "point-gather", {"controller_interval": 5},
        {**BROUGHT, "primitive_hidden": (3, 2), "primitive_view": "proprioception", "controller_interval": 5,
         "freeze_primitive": True},
    ),
    "walker": (  # two policies are a whole population: only the controller is mirrored
        "primitive", "ant-gather", {"population_size": 2, "controller_output": "heading_direction",
                                    "controller_view": "egocentric"},
        {**WALKER, "primitive_hidden": (5,), "primitive_estimate": "episode"},
    ),
    "two levels": ("primitive", "point-push", {}, {"primitive_view": "observation", "primitive_hidden": (3,)}),
    "controller": ("controller", "point-gather", {}, {**BY_CONTROLLER, **SUGGESTED}),
    "equivariant": ("controller", "point-gather", {"goal_distance": 3.0}, {**NETWORK, "goal_distance": 3.0}),
}  # fmt: skip


@pytest.mark.parametrize("source", TRANSFERS)
def test_a_level_brings_what_it_was_trained_with(sources, tmp_path, source):
    kind, env, asked, expected = TRANSFERS[source]
    origin = RunFolder.open(sources(source))
    with recording() as record:
        path = runs.train_tiny(tmp_path / "run", env, **{kind: origin.path, **asked}, generations=2)
    values = RunFolder(path).read_config().values
    assert values.items() >= {**expected, kind: str(origin.path)}.items()
    assert make_config(None, None, {"like": path}).values == {**values, "seed": 1}
    starts, ends = ({each.name: each for each in runs.state(path, checkpoint).levels} for checkpoint in ("0", "last"))
    brought = level(origin.path, "best", kind)
    assert same(starts[kind], brought)
    assert brought.statistics.count > 0
    assert [name for name in starts if same(starts[name], ends[name])] == (["primitive"] if kind == "primitive" else [])
    if kind == "primitive":  # which is frozen
        assert ends[kind].optimizer.steps == 0
        assert np.isnan(read_csv(path / "progress.csv")["primitive_gradient_norm"]).all()
        assert all(each.generation.has_frozen_control for each in record.of("training"))  # without exploration noise
    best, config = origin.load("best").generation, origin.read_record()["config"]
    told = {"run": str(origin.path), "env": config["run"]["env"], "checkpoint": "best", "generation": best}
    assert RunFolder(path).read_record()[kind] == {**told, "config": config}
    assert best > 0


def test_both_levels_may_come_from_other_runs(sources):
    given = {"controller": str(sources("controller")), "primitive": str(sources("plain"))}
    other = {"controller_interval": 9, "goal_distance": 3.0, "minimum_goal_distance": True}
    found = make_config("point-gather", "smoke", {**given, **other})
    assert found.values.items() >= {**given, **BY_CONTROLLER, **other}.items()  # what is suggested may be asked for


OTHER_ROBOT = "LEVEL does not fit ... it was trained on ant-flagrun for the ant, but ... has {}. Name a primitive of "
MISFIT = "LEVEL does not fit ... .\n"
REFUSED = [
    # The level; its run; the environment; further settings; the message.
    ("primitive", "point", "point-gather", {"goal_encoding": "angle"},
     "goal_encoding is 'angle', but LEVEL was trained with 'unit_vector'. Omit --goal-encoding: it comes with the"),
    ("primitive", "point", "point-gather", {"clock_frequency": None}, "LEVEL was trained with 1.5. Omit --clock-freq"),
    ("primitive", "point", "point-gather", {"primitive_hidden": None}, "is None, but LEVEL was trained with (3, 2)"),
    ("primitive", "walker", "ant-gather", {"symmetry": "none"}, "is 'none', but LEVEL was trained with 'dihedral'"),
    ("controller", "controller", "point-gather", {"controller_network": "equivariant"}, "LEVEL was trained with 'mlp'"),
    ("controller", "controller", "point-gather", {"hidden": (5,)}, "LEVEL was trained with (4,). Omit --hidden: it"),
    ("primitive", "walker", "point-gather", {}, OTHER_ROBOT.format("the point")),
    ("primitive", "walker", "gymnasium:shes/PointMaze-v0", {}, OTHER_ROBOT.format("an external robot")),
    ("primitive", "two levels", "point-gather", {}, MISFIT + "It was trained on point-push: ... \nHere there is: "),
    ("primitive", "ant of hiro", "ant-gather", {}, MISFIT + "... of specification hiro and 8 ... on shes and"),
    ("primitive", "point", "point-fall", {}, MISFIT + "... 9 inputs ( ... with the same --spec by shes train ant"),
    ("controller", "controller", "point-maze", {}, MISFIT + "It was trained on point-gather: "),
    ("primitive", "flat", "point-gather", {}, "has no primitive ... levels are policy. Name a run with --primitive"),
    ("controller", "plain", "point-gather", {}, "has no controller ... levels are primitive"),
    ("primitive", "plain@77", "point-gather", {}, "@77: there is no checkpoint ... 000077.npz. There are"),
    ("primitive", "plain@first", "point-gather", {}, "@first does not exist"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "source", "env", "settings", "message"), REFUSED)
def test_a_level_that_does_not_fit_is_refused(sources, tmp_path, kind, source, env, settings, message):
    name, *checkpoint = source.split("@")
    path = "@".join([str(sources(name)), *checkpoint])
    with raises(ShesError, message.replace("LEVEL", f"the {kind} of {path}")):
        runs.train_tiny(tmp_path / "run", env, **{kind: path, **settings})
    assert list(tmp_path.iterdir()) == []


def test_a_run_needs_the_folder_of_its_primitive_no_more(sources, tmp_path):
    source = shutil.copytree(sources("plain"), tmp_path / "source")
    settings = {"primitive": str(source), "freeze_primitive": False, "evaluation_interval": 1}
    whole = runs.train_tiny(tmp_path / "whole", **settings, generations=3)
    half = runs.train_tiny(tmp_path / "half", **settings, generations=1)
    shutil.rmtree(source)
    assert shes.load(half).goal is not None
    shes.resume(half, generations=3)
    assert runs.differences(whole, half) == []
