"""MuJoCo on mujoco-warp: N simulations in lockstep, on a CUDA GPU or, for tests, on the CPU.

The arrays are float32 views of Warp's memory, as NumPy or CuPy arrays. The substeps of a control step and the kernels
around them (`warp_kernels`) are captured once in a graph and replayed. On a GPU this saves the launches; on the CPU it
saves the Python code between kernels, which dominates when few simulations run.

Differences from MuJoCo in C: the state is float32; the solver stops at a tolerance of 1e-6; a contact at the edge of
its margin may appear or not, by float32's rounding; box-box contacts have an additional corner (a block at rest against
walls); `diverged` is set at the end of the substep in which the state became bad, not at the start of the next.

Buffers for contacts (one that all simulations share) and constraints (one for each simulation) are allocated once. What
does not fit is left out of the physics, so an overflow is an error.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from shes.errors import ConfigError
from shes.sim.simulator import Simulator
from shes.sim.warp_device import WarpDevice, load_warp
from shes.types import IntArray

_MAX_CONTACTS = 2**31 - 1  # of all simulations together
_CONTACTS_PER_TOUCH = {int(mujoco.mjtGeom.mjGEOM_SPHERE): 1, int(mujoco.mjtGeom.mjGEOM_CAPSULE): 2}
"""Contacts of one geom with a plane or box; other shapes have `_CONTACTS_OF_OTHERS`."""
_CONTACTS_OF_OTHERS = 8
_TOUCHES_OF_OTHERS = 3  # geoms at once: a block touches the ground and two walls
_ROW_FIELDS = ("J", "type", "id", "pos", "margin", "D", "vel", "aref", "frictionloss")


def default_sizes(model: mujoco.MjModel) -> tuple[int, int]:
    """Return `nconmax` and `njmax` for every moving geom touching the ground, and blocks also touching walls.

    The number of contacts is doubled, because a pair of geoms takes a place while it is tested for contact.
    """
    contacts = 0
    for geom in np.flatnonzero(model.body_weldid[model.geom_bodyid] != 0):
        per_touch = _CONTACTS_PER_TOUCH.get(int(model.geom_type[geom]))
        contacts += _CONTACTS_OF_OTHERS * _TOUCHES_OF_OTHERS if per_touch is None else per_touch
    dimensions = int(model.geom_condim.max(initial=1))
    is_pyramid = model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    rows = max(1, 2 * (dimensions - 1)) if is_pyramid else dimensions
    single = (model.jnt_limited, model.tendon_limited, model.dof_frictionloss, model.tendon_frictionloss)
    others = sum(int(np.count_nonzero(each)) for each in single) + 6 * model.neq
    return max(8, 2 * contacts), max(8, rows * contacts + others)


class WarpSimulator(Simulator):
    """N simulations on one device. On the CPU the results of a simulation do not depend on the others.

    mujoco-warp 4.0 can add in a fixed order, but the order of its contacts and constraint rows is that of atomic
    operations: `_sort_contacts` and `_sort_constraints` are empty. So deterministic simulations order their rows here.
    """

    starts_together = True

    def __init__(
        self,
        model: mujoco.MjModel,
        num_sims: int,
        device: str = "cuda",
        nconmax: int | None = None,
        njmax: int | None = None,
        deterministic: bool = False,
    ) -> None:
        """Make `num_sims` simulations of `model` on `device`, in its default state.

        Args:
            model: A model whose state is qpos and qvel only.
            num_sims: Number of simulations.
            device: `warp-cpu` or `cuda`.
            nconmax: Size of the contact buffer per simulation, on average: contacts, or pairs of geoms close enough to
                be tested. By default from the model's geoms.
            njmax: Size of each simulation's constraint buffer: rows for contacts, joint limits, friction losses and
                equalities. By default from the model's geoms and limits.
            deterministic: Whether constraint rows (of a dense Jacobian) and sums are in a fixed order, so that results
                repeat bit by bit on a GPU; slower. Not for elliptic cones. Adhesion, SDFs and flexes are not covered.
        """
        self._device = WarpDevice(device)
        self._warp, self._mujoco_warp = load_warp()
        from shes.sim import warp_kernels

        self._kernels = warp_kernels
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_PHYSICS)
        if size != model.nq + model.nv:  # all that `reset` resets
            raise ConfigError(
                f"the Warp simulator supports models whose state is qpos and qvel ({model.nq + model.nv} numbers), got "
                f"one of {size}: activations, delays or plasticity. Use --device cpu."
            )
        if deterministic and model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC:
            raise ConfigError(
                "deterministic steps need pyramidal friction cones, but this model has elliptic ones. Omit "
                '--deterministic, or set cone="pyramidal" in the model\'s <option>.'
            )
        default = default_sizes(model)
        self.nconmax, self.njmax = nconmax or default[0], njmax or default[1]
        if num_sims * self.nconmax > _MAX_CONTACTS:
            raise ConfigError(
                f"{num_sims} simulations with room for {self.nconmax} contacts each are more than mujoco-warp "
                f"supports ({_MAX_CONTACTS:,}). Set --nconmax or --chunk-size lower."
            )
        self.model, self.num_sims, self.xp = model, num_sims, self._device.xp
        with self._warp.ScopedDevice(self._device.warp_device):
            self._allocate(deterministic)
        self._graphs: dict[int, Any] = {}
        self._timers: list[Callable[[], float]] = []  # of steps whose time is not in `_device_s` yet
        self._device_s = 0.0
        self.reset(np.arange(num_sims))

    def _allocate(self, deterministic: bool) -> None:
        wp, view = self._warp, self._device.view
        model = copy.copy(self.model)
        if deterministic:
            model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        try:
            self._model: Any = self._mujoco_warp.put_model(model)
        except (NotImplementedError, ValueError) as error:
            raise ConfigError(f"mujoco-warp does not run this model: {error} Use --device cpu.") from error
        self._model.opt.deterministic = deterministic
        self._model.opt.warn_overflow = 0  # no prints from kernels: `check_buffers` reports overflows
        self._model.callback.control = self._watch
        self._model.callback.contactfilter = self.align_tangents
        self._data: Any = self._mujoco_warp.make_data(model, self.num_sims, nconmax=self.nconmax, njmax=self.njmax)
        sims, data, contact = self.num_sims, self._data, self._data.contact
        self._arrays = arrays = self._kernels.Arrays()
        for name in ("qpos", "qvel", "time", "ctrl", "qacc", "qacc_smooth"):
            setattr(arrays, name, getattr(data, name))
        arrays.warmstart = data.qacc_warmstart
        arrays.default_qpos = wp.array(self.model.qpos0, dtype=wp.float32)
        arrays.wanted_ctrl = wp.zeros((sims, self.model.nu), dtype=wp.float32)
        arrays.kept = wp.zeros((sims, self.model.nq + 2 * self.model.nv + 1), dtype=wp.float32)
        arrays.active, arrays.diverged = (wp.zeros(sims, dtype=wp.bool) for _ in range(2))
        self._rows = rows = self._kernels.Rows()
        rows.nefc, rows.type, rows.id = data.nefc, data.efc.type, data.efc.id
        rows.geom, rows.geomcollisionid, rows.efc_address = contact.geom, contact.geomcollisionid, contact.efc_address
        rows.places = wp.zeros((sims, self.njmax), dtype=wp.int32)
        self._kept_rows = wp.zeros(data.efc.J.shape if deterministic else (0, 0, 0), dtype=wp.int32)
        self._peak_constraints, self._peak_contacts = (wp.zeros(size, dtype=wp.int32) for size in (sims, 1))
        self.qpos, self.qvel, self.ctrl = view(arrays.qpos), view(arrays.qvel), view(arrays.wanted_ctrl)
        self.diverged, self._active = view(arrays.diverged), view(arrays.active)
        self.state_parts = (self.qpos, self.qvel, view(arrays.warmstart), view(arrays.time).reshape(sims, 1))

    def reset(self, ids: IntArray) -> None:
        """Reset simulations `ids` to the model's default state, time and the solver's warm start included."""
        ids = self.xp.asarray(ids)
        self.qpos[ids] = self.xp.asarray(self.model.qpos0, dtype=self.xp.float32)
        for array in (*self.state_parts[1:], self.ctrl, self.diverged):
            array[ids] = 0

    def step(self, ids: IntArray, nstep: int) -> None:
        """Advance simulations `ids` (sorted, unique) by `nstep` physics steps.

        All simulations are computed; the states of those that are not in `ids` are saved before and restored after.
        """
        if not len(ids):
            return
        self._active[:] = len(ids) == self.num_sims
        if len(ids) < self.num_sims:
            self._active[self.xp.asarray(ids)] = True
        if nstep not in self._graphs:
            self._graphs[nstep] = self._capture(nstep)
        with self._device.timed(self._timers):
            self._warp.capture_launch(self._graphs[nstep])

    @property
    def physics_s(self) -> float:  # type: ignore[override] - an attribute on the CPU
        """Seconds that the device has spent on steps so far; waits for the device."""
        while self._timers:
            self._device_s += self._timers.pop()()
        return self._device_s

    def check_buffers(self) -> None:
        """Check that the buffers have sufficed; waits for the device. See `Simulator.check_buffers`."""
        contacts, rows = int(self._peak_contacts.numpy()[0]), int(self._peak_constraints.numpy().max())
        if contacts > self.nconmax * self.num_sims:
            raise ConfigError(
                f"mujoco-warp's contact buffer overflowed: {contacts} contacts or close pairs of geoms in "
                f"{self.num_sims} simulations, room for {self.nconmax} each (nconmax), so some were left out. "
                f"Set --nconmax to {math.ceil(1.5 * contacts / self.num_sims)}."
            )
        if rows > self.njmax:
            raise ConfigError(
                f"mujoco-warp's constraint buffer overflowed: {rows} rows in one simulation, room for {self.njmax} "
                f"(njmax), so some were left out. Set --njmax to {math.ceil(1.5 * rows)}."
            )

    def _capture(self, nstep: int) -> Any:
        """Return the graph of `nstep` substeps. The first call compiles the kernels, which takes up to a minute."""
        wp, arrays = self._warp, self._arrays
        with wp.ScopedDevice(self._device.warp_device):
            if not self._graphs:  # a substep compiles every kernel; then the state is restored
                changed = (arrays.qpos, arrays.qvel, arrays.warmstart, arrays.time, arrays.diverged)
                copies = [wp.clone(array) for array in changed]
                self._launch(1)
                for array, copy in zip(changed, copies, strict=True):
                    wp.copy(array, copy)
            with wp.ScopedCapture() as capture:
                self._launch(nstep)
        return capture.graph

    def _launch(self, nstep: int) -> None:
        kernels, arrays = self._kernels, [self._arrays]
        self._launch_kernel(kernels.begin_control_step, arrays)
        for _ in range(nstep):
            self._mujoco_warp.step(self._model, self._data)
            self._launch_kernel(kernels.check_substep, arrays)
        self._launch_kernel(kernels.end_control_step, arrays)

    def _watch(self, model: Any, data: Any) -> None:
        """Record the use of the buffers and order rows. mujoco-warp calls this in every evaluation of the dynamics."""
        counts = [data.nefc, data.nacon, data.ncollision, self._peak_constraints, self._peak_contacts]
        self._launch_kernel(self._kernels.watch_buffers, counts)
        if model.opt.deterministic:
            self._warp.launch(self._kernels.find_places, dim=self._rows.places.shape, inputs=[self._rows])
            for array in (getattr(data.efc, name) for name in _ROW_FIELDS):
                values = array.view(self._warp.int32).reshape((*array.shape, 1)[:3])
                arguments = [self._rows, values, self._kept_rows]
                self._warp.launch(self._kernels.move_rows, dim=(self.num_sims, values.shape[2]), inputs=arguments)

    def align_tangents(self, model: Any, data: Any) -> None:
        """Align the tangents of capsule contacts with MuJoCo in C. mujoco-warp calls this after collision detection."""
        contact = data.contact
        arguments = [data.nacon, contact.geom, contact.worldid, model.geom_type, data.geom_xmat, contact.frame]
        self._warp.launch(self._kernels.align_capsules, dim=data.naconmax, inputs=arguments)

    def _launch_kernel(self, kernel: Any, arguments: list[Any]) -> None:
        self._warp.launch(kernel, dim=self.num_sims, inputs=arguments)
