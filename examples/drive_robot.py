"""Drive a robot in plain MuJoCo with a policy that `shes export` wrote from a run of Flagrun.

`python drive_robot.py hexapod.xml policy.npz --goal 2 1`; docs/robots.md describes the steps.
"""

import argparse
from pathlib import Path

import mujoco
import numpy as np
from run_exported import ExportedAgent

FURTHEST = 6.0
"""Largest distance of a goal that the policy gets, times its scale. It was trained with near goals."""


def values_by_name(model, data):
    """Return the state of every joint by the names that observations have."""
    values = {}
    for i in range(model.njnt):
        joint = model.joint(i)
        qpos, qvel = data.qpos[joint.qposadr[0] :], data.qvel[joint.dofadr[0] :]
        if joint.type[0] == mujoco.mjtJoint.mjJNT_FREE:
            root = model.body(joint.bodyid[0]).name
            values |= {f"{root}_{name}": qpos[j] for j, name in enumerate(("x", "y", "z", "qw", "qx", "qy", "qz"))}
            values |= {f"{root}_{name}": qvel[j] for j, name in enumerate(("vx", "vy", "vz", "wx", "wy", "wz"))}
        else:
            values |= {joint.name: qpos[0], f"{joint.name}_velocity": qvel[0]}
    return values


def drive(model, agent, goal, seconds):
    """Walk towards `goal` (x, y) in metres from the first keyframe; yield time and distance after every second."""
    data, spec, step_s = mujoco.MjData(model), agent.spec, agent.spec["step_s"]
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    offset, factor = np.array(spec["control_map"])
    for step in range(round(seconds / step_s) + 1):
        values = values_by_name(model, data)
        observation = [values.get(name, 0.0) for name in spec["observation"]]  # a primitive does not see goal_*
        position = np.array(observation)[spec["pose"]["position"]]
        way = np.array(goal) - position
        if step % round(1 / step_s) == 0:
            yield step * step_s, np.hypot(*way)
        near = position + way * min(1, FURTHEST * spec["scale"] / max(np.hypot(*way), 1e-9))
        data.ctrl[:] = offset + factor * agent.act(observation, goal=near)
        mujoco.mj_step(model, data, round(step_s / model.opt.timestep))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot", nargs="?", default=Path(__file__).with_name("hexapod.xml"))
    parser.add_argument("policy", nargs="?", default="policy.npz")
    parser.add_argument("--goal", nargs=2, type=float, default=(2.0, 1.0), metavar=("X", "Y"))
    parser.add_argument("--seconds", type=float, default=10.0)
    args = parser.parse_args()
    model = mujoco.MjModel.from_xml_path(str(args.robot))
    for time, distance in drive(model, ExportedAgent(args.policy), args.goal, args.seconds):
        print(f"{time:3.0f} s: {distance:.2f} m to the goal")
