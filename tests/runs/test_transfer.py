"""Transfer: what a level brings, what stays as it was, and what does not fit."""

import re
import shutil
from typing import Any

import numpy as np
import pytest

import shes
from shes.errors import CheckpointError, ConfigError, RunFolderError
from shes.runs.folder import RunFolder
from shes.runs.make_config import make_config
from shes.runs.tables import read_csv
from tests.e2e import runs
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
        "ant": ("ant-flagrun", {**ANT, "hidden": (5,)}),
        "ant of hiro": ("ant-flagrun", {**ANT, "hidden": (5,), "spec": "hiro"}),
        "walker": (
            "ant-flagrun",
            {**ANT, **WALKER, "generations": 1, "primitive_estimate": "interval", "controller_interval": 4,
             "hidden": (5,)},
        ),
        "point": ("point-flagrun", {**ANT, "hidden": (3, 2), **BROUGHT}),
        "plain": ("point-flagrun", ANT),
        "two levels": ("point-push", {"primitive_hidden": (3,)}),
        "equivariant": ("point-gather", {**NETWORK, "generations": 1}),
        "controller": ("point-gather", {**BY_CONTROLLER, **SUGGESTED, "generations": 2, "evaluation_interval": 2}),
    }  # fmt: skip
    made = {}

    def find(name):
        if name not in made:
            env, own = settings[name]
            made[name] = runs.train_tiny(tmp_path_factory.mktemp("source") / "run", env, **own)
        return made[name]

    return find


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


def values_of(path):
    return RunFolder.open(path).read_config().values


# Primitives.


@pytest.mark.parametrize(("task", "source"), [("gather", "ant"), ("push", "ant of hiro")])
def test_a_frozen_primitive_serves_every_task_of_its_robot(sources, tmp_path, task, source):
    """Two policies are a whole population: only the controller is mirrored."""
    spec, path = "hiro" if "hiro" in source else "shes", tmp_path / "run"
    settings = {"generations": 2, "population_size": 2, "spec": spec, "primitive": str(sources(source))}
    with recording() as record:
        runs.train_tiny(path, f"ant-{task}", **settings)
    assert all(each.generation.has_frozen_control for each in record.of("training"))  # it has no exploration noise
    config = RunFolder.open(path).read_config()
    assert (config.hierarchy.primitive_view, config.hierarchy.primitive_hidden) == ("proprioception", (5,))
    assert config.networks.hidden == (4,)
    brought = level(sources(source), "best")
    assert brought.statistics.count > 0
    assert len(brought.statistics.total) == 3 + 29
    for checkpoint in ("0", "2", "last"):
        assert same(level(path, checkpoint), brought)
        assert level(path, checkpoint).optimizer.steps == 0
    controllers = [level(path, name, "controller") for name in ("0", "last")]
    assert not np.array_equal(controllers[0].theta, controllers[1].theta) or task == "gather"  # which pays nothing yet
    assert [each.statistics.count > 0 for each in controllers] == [False, True]
    assert np.isnan(read_csv(path / "progress.csv")["primitive_gradient_norm"]).all()


def test_an_unfrozen_primitive_learns_on_from_where_it_was(sources, tmp_path, tiny_run):
    settings = {"primitive": str(sources("point")), "freeze_primitive": False, "primitive_checkpoint": "2"}
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
    with pytest.raises(ConfigError, match="population_size must be a positive multiple of 4"):
        runs.train_tiny(tmp_path / "other", **settings, population_size=2)


