"""Robots as MJCF text: legs of one or two joints around a trunk."""

from pathlib import Path

import gymnasium
import numpy as np

from shes.envs.bodies.robot import Robot, RobotOptions

ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
"""Robots that come with Gymnasium."""
TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
"""A mesh."""
LEG = """
<body name="leg_{0}" pos="{1:.15f} {2:.15f} 0">
  <joint name="swing_{0}" axis="0 0 1" range="-40 40"/>
  <joint name="lift_{0}" axis="{3:.15f} {4:.15f} 0" range="-50 50"/>
  <geom type="capsule" fromto="0 0 0 {5:.15f} {6:.15f} -.25" size=".03"/>
</body>"""
MOTOR = '<motor joint="{}" ctrlrange="-2 2"/>'
SERVO = '<position joint="{}" kp="20"/>'
FILTER = '<position joint="{}" kp="20" timeconst=".02"/>'


def mjcf(*, trunk="", legs="", actuators="", before="", after="", root="<freejoint/>", place='pos="0 0 .5"'):
    """Return the text of a robot: `trunk` beside its sphere, `legs`, and what stands before and after the bodies."""
    body = f'<body name="trunk" {place}>{root}<geom size=".1"/>{trunk}{legs}</body>'
    option = '<option timestep="0.005" cone="elliptic"/><default><joint armature=".02" damping=".2"/></default>'
    return f"<mujoco>{option}{before}<worldbody>{body}</worldbody><actuator>{actuators}</actuator>{after}</mujoco>"


def walker(num_legs, *, actuator=MOTOR, **parts):
    """Return a robot of `num_legs` equal legs around its trunk, with an actuator for each joint."""
    legs, actuators = "", ""
    for leg in range(num_legs):
        angle = 2 * np.pi * (leg + 0.5) / num_legs
        c, s = np.cos(angle), np.sin(angle)
        legs += LEG.format(leg, 0.15 * c, 0.15 * s, -s, c, 0.2 * c, 0.2 * s)
        actuators += "".join(actuator.format(f"{joint}_{leg}") for joint in ("swing", "lift"))
    return mjcf(**{"legs": legs, "actuators": actuators, **parts})


def sides(left, right):
    """Return servos for a walker of four legs: the swings of the left ones have range `left`, the others `right`."""
    ranges = [f'{SERVO.format(f"swing_{leg}")[:-2]} ctrlrange="{left if leg < 2 else right}"/>' for leg in range(4)]
    return "".join(ranges) + "".join(SERVO.format(f"lift_{leg}") for leg in range(4))


def one_joint(actuator, *, joint="", **parts):
    """Return a robot with a single hinge `a`, and `b` of the same kind, driven by `actuator`."""
    legs = "".join(
        f'<body pos="0 {y} 0"><joint name="{name}" axis="0 1 0" {joint}/><geom size=".05" pos="0 0 -.2"/></body>'
        for name, y in (("a", 0.2), ("b", -0.2))
    )
    return mjcf(legs=legs, actuators=actuator, **parts)


def robot_of(folder, text, **options):
    """Return the robot of MJCF `text`, written into `folder`."""
    (folder / "robot.xml").write_text(text)
    return Robot(RobotOptions(robot=str(folder / "robot.xml"), **options))
