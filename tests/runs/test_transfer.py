"""Transfer: what a primitive brings, what stays as it was, and what does not fit."""

import json
import re
import shutil

import numpy as np
import pytest

import shes
from shes.cli import main
from shes.errors import CheckpointError, ConfigError, RunFolderError
from shes.runs.build import build_algorithm
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from shes.runs.transfer import check_robot
from shes.training.make_config import make_config
from tests.e2e import runs

ANT = {
    "generations": 3,
    "evaluation_interval": 1,
    "keep_checkpoints": 1,
    "population_size": 4,
    "evaluation_episodes": 2,
}
POINT = {**ANT, "hidden": (3, 2)}
BROUGHT = {"goal_encoding": "unit_vector", "clock_frequency": 1.5, "hide_position": True}
ROBOT = {"ant": 29, "point": 4}


@pytest.fixture(scope="module")
def ant(tmp_path_factory):
    """A run that trained an ant's primitive alone. Not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("ant") / "flagrun", "ant-flagrun", **ANT, hidden=(5,))


@pytest.fixture(scope="module")
def ant_of(ant, tmp_path_factory):
    """Return a function that returns the same run of a specification. Not to be changed."""
    made = {"shes": ant}

    def find(spec):
        if spec not in made:
            folder = tmp_path_factory.mktemp("ant") / spec
            made[spec] = runs.train_tiny(folder, "ant-flagrun", **ANT, hidden=(5,), spec=spec)
        return made[spec]

    return find


@pytest.fixture(scope="module")
def point(tmp_path_factory):
    """A run that trained a point's primitive alone, with settings of its own. Not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("point") / "flagrun", "point-flagrun", **POINT, **BROUGHT)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The same with the settings that nobody has to say. Not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("plain") / "flagrun", "point-flagrun", **ANT)


def primitive(path, checkpoint):
    """Return the primitive of a checkpoint."""
    (found,) = [level for level in runs.state(path, checkpoint).levels if level.name == "primitive"]
    return found


def same(one, other):
    """Return whether the parameters and statistics of two primitives are bit-identical."""
    return (
        one.theta.tobytes() == other.theta.tobytes()
        and one.statistics.count == other.statistics.count
        and one.statistics.total.tobytes() == other.statistics.total.tobytes()
        and one.statistics.total_squares.tobytes() == other.statistics.total_squares.tobytes()
    )


TASKS = [
    pytest.param(task, spec, id=f"{task}-{spec}", marks=[] if spec == "shes" else [pytest.mark.slow])
    for task in ("gather", "maze", "push", "fall")
    for spec in ("shes", "hiro")
]


@pytest.mark.parametrize(("task", "spec"), TASKS)
def test_one_primitive_serves_every_task_of_its_robot_and_stays_as_it_was(ant_of, tmp_path, task, spec):
    """Two policies are a whole population: only the controller is mirrored."""
    ant = ant_of(spec)
    path = runs.train_tiny(
        tmp_path / "run", f"ant-{task}", primitive=str(ant), generations=2, population_size=2, spec=spec
    )
    config = RunFolder.open(path).read_config()
    assert (config.hierarchy.primitive_view, config.hierarchy.primitive_hidden, config.networks.hidden) == (
        "proprioception",
        (5,),
        (4,),
    )
    brought = primitive(ant, "best")
    assert brought.statistics.count > 0
    assert len(brought.statistics.total) == 3 + ROBOT["ant"]
    for checkpoint in ("0", "2", "last"):
        assert same(primitive(path, checkpoint), brought)
        assert primitive(path, checkpoint).optimizer.steps == 0
    controllers = [runs.state(path, name).levels[0] for name in ("0", "last")]
    assert not np.array_equal(controllers[0].theta, controllers[1].theta) or task == "gather"  # which pays nothing yet
    assert [level.statistics.count > 0 for level in controllers] == [False, True]
    assert np.isnan(read_csv(path / "progress.csv")["primitive_gradient_norm"]).all()


def test_an_unfrozen_primitive_learns_on_from_where_it_was(point, tmp_path):
    path = runs.train_tiny(tmp_path / "run", primitive=str(point), freeze_primitive=False, generations=2)
    brought, start, end = primitive(point, "best"), primitive(path, "0"), primitive(path, "last")
    assert same(start, brought)
    assert not np.array_equal(end.theta, brought.theta)
    assert end.statistics.count == brought.statistics.count + 2 * 8 * 20
    assert (start.optimizer.steps, end.optimizer.steps) == (0, 2)
    assert not np.isnan(read_csv(path / "progress.csv")["primitive_gradient_norm"]).any()


