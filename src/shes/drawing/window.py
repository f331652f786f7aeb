"""Windows that show poses in real time: MuJoCo's viewer (drag to rotate, scroll to zoom), or the environment's own."""

from __future__ import annotations

import atexit
import sys
import threading
import warnings
from collections.abc import Sequence
from time import monotonic, sleep
from typing import Any, TypeAlias

import mujoco

from shes.drawing.mujoco_renderer import ROBOT_BODY, add_markers, decorate
from shes.drawing.renderer import between, scale_of
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.markers import Marker
from shes.errors import ConfigError
from shes.types import F64Array

_FRAMES_PER_STEP = 3
_FONT, _CORNER = mujoco.mjtFontScale.mjFONTSCALE_150, mujoco.mjtGridPos.mjGRID_TOPLEFT
_CLOSE_TIMEOUT_S = 10.0


class Viewer:
    """A window by MuJoCo's viewer that shows one world."""

    def __init__(self, spec: mujoco.MjSpec, step_s: float) -> None:
        """Decorate the world of `spec` and open a window on it, if there is a screen; a `show` takes `step_s`."""
        from mujoco import viewer

        self._step_s, self._due = step_s, monotonic()
        self._qpos: F64Array | None = None
        self._model = decorate(spec).compile()
        self._data = mujoco.MjData(self._model)
        before = set(threading.enumerate())
        try:
            self._window = viewer.launch_passive(self._model, self._data, show_left_ui=False, show_right_ui=False)
        except RuntimeError as error:  # macOS without mjpython
            raise ConfigError(f"the viewer cannot start: {error}. On macOS run mjpython instead of python.") from error
        self._threads = set(threading.enumerate()) - before
        with self._window.lock():
            camera = self._window.cam
            camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, ROBOT_BODY
            camera.azimuth, camera.elevation, camera.distance = 90.0, -42.0, 13.0
        atexit.register(self.close)

    @property
    def is_open(self) -> bool:
        """Whether the window is open."""
        return self._window.is_running()

    def show(
        self, qpos: F64Array, markers: Sequence[Marker] = (), *, is_new_episode: bool = False, lines: Sequence[str] = ()
    ) -> None:
        """Move from the last pose to `qpos` [nq], with `markers` and `lines` of text, in the time of a control step."""
        start = qpos if self._qpos is None or is_new_episode else self._qpos
        self._qpos = qpos.copy()
        self._due = max(self._due, monotonic() - self._step_s)
        if lines:
            self._window.set_texts((_FONT, _CORNER, "\n".join(lines), None))
        for frame in range(1, _FRAMES_PER_STEP + 1):
            if not self.is_open:
                return
            with self._window.lock():
                self._data.qpos[:] = between(self._model, start, qpos, frame / _FRAMES_PER_STEP)
                mujoco.mj_forward(self._model, self._data)
                self._window.user_scn.ngeom = 0
                add_markers(self._window.user_scn, markers, scale_of(self._model))
            self._window.sync()
            self._due += self._step_s / _FRAMES_PER_STEP
            sleep(max(0.0, self._due - monotonic()))

    def close(self) -> None:
        """Close the window and wait for its threads, which must end before Python exits."""
        atexit.unregister(self.close)
        self._window.close()
        for thread in self._threads:
            thread.join(_CLOSE_TIMEOUT_S)


class PassthroughWindow:
    """The window of an environment that shows its own steps."""

    is_open = True

    def show(self, *step: Any, **looks: Any) -> None:
        """Do nothing: the environment has shown the step."""

    def close(self) -> None:
        """Do nothing: the environment closes it."""


Window: TypeAlias = Viewer | PassthroughWindow


def open_window(batch: EpisodeBatch) -> Window:
    """Return a window that shows the poses of `batch`; call it before the first reset.

    Raise ConfigError if there is no screen: MuJoCo's viewer would wait for ever, and other environments run unseen.
    """
    import glfw

    with warnings.catch_warnings(action="ignore"):  # GLFW warns about what the error below reports
        has_screen = bool(glfw.init())
    if not has_screen:
        where = "" if sys.platform == "darwin" else " (DISPLAY and WAYLAND_DISPLAY name none)"
        raise ConfigError(
            f"there is no screen to open a window on{where}. Make a video instead: shes render RUN --out walk.mp4, "
            'or render_mode="rgb_array".'
        )
    if batch.robot is None:
        batch.draw_by("human")
        return PassthroughWindow()
    return Viewer(batch.world_to_draw(), batch.step_s)
