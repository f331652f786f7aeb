"""Golden trajectories: what an environment did when its numbers were last changed on purpose, it still does.

They are short episodes of every environment and specification, as JSON in this folder. Robots of Maze, Push and Fall
start in front of the wall or block that they are about to hit. `python -m tests.golden.test_trajectories` writes them
anew: after a change that is meant to change numbers (say so in CHANGELOG.md), or with a new version of MuJoCo, once the
difference has been looked at.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.contracts.variants import VARIANTS

TOLERANCE = 1e-6
"""Another processor rounds differently, and contacts let that grow; within two seconds it stays far below this."""
FOLDER = Path(__file__).parent
SEEDS = (11, 12, 13)
STARTS_M = {"maze": (0.0, 3.0), "push": (0.0, 3.0), "fall": (8.0, 3.0)}
"""Where robots start, relative to where a reset puts them: 1 m before the wall or block."""
OPTIONS = {"flagrun": {"controller_interval": 8}}
"""Options of a task: Flagrun's goals move within the stored steps."""


def title(variant):
    """Return the name that a variant goes by: the environment's, and the specification where it is not shes."""
    return variant.name if variant.spec == "shes" else f"{variant.name}-{variant.spec}"


def golden_file(variant):
    """Return where the golden trajectory of this environment and specification lies."""
    return FOLDER / f"trajectory_{title(variant)}.json"


def smooth_actions(num_actions, control_limit):
    """Return slow sine waves [step, action] of 80 % of the control range, each control with its own phase."""
    step, control = np.arange(20)[:, None], np.arange(num_actions)[None, :]
    return 0.8 * control_limit * np.sin(0.25 * step + 1.3 * control + 0.9)


def play(variant, shift=0.0):
    """Play an environment and return its trajectory; `shift` is added to the first velocity at the start."""
    _, kind = variant.name.split("-")
    task = variant.make_task(len(SEEDS), **OPTIONS.get(kind, {}))
    ids = np.arange(len(SEEDS))
    task.reset(ids, SEEDS)
    if kind in STARTS_M:
        task.sim.qpos[:, :2] += STARTS_M[kind]
        task.sim.qvel[:, 1] += 2.0  # they fly toward it at first
    task.sim.qvel[:, 0] += shift
    observations, rewards = [task.observe().copy()], []
    for step, action in enumerate(smooth_actions(task.action_size, task.control_limit), start=1):
        task.step(ids, np.tile(action, (len(ids), 1)))
        rewards.append(task.reward.copy())
        if step % 4 == 0:
            observations.append(task.observe().copy())
    return {
        "environment": title(variant),
        "mujoco": mujoco.__version__,
        "seeds": list(SEEDS),
        "rewards": np.array(rewards).T.tolist(),
        "scores": task.score.tolist(),
        "observations": np.array(observations).transpose(1, 0, 2).round(12).tolist(),
    }


def load(variant):
    return json.loads(golden_file(variant).read_text(encoding="utf-8"))


WHAT_TO_DO = (
    "{name} moves otherwise than its golden trajectory says, which is of MuJoCo {version}. With the same version, the"
    " task has changed: if that was not meant, undo it. With another one, read its changelog and check with `make"
    " test-all` that walls hold and scripts solve the tasks. To go on, `python -m tests.golden.test_trajectories`, pin"
    " the version in constraints.txt, and write 'changes numbers' into CHANGELOG.md."
)


@pytest.mark.parametrize("variant", VARIANTS, ids=title)
def test_an_environment_moves_as_its_golden_trajectory_says(variant):
    assert golden_file(variant).exists(), "no golden trajectory: run `python -m tests.golden.test_trajectories`"
    stored, played = load(variant), play(variant)
    message = WHAT_TO_DO.format(name=title(variant), version=stored["mujoco"])
    assert played["seeds"] == stored["seeds"], message
    for key in ("observations", "rewards", "scores"):
        np.testing.assert_allclose(played[key], stored[key], rtol=0, atol=TOLERANCE, err_msg=message)
    exact, *others = (np.array(each["observations"]) for each in (
        played, *(play(variant, shift) for shift in (1e-12, 1e-3))
    ))  # fmt: skip
    rounding, thousandth = (np.abs(exact - other)[:, 1:].max() for other in others)
    assert rounding < TOLERANCE / 100 < 10 * TOLERANCE < thousandth  # it is seen, and rounding is not


def test_golden_trajectories_hit_something_in_every_environment():
    """Otherwise they would not see a change of Gather's rewards, or of the contacts with walls and blocks."""
    assert {*FOLDER.glob("trajectory_*.json")} == {golden_file(variant) for variant in VARIANTS}
    assert any(np.any(load(each)["rewards"]) for each in VARIANTS if each.name.endswith("-gather"))
    for variant in VARIANTS:
        if variant.name.partition("-")[2] in STARTS_M:
            seen = np.array(load(variant)["observations"])
            assert (seen[:, :, 1].max(axis=1) > 3).all()  # they fly at what is 4 m away
            if "block_y" in (places := [element.name for element in variant.make_task(1).observation_spec]):
                assert (seen[:, -1, places.index("block_y")] > 0.01).any(), variant


def write(variant):
    """Store the trajectory of this environment: one line per observation, so that a difference can be read."""
    trajectory = play(variant)
    lines = [f' "{key}": {json.dumps(trajectory[key])},' for key in trajectory if key != "observations"]
    rows = [",\n  ".join(json.dumps(row) for row in episode) for episode in trajectory["observations"]]
    episodes = "],\n [".join(f"\n  {episode}" for episode in rows)
    text = "{\n" + "\n".join(lines) + f'\n "observations": [\n [{episodes}]\n ]\n' + "}\n"
    golden_file(variant).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    for each in VARIANTS:
        write(each)
        sys.stdout.write(f"wrote {golden_file(each)}\n")