def test_an_unfrozen_primitive_needs_whole_groups_of_both_levels(point, tmp_path):
    with pytest.raises(ConfigError, match="population_size must be a positive multiple of 4"):
        runs.train_tiny(tmp_path / "run", primitive=str(point), freeze_primitive=False, population_size=2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_controller_begins_as_it_would_without(plain, tmp_path):
    alone = runs.train_tiny(tmp_path / "alone", generations=1)
    path = runs.train_tiny(tmp_path / "run", primitive=str(plain), generations=1)
    one, other = (runs.state(run, "0").levels[0] for run in (alone, path))
    assert one.theta.tobytes() == other.theta.tobytes()


def test_a_primitive_brings_what_it_was_trained_with(point, tmp_path):
    path = runs.train_tiny(tmp_path / "run", primitive=str(point), generations=1)
    sections = json.loads((path / "config.json").read_text())["config"]
    record = {name: value for section in sections.values() for name, value in section.items()}
    assert {name: record[name] for name in BROUGHT} == BROUGHT
    assert (record["primitive_hidden"], record["primitive_view"]) == ([3, 2], "proprioception")
    assert (record["primitive"], record["primitive_checkpoint"], record["freeze_primitive"]) == (
        str(point),
        "best",
        True,
    )
    origin = json.loads((path / "config.json").read_text())["primitive"]
    best = RunFolder.open(point).load("best").generation
    their_settings = RunFolder.open(point).read_record()["config"]
    assert origin == {
        "run": str(point), "env": "point-flagrun", "checkpoint": "best", "generation": best, "config": their_settings
    }  # fmt: skip
    assert best > 0
    # Goal 3, clock 2, robot 4 without x and y.
    assert len(primitive(path, "last").statistics.total) == 3 + 2 + ROBOT["point"] - 2


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("goal_encoding", "angle"),
        ("clock_frequency", 2.0),
        ("clock_frequency", None),
        ("hide_position", False),
        ("primitive_hidden", (3,)),
        ("primitive_hidden", None),
        ("primitive_view", "observation"),
    ],
)
def test_what_contradicts_the_primitive_is_refused(point, tmp_path, name, other):
    trained = {**BROUGHT, "primitive_hidden": (3, 2), "primitive_view": "proprioception"}[name]
    message = f"{name} is {other!r}, but the primitive of {point} was trained with {trained!r}. Omit --"
    with pytest.raises(ConfigError, match=re.escape(message + name.replace("_", "-"))):
        runs.train_tiny(tmp_path / "run", primitive=str(point), **{name: other})
    assert list(tmp_path.iterdir()) == []


def test_what_agrees_with_the_primitive_may_be_said(point, tmp_path):
    path = runs.train_tiny(
        tmp_path / "run", primitive=point, **BROUGHT, primitive_hidden=[3, 2], generations=1, controller_interval=5
    )
    config = RunFolder.open(path).read_config()
    assert (config.transfer.primitive, config.hierarchy.controller_interval) == (
        str(point),
        5,
    )  # the interval is the controller's affair


@pytest.mark.parametrize("checkpoint", ["last", "1"])
def test_any_checkpoint_of_the_run_may_be_brought(plain, tmp_path, checkpoint):
    path = runs.train_tiny(tmp_path / "run", primitive=str(plain), primitive_checkpoint=checkpoint, generations=1)
    assert same(primitive(path, "last"), primitive(plain, checkpoint))
    assert not same(primitive(plain, "last"), primitive(plain, "1"))


def test_the_command_line_brings_a_primitive(plain, tmp_path, capsys):
    words = ["train", "point-push", *runs.flags(**runs.TINY), "--generations", "1", "--out", str(tmp_path / "run")]
    assert main([*words, "--primitive", str(plain), "--primitive-checkpoint", "last", "--no-freeze-primitive"]) == 0
    config = RunFolder.open(tmp_path / "run").read_config()
    assert (config.transfer.primitive, config.transfer.primitive_checkpoint, config.transfer.freeze_primitive) == (
        str(plain),
        "last",
        False,
    )
    assert same(primitive(tmp_path / "run", "0"), primitive(plain, "last"))


# Walkers that see from their own frame.

WALKER = {"primitive_view": "egocentric", "symmetry": "dihedral", "clock_frequency": 1.2}


@pytest.fixture(scope="module")
def walker(tmp_path_factory):
    """A run that trained an ant's primitive from its own frame, through its symmetry. Not to be changed."""
    settings = {**ANT, "generations": 1, "primitive_estimate": "interval", "controller_interval": 4}
    path = tmp_path_factory.mktemp("walker") / "flagrun"
    return runs.train_tiny(path, "ant-flagrun", **settings, **WALKER, hidden=(5,))


