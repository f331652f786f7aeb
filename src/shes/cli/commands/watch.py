"""`shes watch`: a run's policy in MuJoCo's window."""

from __future__ import annotations

from typing import Annotated

import tyro


def watch(
    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
    *,
    checkpoint: str = "best",
    seed: int | None = None,
) -> int:
    """Look at a run's policy in a window, episode after episode. It needs a display.

    Args:
        run: The run folder, or the name of a shipped agent.
        checkpoint: Which checkpoint: best, last or the number of a generation.
        seed: Seed of the episodes; a stream of the run's own, apart from its training, if none.
    """
    from shes.viewing.watch import watch as show

    show(run, checkpoint=checkpoint, seed=seed)
    return 0
