"""`shes watch`: shows an agent's episodes in a window, with its goals and what its controller sees."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Annotated

from shes.drawing.window import open_window
from shes.settings import Ge, checked
from shes.viewing.playback import Playback


@checked
def watch(run: Path | str, *, checkpoint: str = "best", seed: Annotated[int, Ge(0)] | None = None) -> None:
    """Show the episodes that `evaluate` runs in a window, in real time, until it is closed. It needs a display.

    The window also shows what the controller sees, in words, and what the agent's sensors read, if it has any (Gather).

    Args:
        run: The run folder, or the name of a shipped agent.
        checkpoint: Checkpoint: `best`, `last` or the number of a generation.
        seed: Seed of the episodes, as for `evaluate`.
    """
    playback = Playback(run, checkpoint, seed, sensors=True)
    window = open_window(playback.task)
    try:
        for episode in count():
            for number, step in enumerate(playback.play(playback.seed_of(episode))):
                if not window.is_open:
                    return
                lines = (*step.facts, *step.inputs)
                window.show(step.pose, step.markers, is_new_episode=number == 0, lines=lines)
    finally:
        window.close()
        playback.task.close()
