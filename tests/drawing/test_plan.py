"""The plan of a world: its boxes to scale, without the robot."""

from collections import Counter

import mujoco
import numpy as np
import pytest

from shes.drawing.plan import plan_of
from shes.envs.registry import ENVIRONMENTS, make_task


def plan(name):
    return plan_of(make_task(name, 1).world_to_draw().compile())


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_start_is_free_and_walls_surround_it(name):
    found = plan(name)
    kinds = Counter(outline.kind for outline in found.outlines)
    assert kinds["wall"] >= 4
    assert kinds["block"] == name.endswith(("push", "fall"))
    for outline in found.outlines:
        low, high = outline.corners.min(axis=0), outline.corners.max(axis=0)
        if outline.kind != "platform":
            assert not ((low < 0) & (high > 0)).all()


def test_the_lowest_comes_first():
    kinds = [outline.kind for outline in plan("ant-fall").outlines]
    assert kinds == sorted(kinds, key=["platform", "wall", "block"].index)


def test_a_moving_box_that_is_no_block_belongs_to_the_robot():
    spec = mujoco.MjSpec()
    for name, x in (("block", 3.0), ("torso", 0.0)):
        body = spec.worldbody.add_body(name=name, pos=[x, 0, 1])
        body.add_freejoint()
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.5, 1, 1])
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 2, 3], pos=[9, 0, 3])
    block, table = plan_of(spec.compile()).outlines
    assert (block.kind, table.kind) == ("block", "wall")
    np.testing.assert_allclose(block.corners, [[2.5, -1], [3.5, -1], [3.5, 1], [2.5, 1]])
