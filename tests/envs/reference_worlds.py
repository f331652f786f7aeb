"""The worlds of all tasks as MJCF text, written independently of the package, for its tests.

Sources: docs/environments/index.md (it decides), then HrlMuJoCoEnvs.jl (easier_ant.xml, WorldStructure.jl), then
Nachum et al. 2018, efficient-hrl's maze_env.py. Decided here, where they are silent or differ:
- Cells are merged into few boxes. Platforms and the walls on them are two layers. The floor of Fall stays at z = 0.
- The block has the default friction, margin, contype and conaffinity of walls. One that cannot fall has no limits. A
  falling block's limit along y is as stiff as the contacts.
- The walls of hiro's Gather are 8 m thick and 4 m high, as all walls (rllab: 1 m and 1 m).
"""

import mujoco

HEIGHT = 4.0
ARENA = [(-16, 0, 4, 12), (16, 0, 4, 12), (0, -16, 20, 4), (0, 16, 20, 4)]
WALLS = {
    "gather": ARENA,
    "flagrun": ARENA,
    "hiro gather": [(-14.5, 0, 4, 10.5), (14.5, 0, 4, 10.5), (0, -14.5, 18.5, 4), (0, 14.5, 18.5, 4)],
    "maze": [(8, -8, 20, 4), (-8, 0, 4, 4), (0, 8, 12, 4), (24, 8, 4, 12), (-8, 16, 4, 4), (8, 24, 20, 4)],
    "push": [
        *((0, -8, 20, 4), (12, 0, 8, 4), (-16, 4, 4, 8), (16, 8, 4, 4)),
        *((-12, 16, 8, 4), (12, 16, 8, 4), (0, 24, 20, 4)),
    ],
    "fall": [(4, -8, 16, 4), (-8, 12, 4, 16), (16, 12, 4, 16), (4, 32, 16, 4)],
}
"""Centre x and y, and half sizes along x and y."""
PLATFORMS = {"fall": [(4, 0, 16, 12), (-8, 16, 4, 4), (16, 16, 4, 4), (4, 28, 16, 8)]}
BLOCKS = {
    "push": """
    <body name="block" pos="0 8 2">
      <joint name="block_x" type="slide" axis="1 0 0" margin="0.01"/>
      <joint name="block_y" type="slide" axis="0 1 0" margin="0.01"/>
      <geom name="block" type="box" size="4 4 2" mass="0.0002" conaffinity="1"/>
    </body>""",
    "fall": """
    <body name="block" pos="8 8 6">
      <joint name="block_y" type="slide" axis="0 1 0" margin="0.01" range="-8 8" solimplimit="0.995 0.995 0.01"/>
      <joint name="block_z" type="slide" axis="0 0 1" margin="0.01" range="-4 0"/>
      <geom name="block" type="box" size="3.96 3.96 2" mass="0.001" conaffinity="1"/>
    </body>""",
}
WORLD = """
<mujoco>
  <option timestep="0.02" integrator="{integrator}"/>
  <default>
    <geom contype="1" conaffinity="0" condim="3" density="5" margin="0.01" friction="1 0.5 0.5"
          solref="0.02 1" solimp="{solimp} 0.01"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="40 40 40" conaffinity="1"/>
    <body name="torso" pos="0 0 {start}">{robot}
    </body>{boxes}
  </worldbody>
  <actuator>{motors}
  </actuator>
</mujoco>
"""
BOX = '\n    <geom type="box" pos="{} {} {}" size="{} {} 2" conaffinity="1"/>'
MOTOR = '\n    <motor joint="{0}" gear="{1}" ctrllimited="true" ctrlrange="-{2} {2}"/>'
TORSO = """
      <joint name="root" type="free" margin="0.01"/>
      <geom type="sphere" size="0.25"/>"""
LEG = """
      <body name="leg_{0}">
        <geom type="capsule" size="0.08" fromto="0 0 0 {1} {2} 0"/>
        <body name="upper_{0}" pos="{1} {2} 0">
          <joint name="hip_{0}" type="hinge" axis="0 0 1" range="-30 30" armature="1" damping="1"/>
          <geom type="capsule" size="0.08" fromto="0 0 0 {1} {2} 0"/>
          <body name="lower_{0}" pos="{1} {2} 0">
            <joint name="ankle_{0}" type="hinge" axis="{3}" range="{4}" armature="1" damping="1"/>
            <geom type="capsule" size="0.08" fromto="0 0 0 {5} {6} 0"/>
          </body>
        </body>
      </body>"""
LEGS = (
    (1, 0.2, 0.2, "-1 1 0", "30 70", 0.4, 0.4),
    (2, -0.2, 0.2, "1 1 0", "-70 -30", -0.4, 0.4),
    (3, -0.2, -0.2, "-1 1 0", "-70 -30", -0.4, -0.4),
    (4, 0.2, -0.2, "1 1 0", "30 70", 0.4, -0.4),
)
"""Number, x and y of the upper parts, axis and range of the ankle, and x and y of the lower part."""
SPHERE = '\n      <geom type="sphere" size="0.25" mass="0.33"/>'
SLIDE = '\n      <joint name="slide_{}" type="slide" axis="{}" ref="{}" damping="0.8"/>'


def world_xml(task, body, spec="shes"):
    """Return the world of `task` with robot `body`."""
    ground = HEIGHT if task in PLATFORMS else 0.0
    walls = WALLS["hiro gather" if (task, spec) == ("gather", "hiro") else task]
    layers = [(PLATFORMS.get(task, ()), 0.0), (walls, ground)]
    boxes = "".join(BOX.format(x, y, low + HEIGHT / 2, *half) for layer, low in layers for x, y, *half in layer)
    if body == "ant":
        start = ground + 0.75
        robot = TORSO + "".join(LEG.format(*each) for each in LEGS)
        motors = [MOTOR.format(f"{part}_{leg}", 1, 30) for leg in (4, 1, 2, 3) for part in ("hip", "ankle")]
    else:
        start = ground + 0.75 if ground else 0.5
        slides = [("x", "1 0 0", 0), ("y", "0 1 0", 0), ("z", "0 0 1", start)][: 3 if ground else 2]
        robot = SPHERE + "".join(SLIDE.format(*each) for each in slides)
        motors = [MOTOR.format(f"slide_{axis}", 6, 1) for axis in "xy"]
    return WORLD.format(
        integrator={"shes": "Euler", "hiro": "RK4"}[spec],
        solimp="0.995 0.995" if task in BLOCKS else "0.8 0.8",
        start=start,
        robot=robot,
        boxes=boxes + BLOCKS.get(task, ""),
        motors="".join(motors),
    )


def world(*names):
    """Return the model of `world_xml` with these arguments."""
    return mujoco.MjModel.from_xml_string(world_xml(*names))
