"""Worlds of Maze, Push, Fall, Flagrun and Gather as MJCF text, written independently of the package, for its tests.

Sources: docs/environments/index.md (it decides), then sash-a/HrlMuJoCoEnvs.jl (src/WorldStructure.jl), then
Nachum et al. 2018, efficient-hrl's maze_env.py. The ant is easier_ant.xml of HrlMuJoCoEnvs.jl.

What these leave open about worlds, and how it is decided here:
- Unmerged boxes, one per cell, are the base; `merged=True` joins runs along a row, then equal runs of rows that follow
  each other. Platforms and the walls on them are two layers, and stay two boxes.
- In a world with a chasm every cell but the chasm is a platform, the walls' and the block's too; walls stand on it, at
  z 4 to 8; the floor stays at z 0, the bottom of the chasm.
- The block has the geoms' default friction (efficient-hrl; JR writes "0 0 0", which is the same: MuJoCo takes the
  larger friction of two geoms) and contype 1, conaffinity 1, so it meets robot, floor, walls and platforms.
- "margin 0.01" is the margin of the block's joint limits; its geom has the default margin, 0.01 too. MuJoCo 4.0 adds
  the margins of two geoms, so that every contact acts from 0.02 on (JR's and efficient-hrl's MuJoCo: 0.01).
- A falling block is limited to +-8 in y and [-4, 0] in z; one that cannot fall has no limits at all.
- The solimp of a world with a block is the default of all geoms: robot, floor, walls, platforms, block.
- Point: no limits on its slides; the floor takes contacts (the block of Push stands on it, the sphere is too high to
  touch it). In Fall the torso starts at z 4.75 like the ant's, its third qpos is the height itself (the slide has
  ref 4.75), all three slides have the same damping, there are two motors, and the floor and gravity act.
- Walls of the hiro Gather: inner faces at +-10.5; 8 thick and 4 high like all walls (rllab: 1 thick, 1 high).
"""

CELL = 8.0
HEIGHT = 4.0
TORSO = 0.75
TORSO_ABOVE_CHASM = 4.75
POINT_HEIGHT = 0.5

GATHER = ("#####", "#...#", "#.r.#", "#...#", "#####")
MAZE = ("#####", "#r..#", "###.#", "#...#", "#####")
PUSH = ("#####", "#.r##", "#.B.#", "##.##", "#####")
FALL = ("####", "#r.#", "#.B#", "#CC#", "#..#", "####")

INTEGRATORS = {"euler": "Euler", "rk4": "RK4", "implicitfast": "implicitfast"}
PLAIN_SOLIMP = "0.8 0.8 0.01"
BLOCK_SOLIMP = "0.995 0.995 0.01"

ANT = """
<mujoco model="reference_ant_gather">
  <compiler angle="degree" inertiafromgeom="true"/>
  <option timestep="0.02" integrator="Euler"/>
  <default>
    <joint limited="true" armature="1" damping="1"/>
    <geom contype="1" conaffinity="0" condim="3" density="5" margin="0.01" friction="1 0.5 0.5"
          solref="0.02 1" solimp="0.8 0.8 0.01"/>
    <motor gear="1" ctrllimited="true" ctrlrange="-30 30"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" pos="0 0 0" size="40 40 40" conaffinity="1"/>
    <body name="torso" pos="0 0 0.75">
      <joint name="root" type="free" limited="false" margin="0.01" armature="0" damping="0"/>
      <geom name="torso" type="sphere" size="0.25"/>
LEGS
    </body>
  </worldbody>
  <actuator>
MOTORS
  </actuator>
</mujoco>
"""
MOTOR = '    <motor name="{0}_{1}" joint="{0}_{1}"/>'
LEG = """
      <body name="leg_{0}" pos="0 0 0">
        <geom name="fixed_{0}" type="capsule" size="0.08" fromto="0 0 0 {1} {2} 0"/>
        <body name="upper_{0}" pos="{1} {2} 0">
          <joint name="hip_{0}" type="hinge" axis="0 0 1" range="-30 30"/>
          <geom name="upper_{0}" type="capsule" size="0.08" fromto="0 0 0 {1} {2} 0"/>
          <body name="lower_{0}" pos="{1} {2} 0">
            <joint name="ankle_{0}" type="hinge" axis="{3}" range="{4}"/>
            <geom name="lower_{0}" type="capsule" size="0.08" fromto="0 0 0 {5} {6} 0"/>
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
POINT = """
<mujoco model="reference_point">
  <option timestep="0.02" integrator="Euler" gravity="0 0 GRAVITY"/>
  <default>
    <geom contype="1" conaffinity="0" condim="3" density="5" margin="0.01" friction="1 0.5 0.5"
          solref="0.02 1" solimp="0.8 0.8 0.01"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" pos="0 0 0" size="40 40 40" conaffinity="1"/>
    <body name="torso" pos="0 0 START">
      <joint name="slide_x" type="slide" axis="1 0 0" damping="DAMPING"/>
      <joint name="slide_y" type="slide" axis="0 1 0" damping="DAMPING"/>