TRANSFERS: dict[str, tuple[str, str, dict[str, Any], dict[str, Any]]] = {
    # The level's run: the level; the environment; settings that are asked for; settings that it has then.
    "point": (
        "primitive", "point-gather", {"controller_interval": 5},
        {**BROUGHT, "primitive_hidden": (3, 2), "primitive_view": "proprioception", "controller_interval": 5,
         "primitive_checkpoint": "best", "freeze_primitive": True},
    ),
    "walker": (  # how it learned is its own affair
        "primitive", "ant-gather", {"population_size": 2, "controller_output": "heading_vector",
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
    path = runs.train_tiny(tmp_path / "run", env, **{kind: origin.path, **asked}, generations=1)
    assert values_of(path).items() >= {**expected, kind: str(origin.path)}.items()
    start, end, brought = level(path, "0", kind), level(path, "last", kind), level(origin.path, "best", kind)
    assert same(start, brought)
    assert same(end, brought) == (kind == "primitive")  # which is frozen
    best, config = origin.load("best").generation, origin.read_record()["config"]
    told = {"run": str(origin.path), "env": config["run"]["env"], "checkpoint": "best", "generation": best}
    assert RunFolder(path).read_record()[kind] == {**told, "config": config}
    assert best > 0


def test_both_levels_may_come_from_other_runs(sources):
    given = {"controller": str(sources("controller")), "primitive": str(sources("plain"))}
    other = {"controller_interval": 9, "goal_distance": 3.0, "minimum_goal_distance": True}
    found = make_config("point-gather", "smoke", {**given, **other})
    assert found.values.items() >= {**given, **BY_CONTROLLER, **other}.items()  # what is suggested may be asked for


# What cannot be.

CONTRADICTIONS = [
    ("point", "point-gather", "goal_encoding", "angle", "unit_vector"),
    ("point", "point-gather", "clock_frequency", None, 1.5),
    ("point", "point-gather", "primitive_hidden", None, (3, 2)),
    ("ant", "ant-gather", "symmetry", "dihedral", "none"),
    ("controller", "point-gather", "controller_network", "equivariant", "mlp"),
    ("controller", "point-gather", "hidden", (5,), (4,)),
]


@pytest.mark.parametrize(("source", "env", "name", "asked", "trained"), CONTRADICTIONS)
def test_what_contradicts_the_level_is_refused(sources, tmp_path, source, env, name, asked, trained):
    kind, path = "controller" if source == "controller" else "primitive", sources(source)
    message = f"{name} is {asked!r}, but the {kind} of {path} was trained with {trained!r}. Omit --"
    with pytest.raises(ConfigError, match=re.escape(message + name.replace("_", "-"))):
        runs.train_tiny(tmp_path / "run", env, **{kind: str(path), name: asked})
    assert list(tmp_path.iterdir()) == []


OTHER_ROBOT = "it was trained on ant-flagrun for the ant, but .* has {}. Name a primitive of the same robot with"
MISFITS = {
    # The level's run; the environment; further settings; the message.
    "another robot": ("ant", "point-gather", {}, OTHER_ROBOT.format("the point")),
    "an external robot": ("walker", "gymnasium:shes/PointMaze-v0", {}, OTHER_ROBOT.format("an external robot")),
    "another task": ("two levels", "point-gather", {}, r"\nIt was trained on point-push: .*\nHere there is: "),
    "another specification": ("ant", "ant-gather", {"spec": "hiro"}, r"of specification shes and 8(.|\n)*on hiro and"),
    "a height": ("point", "point-fall", {}, r"9 inputs \((.|\n)*with the same --spec by shes train ant-flagrun"),
    "another controller": ("controller", "point-maze", {}, r"It was trained on point-gather: "),
}


@pytest.mark.parametrize("case", MISFITS)
def test_a_level_that_does_not_fit_is_refused_by_saying_why(sources, tmp_path, case):
    source, env, settings, message = MISFITS[case]
    kind, path = "controller" if source == "controller" else "primitive", sources(source)
    with pytest.raises(ConfigError, match=rf"the {kind} of {path} does not fit {env}(.|\n)*{message}"):
        runs.train_tiny(tmp_path / "run", env, **{kind: str(path), **settings})
    assert list(tmp_path.iterdir()) == []


def test_a_source_without_the_level_or_damaged_is_refused(sources, tmp_path):
    plain, flat = sources("plain"), runs.train_tiny(tmp_path / "flat", algorithm="es", generations=1)
    damaged = shutil.copytree(plain, tmp_path / "damaged")
    (damaged / "config.json").write_text("{")
    for settings, error, message in (
        ({"primitive": flat}, ConfigError, rf"{flat} has no primitive: its levels are policy\. Name a run with --prim"),
        ({"controller": plain}, ConfigError, "has no controller: its levels are primitive"),
        ({"primitive": plain, "primitive_checkpoint": "77"}, CheckpointError, r"no checkpoint .*000077\.npz\. There "),
        ({"primitive": damaged}, RunFolderError, r"config\.json cannot be read"),
    ):
        with pytest.raises(error, match=message):
            runs.train_tiny(tmp_path / "run", **settings)
    assert not (tmp_path / "run").exists()


def test_a_run_needs_the_folder_of_its_primitive_no_more(sources, tmp_path):
    source = shutil.copytree(sources("plain"), tmp_path / "source")
    settings = {"primitive": str(source), "freeze_primitive": False, "evaluation_interval": 1}
    whole = runs.train_tiny(tmp_path / "whole", **settings, generations=3)
    half = runs.train_tiny(tmp_path / "half", **settings, generations=1)
    shutil.rmtree(source)
    assert shes.load(half).goal is not None
    shes.resume(half, generations=3)
    assert runs.differences(whole, half) == []
    for other in ({"primitive": str(half)}, {"freeze_primitive": False}, {"algorithm": "es"}):
        with pytest.raises(ConfigError, match="would change the numbers of the run"):
            shes.resume(half, generations=4, **other)
