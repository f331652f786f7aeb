"""Animate how a search finds the path through the maze: `python examples/animate_search.py FILE.gif --run RUN`."""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.collections import LineCollection, PolyCollection

from shes.drawing.renderer import extent_of, outlines
from shes.runs.build import open_run
from shes.viewing.playback import Playback

FRAMES, STILL_FRAMES = 60, 20
"""Frames that show the growing search, and frames that show its result."""
COLOURS = {"wall": "0.45", "platform": "0.8", "block": "tab:brown"}


def main(run: str, file: Path) -> None:
    """Draw the archive of a run in the order in which the search found it, then the shortest path to the target."""
    archive = open_run(run).state.archive
    task = Playback(run, "best").task
    model = task.world_to_draw().compile()
    boxes = outlines(model, mujoco.MjData(model))
    left, bottom, right, top = extent_of(model)

    figure, axis = plt.subplots(figsize=(4, 4), layout="constrained")
    axis.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xticks=[], yticks=[])
    corners = [each.corners for each in boxes]
    axis.add_collection(PolyCollection(corners, facecolors=[COLOURS[each.kind] for each in boxes]))
    axis.add_patch(plt.Circle(task.target[0, :2], 5, color="tab:green", alpha=0.2))
    places = archive.positions[:, :2]
    tree = axis.add_collection(LineCollection([], colors="tab:blue", linewidths=0.8, alpha=0.7))
    (way,) = axis.plot([], [], color="tab:orange", linewidth=3)
    steps = np.stack([places[archive.parents], places], axis=1)  # [nodes, 2 ends, 2]

    def draw(frame: int) -> None:
        count = int(len(steps) * min(1.0, (frame + 1) / FRAMES) ** 2)
        tree.set_segments(list(steps[:count]))
        if frame >= FRAMES:
            way.set_data(*archive.way[:, :2].T)
        axis.set_title(f"{count} places reached" if frame < FRAMES else f"a path of {archive.way_steps} steps")

    animation = FuncAnimation(figure, draw, frames=FRAMES + STILL_FRAMES)
    animation.save(file, PillowWriter(fps=15), dpi=80)
    print(f"{file}: {len(steps)} places, a path of {archive.way_steps} steps")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", nargs="?", type=Path, default=Path("search.gif"))
    parser.add_argument("--run", default="ant-maze", help="run folder or shipped agent (default: %(default)s)")
    arguments = parser.parse_args()
    main(arguments.run, arguments.file)