Z_SLIDE
      <geom name="torso" type="sphere" size="0.25" mass="0.33"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="slide_x" joint="slide_x" gear="GEAR" ctrllimited="true" ctrlrange="-1 1"/>
    <motor name="slide_y" joint="slide_y" gear="GEAR" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""


def world_xml(
    grid,
    body,
    *,
    integrator="euler",
    merged=False,
    gear=3.0,
    damping=0.4,
    block_margin=0.01,
    limit_solimp="0.9 0.95 0.001",
):
    """Return robot, floor, platforms, walls and block of `grid`.

    `gear` and `damping` are the point's. `block_margin` is that of the block's geom, `limit_solimp` that of a falling
    block's limits in y: what a stiffer or truer block would change; by default as specified, and MuJoCo's default.
    """
    has_chasm = any("C" in row for row in grid)
    boxes = layer(grid, "#.rB", 0.0, merged) if has_chasm else []
    boxes += layer(grid, "#", HEIGHT if has_chasm else 0.0, merged)
    text, block = robot_xml(body, has_chasm, gear, damping), ""
    if any("B" in row for row in grid):
        assert text.count(PLAIN_SOLIMP) == 1
        text = text.replace(PLAIN_SOLIMP, BLOCK_SOLIMP)
        block = block_xml(*centre_of(grid, "B"), has_chasm, block_margin, limit_solimp)
    return finished(text, boxes_xml(boxes) + block, integrator)


def hiro_gather_xml(body, *, integrator="rk4", gear=3.0, damping=0.4):
    """Return the arena of the hiro Gather: four walls with inner faces at +-10.5, 8 thick, 4 high."""
    inner, thick, high = 10.5, CELL / 2, HEIGHT / 2
    middle, outer = inner + thick, inner + 2 * thick
    boxes = [(0.0, y, high, outer, thick, high) for y in (-middle, middle)]
    boxes += [(x, 0.0, high, thick, inner, high) for x in (-middle, middle)]
    return finished(robot_xml(body, False, gear, damping), boxes_xml(boxes), integrator)


def ant_gather_xml():
    """Return the ant in the arena of the shes Gather."""
    return world_xml(GATHER, "ant", merged=True)


def cells_of(grid):
    """Yield the cells with their row and column."""
    for i, row in enumerate(grid):
        for j, cell in enumerate(row):
            yield cell, i, j


def centre_of(grid, sign):
    """Return x and y of the centre of the only cell with this sign; the robot's cell is the origin."""
    ((robot_i, robot_j),) = [(i, j) for cell, i, j in cells_of(grid) if cell == "r"]
    ((i, j),) = [(i, j) for cell, i, j in cells_of(grid) if cell == sign]
    return CELL * (j - robot_j), CELL * (i - robot_i)


def cell_at(grid, x, y):
    """Return the cell that holds (x, y), a wall outside the grid; used to redraw targets (`free_cells`)."""
    ((robot_i, robot_j),) = [(i, j) for cell, i, j in cells_of(grid) if cell == "r"]
    for cell, i, j in cells_of(grid):
        if abs(x - CELL * (j - robot_j)) < CELL / 2 and abs(y - CELL * (i - robot_i)) < CELL / 2:
            return cell
    return "#"


