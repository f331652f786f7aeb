"""A worker for the tests of studies. Worker processes import this module."""

import os
import signal

from shes.studies.running import Outcome


class MortalWorker:
    """Runs nothing, and is killed at a run of the variant `deadly`, as by a system whose memory has run out."""

    def receive(self, state):
        pass

    def run(self, work, share):
        for number, cell in work:
            if cell.variant == "deadly":
                os.kill(os.getpid(), signal.SIGKILL)
            yield number, Outcome(cell=cell, error="done")

    def close(self):
        pass