@pytest.mark.parametrize("task", ["gather", pytest.param("maze", marks=pytest.mark.slow)])
def test_a_walker_brings_its_view_and_its_symmetry(walker, tmp_path, task):
    path = runs.train_tiny(
        tmp_path / "run", f"ant-{task}", primitive=str(walker), controller_output="heading_vector",
        controller_view="egocentric", generations=1, population_size=2,
    )  # fmt: skip
    config = RunFolder.open(path).read_config()
    assert {name: config.values[name] for name in WALKER} == WALKER
    assert (config.hierarchy.primitive_hidden, config.estimate.primitive_estimate) == (
        (5,),
        "episode",
    )  # how it learned is its affair
    brought = primitive(walker, "best")
    assert brought.statistics.count > 0
    assert len(brought.statistics.total) == 3 + 2 + 25
    assert same(primitive(path, "last"), brought)
    assert build_algorithm(config).design.symmetry.num_elements == 8


@pytest.mark.parametrize(("asked", "given"), [("rotation", "dihedral"), ("none", "dihedral")])
def test_a_walker_with_another_symmetry_is_refused(walker, tmp_path, asked, given):
    message = f"symmetry is {asked!r}, but the primitive of {walker} was trained with {given!r}. Omit --symmetry"
    with pytest.raises(ConfigError, match=re.escape(message)):
        runs.train_tiny(tmp_path / "run", "ant-gather", primitive=str(walker), symmetry=asked)
    assert list(tmp_path.iterdir()) == []


def test_a_primitive_that_was_trained_without_a_symmetry_gets_none(ant, tmp_path):
    message = f"symmetry is 'dihedral', but the primitive of {ant} was trained with 'none'. Omit --symmetry"
    with pytest.raises(ConfigError, match=re.escape(message)):
        runs.train_tiny(tmp_path / "run", "ant-gather", primitive=str(ant), symmetry="dihedral")
    with pytest.raises(ConfigError, match=r"primitive_view is 'egocentric', but the primitive .* 'proprioception'"):
        runs.train_tiny(tmp_path / "run", "ant-gather", primitive=str(ant), primitive_view="egocentric")
    assert list(tmp_path.iterdir()) == []


def test_a_walker_may_learn_on_upon_branches(walker, tmp_path):
    settings = {"primitive_estimate": "interval", "controller_interval": 4, "freeze_primitive": False}
    path = runs.train_tiny(tmp_path / "run", "ant-gather", primitive=str(walker), generations=1, **settings)
    assert same(primitive(path, "0"), primitive(walker, "best"))
    assert not np.array_equal(primitive(path, "last").theta, primitive(walker, "best").theta)


# Runs with a controller as sources.