def layer(grid, cells, bottom, merged):
    """Return one box per cell whose sign is in `cells`, from z `bottom` to `bottom` + 4, or as few as merging leaves.

    A box is x, y, z of its centre and its half sizes.
    """
    # A rectangle of cells: first and last row, first and last column.
    rectangles = [(i, i, j, j) for cell, i, j in cells_of(grid) if cell in cells]
    if merged:
        rectangles = join(join(rectangles, along_row=True), along_row=False)
    ((robot_i, robot_j),) = [(i, j) for cell, i, j in cells_of(grid) if cell == "r"]
    boxes = []
    for first_i, last_i, first_j, last_j in rectangles:
        x, y = ((first_j + last_j) / 2 - robot_j) * CELL, ((first_i + last_i) / 2 - robot_i) * CELL
        half_x, half_y = (last_j - first_j + 1) * CELL / 2, (last_i - first_i + 1) * CELL / 2
        boxes.append((x, y, bottom + HEIGHT / 2, half_x, half_y, HEIGHT / 2))
    return boxes


def join(rectangles, along_row):
    """Join a pair of neighbours of the same width or height until there is none left."""
    for one in rectangles:
        for other in rectangles:
            if along_row:
                fit = one[:2] == other[:2] and one[3] + 1 == other[2]
            else:
                fit = one[2:] == other[2:] and one[1] + 1 == other[0]
            if fit:
                rest = [rectangle for rectangle in rectangles if rectangle not in (one, other)]
                return join([*rest, (one[0], other[1], one[2], other[3])], along_row)
    return rectangles


def robot_xml(body, is_elevated, gear, damping):
    """Return the robot and the floor without anything else."""
    if body == "ant":
        text = ANT.replace("LEGS", "".join(LEG.format(*each) for each in LEGS))
        motors = [MOTOR.format(part, leg) for leg in (4, 1, 2, 3) for part in ("hip", "ankle")]
        text = text.replace("MOTORS", "\n".join(motors))
        return text.replace(f'pos="0 0 {TORSO}"', f'pos="0 0 {TORSO_ABOVE_CHASM if is_elevated else TORSO}"')
    slide = f'      <joint name="slide_z" type="slide" axis="0 0 1" ref="{TORSO_ABOVE_CHASM}" damping="DAMPING"/>'
    for name, value in {
        "GRAVITY": "-9.81" if is_elevated else "0",
        "START": TORSO_ABOVE_CHASM if is_elevated else POINT_HEIGHT,
        "Z_SLIDE": slide if is_elevated else "",
        "GEAR": gear,
        "DAMPING": damping,
    }.items():
        text = (POINT if name == "GRAVITY" else text).replace(name, str(value))
    return text


def boxes_xml(boxes):
    return "".join(
        f'    <geom name="box_{number}" type="box" pos="{x} {y} {z}" size="{a} {b} {c}" conaffinity="1"/>\n'
        for number, (x, y, z, a, b, c) in enumerate(boxes)
    )


def block_xml(x, y, is_elevated, margin, limit_solimp):
    """Return the movable block: slides in x and y, or where there is a chasm in y and z."""
    if is_elevated:
        z, half, mass = HEIGHT + HEIGHT / 2, CELL / 2 * 0.99, 0.001
        slides = [
            ("y", "0 1 0", f'limited="true" range="-8 8" solimplimit="{limit_solimp}"'),
            ("z", "0 0 1", 'limited="true" range="-4 0"'),
        ]
    else:
        z, half, mass = HEIGHT / 2, CELL / 2, 0.0002
        slides = [("x", "1 0 0", 'limited="false"'), ("y", "0 1 0", 'limited="false"')]
    joints = "".join(
        f'<joint name="block_{name}" type="slide" axis="{axis}" {limits} margin="0.01" armature="0" damping="0"/>\n'
        for name, axis, limits in slides
    )
    size = f"{half} {half} {HEIGHT / 2}"
    geom = f'<geom name="block" type="box" size="{size}" mass="{mass}" margin="{margin}" conaffinity="1"/>'
    return f'<body name="block" pos="{x} {y} {z}">{joints}{geom}</body>\n'


def finished(text, more, integrator):
    """Put `more` at the end of the world and set the integrator."""
    text = text.replace("  </worldbody>", more + "  </worldbody>")
    return text.replace('integrator="Euler"', f'integrator="{INTEGRATORS[integrator]}"')
