"""Tasks on a simulator with device arrays: the results are the same, and the device is never waited for.

The device is a stand-in, `strict_arrays`: it computes with NumPy, so results are bit-identical, and refuses what CuPy
refuses.
"""

import numpy as np
import pytest

from shes.sim.simulator import CpuSimulator
from shes.types import to_host
from tests.contracts.variants import VARIANTS, Variant
from tests.envs.episodes import make_task
from tests.strict_arrays import DeviceArray, DeviceSimulator, strict_xp

NUM_EPISODES, STEPS = 6, 12
GOAL_INTERVAL = 5
SHOWN = (
    *("time", "reward", "running_return", "terminated", "fallen", "diverged", "score", "success"),
    *("position", "heading", "distance", "goal"),
)


def make_pair(variant):
    """Return a task with NumPy arrays, and the same task on the device."""
    interval = {"controller_interval": GOAL_INTERVAL} if variant.name.endswith("-flagrun") else {}
    return [
        make_task(variant.name, NUM_EPISODES, simulator, spec=variant.spec, **interval)
        for simulator in (CpuSimulator, DeviceSimulator)
    ]


def look(task):
    """Return every public array of a task, by name."""
    seen = {name: getattr(task, name) for name in SHOWN}
    return {name: array for name, array in seen.items() if array is not None} | task.counts | {"seen": task.observe()}


def assert_same(pair):
    """Check that the arrays of two tasks are bit-identical."""
    waits = strict_xp.waits
    shown = look(pair[1])
    assert strict_xp.waits == waits, "a task waited for the device to show something"
    for name, expected in look(pair[0]).items():
        assert isinstance(shown[name], DeviceArray), name
        found = to_host(shown[name])
        assert (found.shape, found.dtype) == (expected.shape, expected.dtype), name
        assert found.tobytes() == expected.tobytes(), name


def reset(pair, ids, seeds):
    for task in pair:
        task.reset(np.array(ids), seeds)
    assert_same(pair)


def play(pair, steps, ids=tuple(range(NUM_EPISODES))):
    """Step both tasks with the same actions, without waiting for the device."""
    rng = np.random.default_rng(len(ids))
    for _ in range(steps):
        action = rng.uniform(-1, 1, (NUM_EPISODES, pair[0].action_size)) * pair[0].control_limit
        pair[0].step(np.array(ids), action)
        waits = strict_xp.waits
        pair[1].step(np.array(ids), strict_xp.asarray(action))
        assert strict_xp.waits == waits, "a step waited for the device"
        assert_same(pair)


@pytest.mark.parametrize("variant", VARIANTS, ids="-".join)
def test_a_task_on_a_device_gives_the_same_without_waiting(variant):
    pair = make_pair(variant)
    waits = strict_xp.waits
    pair[1].reset(np.arange(NUM_EPISODES), range(NUM_EPISODES))
    assert strict_xp.waits == waits, "a reset waited for the device"
    reset(pair, range(NUM_EPISODES), range(NUM_EPISODES))
    play(pair, STEPS // 2)
    for task in pair:
        task.sim.qvel[1, 0] = 1e12  # diverges
        task.sim.qpos[2, task.body.num_qpos - 1] = 1.5
        if task.body.quaternion is not None:
            task.sim.qpos[2, 2] = 1.5  # has fallen
    play(pair, STEPS // 4)
    assert pair[0].diverged[1]
    reset(pair, [1, 4], [10, 2**70])
    play(pair, STEPS // 4, ids=(0, 1, 4))
    state = pair[0].states(np.array([3]))[0]
    for task in pair:
        task.set_way(np.arange(30.0).reshape(6, 5)[:, : 5 if "fall" in variant[0] else 2])
        task.reset(np.array([1, 4]), [3, 4], [None, state])  # the second begins on the way
    play(pair, 2, ids=(1, 4))
    expected, found = (repr([task.pose(3).tolist(), task.markers(3)]) for task in pair)
    assert found == expected


@pytest.mark.parametrize("spec", ["shes", "hiro"])
def test_gather_on_a_device_pays_the_same(spec):
    pair = make_pair(Variant("ant-gather", spec))
    reset(pair, range(NUM_EPISODES), range(NUM_EPISODES))
    objects = pair[0].objects.copy()
    for number in range(4):
        for task in pair:
            for episode in range(NUM_EPISODES):
                task.sim.qpos[episode, 0], task.sim.qpos[episode, 1] = objects[episode, number % 2, number].tolist()
            task.sim.qpos[number, 2] = 1.5  # has fallen
        play(pair, 1)
    assert pair[0].counts["food"].sum() > NUM_EPISODES
    assert pair[0].counts["poison"].sum() > NUM_EPISODES
    assert pair[0].score.any()


DEVICE, HOST = strict_xp.arange(6).reshape(2, 3), np.arange(6).reshape(2, 3)
MISTAKES = [
    *(lambda: DEVICE + HOST, lambda: HOST * DEVICE, lambda: np.where(DEVICE > 2, HOST, 0)),
    *(lambda: np.stack([DEVICE, HOST]), lambda: DEVICE[HOST[0, :2]], lambda: DEVICE.__setitem__(0, HOST[0])),
    *(lambda: np.asarray(DEVICE), lambda: HOST.__setitem__(0, DEVICE[0]), lambda: DEVICE.T @ HOST),
    *(lambda: np.matmul(DEVICE.T, DEVICE), lambda: np.maximum.at(DEVICE, 0, 1), lambda: np.linalg.norm(DEVICE)),
    *(lambda: list(strict_xp.arange(9)), lambda: np.where(DEVICE > 2, 1.0, 0.0)),  # iteration, float16
]
WAITS = [
    *(lambda: bool(DEVICE[0, 0]), DEVICE.get, DEVICE.tolist, lambda: float(DEVICE.sum())),
    *(lambda: np.flatnonzero(DEVICE), lambda: DEVICE[DEVICE > 2]),
]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_stand_in_refuses_what_does_not_work_on_a_device(mistake):
    with pytest.raises(TypeError):
        mistake()


def test_the_stand_in_counts_what_is_waited_for():
    before = strict_xp.waits
    for number, wait in enumerate(WAITS):
        wait()
        assert strict_xp.waits == before + number + 1, number
    assert DEVICE.any(axis=0).shape == np.sqrt(DEVICE[0]).shape == (3,)
    assert strict_xp.waits == before + len(WAITS)