@pytest.fixture(scope="module")
def hierarchy(tmp_path_factory):
    """A run with a controller whose primitive sees all of its observation. Not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("hierarchy") / "run", "point-push", primitive_hidden=(3,))


def test_the_primitive_of_a_run_with_a_controller_serves_the_same_task(hierarchy, tmp_path):
    path = runs.train_tiny(tmp_path / "run", "point-push", primitive=str(hierarchy), generations=2)
    config = RunFolder.open(path).read_config()
    assert (config.hierarchy.primitive_view, config.hierarchy.primitive_hidden) == ("observation", (3,))
    assert same(primitive(path, "last"), primitive(hierarchy, "best"))


def test_what_it_saw_of_one_task_does_not_fit_another(hierarchy, tmp_path):
    with pytest.raises(ConfigError, match=r"does not fit point-gather\.\n.*trained on point-push: .*\nHere there is: "):
        runs.train_tiny(tmp_path / "run", "point-gather", primitive=str(hierarchy))


@pytest.mark.slow
def test_one_that_saw_the_robot_alone_serves_every_task(tmp_path):
    source = runs.train_tiny(tmp_path / "source", "point-push", primitive_view="proprioception", generations=1)
    chain = source
    for task in ("point-gather", "point-maze"):  # and a run that was begun with it can be the next one's source
        path = runs.train_tiny(tmp_path / task, task, primitive=str(chain), generations=1)
        assert same(primitive(path, "last"), primitive(source, "best"))
        chain = path


# What cannot be.


@pytest.mark.parametrize(
    ("source", "env", "ours"),
    [
        ("ant", "point-gather", "the point with 2 controls of up to 1"),
        ("walker", "point-gather", "the point with 2 controls of up to 1"),
        pytest.param(
            "walker", "robotics-ant-maze", "an external robot with 8 controls of up to 1", marks=pytest.mark.extras
        ),
    ],
)
def test_a_primitive_of_another_robot_is_refused_by_saying_so(source, env, ours, request, tmp_path):
    path = request.getfixturevalue(source)
    message = (
        f"the primitive of {path} does not fit {env}: it was trained on ant-flagrun for the ant with 8 controls of up "
        f"to 30, but {env} has {ours}. Name a primitive of the same robot"
    )
    with pytest.raises(ConfigError, match=re.escape(message)):
        runs.train_tiny(tmp_path / "run", env, primitive=str(path))
    assert list(tmp_path.iterdir()) == []


def test_a_primitive_that_does_not_fit_is_refused_with_both_layouts(point, tmp_path):
    with pytest.raises(ConfigError) as error:
        runs.train_tiny(tmp_path / "run", "point-fall", primitive=str(point))
    first, theirs, ours, fix = str(error.value).splitlines()
    assert first == f"the primitive of {point} does not fit point-fall."
    assert theirs.startswith("It was trained on point-flagrun: 7 inputs (")
    assert theirs.endswith(") of specification shes and 2 controls of up to 1.")
    assert ours.startswith("Here there is: ")
    assert ours.endswith(") of specification shes and 2 controls of up to 1.")
    assert theirs.count(",") == 6
    assert "trained with the same --spec by shes train ant-flagrun or point-flagrun" in fix
    assert list(tmp_path.iterdir()) == []


def test_a_primitive_of_another_specification_is_refused(ant, tmp_path):
    with pytest.raises(ConfigError, match=r"of specification shes and 8(.|\n)*of specification hiro and 8"):
        runs.train_tiny(tmp_path / "run", "ant-gather", primitive=str(ant), spec="hiro")


def test_a_run_without_a_primitive_is_refused(tmp_path):
    source = runs.train_tiny(tmp_path / "source", algorithm="es", generations=1)
    with pytest.raises(
        ConfigError, match=rf"{source} has no primitive: its levels are policy\. Name a run with --prim"
    ):
        runs.train_tiny(tmp_path / "run", primitive=str(source))
    assert [path.name for path in tmp_path.iterdir()] == ["source"]


@pytest.mark.parametrize("command", ["python", "shes"])
def test_a_source_that_is_not_there_or_damaged_is_refused(plain, tmp_path, command, capsys):
    source = shutil.copytree(plain, tmp_path / "source")

    def refused(kind, message, *more, **settings):
        if command == "python":
            with pytest.raises(kind, match=message):
                runs.train_tiny(tmp_path / "run", **settings)
        else:
            words = ["train", "point-gather", *runs.flags(**runs.TINY, **settings), "--out", str(tmp_path / "run")]
            assert main(words) == 2
            assert re.search(message, " ".join(capsys.readouterr().err.split()))
        assert not (tmp_path / "run").exists()

    refused(RunFolderError, "gone does not exist", primitive=str(tmp_path / "gone"))
    (tmp_path / "empty").mkdir()
    refused(RunFolderError, "is not a run folder: it has no config.json", primitive=str(tmp_path / "empty"))
    refused(RunFolderError, "is no run folder, but there is one below it: give .*source", primitive=str(tmp_path))
    refused(
        CheckpointError,
        r"source has no checkpoint '77'; it has best, 0, 1, 2, 3, last\. Set --primitive-checkpoint to one of these\.",
        primitive=str(source),
        primitive_checkpoint="77",
    )
    best = source / "checkpoints" / "best.npz"
    whole = best.read_bytes()
    best.write_bytes(whole[:500])
    refused(CheckpointError, r"best\.npz is not a whole SHES checkpoint", primitive=str(source))
    best.write_bytes(whole)
    (source / "config.json").write_text("{")
    refused(RunFolderError, r"config\.json cannot be read", primitive=str(source))


def test_an_external_robot_cannot_have_an_egocentric_primitive():
    config = make_config("gymnasium:shes/PointMaze-v0", "smoke", {"primitive": "ant-walker"})
    with pytest.raises(
        ConfigError, match=r"primitive of ant-walker does not fit .* for the ant .* has an external robot"
    ):
        check_robot(config)


# Controllers.

BY_CONTROLLER = {"controller_output": "one_hot", "controller_view": "observation", "hidden": (4,)}
FROM_CONTROLLER = {"controller_interval": 7, "goal_distance": 2.5, "minimum_goal_distance": False}


@pytest.fixture(scope="module")
def steered(tmp_path_factory):
    """A run of two levels whose controller has settings of its own. Not to be changed."""
    settings = {**BY_CONTROLLER, **FROM_CONTROLLER, "generations": 2, "evaluation_interval": 2}
    return runs.train_tiny(tmp_path_factory.mktemp("steered") / "run", **settings)


def controller(path, checkpoint):
    return runs.state(path, checkpoint).levels[0]


def test_a_controller_brings_its_parameters_statistics_and_settings(steered, plain, tmp_path):
    settings = {"controller": steered, "controller_checkpoint": "last", "primitive": plain, "goal_distance": 3.0}
    path = runs.train_tiny(tmp_path / "run", generations=1, **settings)
    assert same(controller(path, "0"), controller(steered, "last"))
    assert same(primitive(path, "0"), primitive(plain, "best"))
    assert not same(controller(path, "last"), controller(steered, "last"))  # it learns on
    config = RunFolder.open(path).read_config()
    expected = {**BY_CONTROLLER, **FROM_CONTROLLER, "goal_distance": 3.0}
    assert {name: config.values[name] for name in expected} == expected
    record = json.loads((path / "config.json").read_text())
    origin = {"run": str(steered), "env": "point-gather", "checkpoint": "last", "generation": 2}
    assert record["controller"].items() >= origin.items()
    assert record["primitive"]["run"] == str(plain)


def test_an_equivariant_controller_brings_its_network(tmp_path):
    network = {"controller_network": "equivariant", "controller_view": "sectors"}
    settings = {**network, "controller_output": "heading_direction", "generations": 1}
    source = runs.train_tiny(tmp_path / "source", **settings)
    path = runs.train_tiny(tmp_path / "run", controller=str(source), generations=1)
    assert RunFolder.open(path).read_config().values.items() >= network.items()
    assert same(controller(path, "0"), controller(source, "best"))
    message = r"controller_network is 'mlp', but the controller of .* was trained with 'equivariant'\. Omit"
    with pytest.raises(ConfigError, match=message):
        runs.train_tiny(tmp_path / "other", controller=str(source), controller_network="mlp")


@pytest.mark.parametrize(("name", "other"), [("controller_output", "vector"), ("hidden", (5,))])
def test_what_contradicts_the_controller_is_refused(steered, tmp_path, name, other):
    message = f"{name} is {other!r}, but the controller of {steered} was trained with {BY_CONTROLLER[name]!r}. Omit --"
    with pytest.raises(ConfigError, match=re.escape(message + name.replace("_", "-"))):
        runs.train_tiny(tmp_path / "run", controller=str(steered), **{name: other})
    assert list(tmp_path.iterdir()) == []


def test_a_controller_that_does_not_fit_is_refused(steered, plain, tmp_path):
    """That of another task observes something else; a primitive alone, and plain S-ES, have none."""
    for message, env, settings in (
        (r"the controller of .* does not fit point-maze\.\nIt was trained on point-gather: ", "point-maze", {}),
        (r"has no controller: its levels are primitive\. Name a run", "point-gather", {"controller": str(plain)}),
        (r"controller is not a setting of a run of point-flagrun with .*Omit --controller", "point-flagrun", {}),
        (
            r"controller is not a setting of a run of point-gather with algorithm 'es'.*Omit --controller",
            "point-gather",
            {"algorithm": "es"},
        ),
    ):
        with pytest.raises(ConfigError, match=message):
            runs.train_tiny(tmp_path / "run", env, **{"controller": str(steered), **settings})
    assert list(tmp_path.iterdir()) == []


# Afterwards.


def test_a_run_needs_the_folder_of_its_primitive_no_more(plain, tmp_path):
    source = shutil.copytree(plain, tmp_path / "source")
    settings = {"primitive": str(source), "freeze_primitive": False, "evaluation_interval": 1}
    whole = runs.train_tiny(tmp_path / "whole", **settings, generations=3)
    half = runs.train_tiny(tmp_path / "half", **settings, generations=1)
    before = shes.evaluate(half, episodes=2, num_workers=1).summary()
    shutil.rmtree(source)
    assert shes.evaluate(half, episodes=2, num_workers=1).summary() == before
    agent = shes.load(half)
    assert agent.act(np.zeros(agent.observation_size)).shape == (2,)
    shes.resume(half, generations=3)
    assert runs.differences(whole, half) == []


def test_a_resume_cannot_bring_another_primitive(plain, tmp_path):
    path = runs.train_tiny(tmp_path / "run", generations=1)
    for settings in ({"primitive": str(plain)}, {"freeze_primitive": False}, {"algorithm": "es"}):
        with pytest.raises(ConfigError, match="would change the numbers of the run"):
            shes.resume(path, generations=2, **settings)
