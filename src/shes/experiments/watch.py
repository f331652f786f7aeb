"""`shes watch`: an agent at work in a window, episode after episode, with its goals."""

from __future__ import annotations

from pathlib import Path

from shes.drawing.viewer import Viewer
from shes.envs.task import CONTROL_STEP_S
from shes.experiments.playback import Playback

__all__ = ["watch"]


def watch(run: Path | str, *, checkpoint: str = "best", seed: int | None = None) -> None:
    """Show the episodes that `evaluate` runs, one after another in real time, until the window is closed.

    Args:
        run: The run folder.
        checkpoint: `best`, `last` or the number of a generation.
        seed: Seed of the episodes, as `evaluate` takes it.

    Raises:
        RunFolderError: `run` is not a run folder.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: There is no screen, or `seed` is negative.
    """
    playback = Playback(Path(run), checkpoint, seed)
    viewer = Viewer(playback.make_spec(), CONTROL_STEP_S)
    try:
        episode = 0
        while viewer.is_open:
            for number, moment in enumerate(playback.play(playback.seed_of(episode))):
                if not viewer.is_open:
                    return
                viewer.show(moment.qpos, moment.markers, is_new_episode=number == 0)
            episode += 1
    finally:
        viewer.close()
