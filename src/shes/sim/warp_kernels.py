"""Kernels that run with mujoco-warp's own, in every substep.

mujoco-warp has no warning counters: a simulation that diverges continues with NaN. These kernels detect and reset it,
as `mj_step` does. One thread is one simulation. The launches are part of the captured graph, so the host is not
involved.
"""

# pyright: reportMissingModuleSource=false

from __future__ import annotations

import mujoco
import warp as wp

__all__ = ["align_capsules", "begin_control_step", "check_substep", "end_control_step", "find_places", "move_rows"]
__all__ += ["watch_buffers"]

_MAX_VALUE = wp.constant(wp.float32(mujoco.mjMAXVAL))
_PLANE = wp.constant(wp.int32(int(mujoco.mjtGeom.mjGEOM_PLANE)))
_CAPSULE = wp.constant(wp.int32(int(mujoco.mjtGeom.mjGEOM_CAPSULE)))
_CONTACT = wp.constant(wp.int32(int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)))  # the first of their types
_MAX_ID = wp.constant(wp.int64(1 << 19))
_MIN_LENGTH = wp.constant(wp.float32(1e-6))
"""Least angle in radians between a capsule and the plane's normal at which its contact is realigned."""


@wp.struct
class Arrays:
    """Arrays of N simulations: mujoco-warp's own, and what the kernels of a control step add."""

    qpos: wp.array2d[wp.float32]
    qvel: wp.array2d[wp.float32]
    warmstart: wp.array2d[wp.float32]
    time: wp.array[wp.float32]
    ctrl: wp.array2d[wp.float32]
    qacc: wp.array2d[wp.float32]
    qacc_smooth: wp.array2d[wp.float32]
    default_qpos: wp.array[wp.float32]
    wanted_ctrl: wp.array2d[wp.float32]
    kept: wp.array2d[wp.float32]
    active: wp.array[wp.bool]
    diverged: wp.array[wp.bool]


@wp.func
def _is_bad(values: wp.array2d[wp.float32], sim: wp.int32) -> wp.bool:
    """Return whether a row has a value that MuJoCo considers bad: NaN, infinite, or beyond mjMAXVAL."""
    found = wp.bool(False)
    for i in range(values.shape[1]):
        value = values[sim, i]
        if wp.isnan(value) or wp.abs(value) > _MAX_VALUE:
            found = True
    return found


@wp.func
def _set_default(sim: wp.int32, state: Arrays) -> None:
    for i in range(state.qpos.shape[1]):
        state.qpos[sim, i] = state.default_qpos[i]
    for i in range(state.qvel.shape[1]):
        state.qvel[sim, i] = 0.0
        state.warmstart[sim, i] = 0.0
    state.time[sim] = 0.0


@wp.kernel(enable_backward=False)
def begin_control_step(state: Arrays) -> None:
    """Copy the controls, detect bad values, and save the state of inactive simulations.

    Inactive simulations spend the step in the default pose, which has few contacts; `end_control_step` restores them.
    """
    sim = wp.tid()
    nq = state.qpos.shape[1]
    nv = state.qvel.shape[1]
    is_active = state.active[sim]
    if not is_active:
        for i in range(nq):
            state.kept[sim, i] = state.qpos[sim, i]
        for i in range(nv):
            state.kept[sim, nq + i] = state.qvel[sim, i]
            state.kept[sim, nq + nv + i] = state.warmstart[sim, i]
        state.kept[sim, nq + 2 * nv] = state.time[sim]
    bad_state = _is_bad(state.qpos, sim) or _is_bad(state.qvel, sim)
    bad_ctrl = _is_bad(state.wanted_ctrl, sim)
    if bad_state or not is_active:
        _set_default(sim, state)
    for i in range(state.ctrl.shape[1]):
        if bad_state or bad_ctrl or not is_active:
            state.ctrl[sim, i] = 0.0
        else:
            state.ctrl[sim, i] = state.wanted_ctrl[sim, i]
    if is_active and (bad_state or bad_ctrl):
        state.diverged[sim] = True


@wp.kernel(enable_backward=False)
def check_substep(state: Arrays) -> None:
    """Mark simulations that have diverged, and reset them with zero controls, as MuJoCo does.

    The unconstrained acceleration is checked too: if its square overflows float32, mujoco-warp's solver gives up and
    leaves an acceleration of 0, which is not bad by itself.
    """
    sim = wp.tid()
    bad_acceleration = _is_bad(state.qacc, sim) or _is_bad(state.qacc_smooth, sim)
    if bad_acceleration or _is_bad(state.qpos, sim) or _is_bad(state.qvel, sim):
        _set_default(sim, state)
        for i in range(state.ctrl.shape[1]):
            state.ctrl[sim, i] = 0.0
        if state.active[sim]:
            state.diverged[sim] = True


@wp.kernel(enable_backward=False)
def end_control_step(state: Arrays) -> None:
    """Restore the state of inactive simulations."""
    sim = wp.tid()
    if state.active[sim]:
        return
    nq = state.qpos.shape[1]
    nv = state.qvel.shape[1]
    for i in range(nq):
        state.qpos[sim, i] = state.kept[sim, i]
    for i in range(nv):
        state.qvel[sim, i] = state.kept[sim, nq + i]
        state.warmstart[sim, i] = state.kept[sim, nq + nv + i]
    state.time[sim] = state.kept[sim, nq + 2 * nv]


@wp.kernel(enable_backward=False)
def watch_buffers(
    num_constraints: wp.array[wp.int32],
    num_contacts: wp.array[wp.int32],
    num_pairs: wp.array[wp.int32],
    peak_constraints: wp.array[wp.int32],
    peak_contacts: wp.array[wp.int32],
) -> None:
    """Update the peak of each simulation's constraint rows, and that of the contacts or pairs of all simulations."""
    sim = wp.tid()
    peak_constraints[sim] = wp.max(peak_constraints[sim], num_constraints[sim])
    if sim == 0:
        peak_contacts[0] = wp.max(peak_contacts[0], wp.max(num_contacts[0], num_pairs[0]))


@wp.kernel(enable_backward=False)
def align_capsules(
    num_contacts: wp.array[wp.int32],
    geoms: wp.array[wp.vec2i],
    sims: wp.array[wp.int32],
    geom_type: wp.array[wp.int32],
    geom_xmat: wp.array2d[wp.mat33],
    frames: wp.array[wp.mat33],
) -> None:
    """Align the tangents of capsule-plane contacts with the capsule's axis, as MuJoCo in C does.

    mujoco-warp 4.0 does so only for capsules less steep than 60 degrees (it compares the length of the projected axis
    with 0.5, where C compares the axis itself). Legs are steeper, and with a pyramidal cone the tangents matter: by up
    to 0.6 m/s in a substep. One thread is one contact.
    """
    contact = wp.tid()
    if contact >= num_contacts[0]:
        return
    pair = geoms[contact]
    if pair[0] < 0 or pair[1] < 0:
        return
    if geom_type[pair[0]] != _PLANE or geom_type[pair[1]] != _CAPSULE:
        return
    rotation = geom_xmat[sims[contact], pair[1]]
    axis = wp.vec3(rotation[0, 2], rotation[1, 2], rotation[2, 2])
    frame = frames[contact]
    normal = wp.vec3(frame[0, 0], frame[0, 1], frame[0, 2])
    tangent = axis - normal * wp.dot(normal, axis)
    if wp.length(tangent) < _MIN_LENGTH:
        return
    tangent = wp.normalize(tangent)
    frames[contact] = wp.matrix_from_rows(normal, tangent, wp.cross(normal, tangent))


@wp.struct
class Rows:
    """The constraint rows of N simulations, in mujoco-warp's own arrays, and the place that each row moves to."""

    nefc: wp.array[wp.int32]
    type: wp.array2d[wp.int32]
    id: wp.array2d[wp.int32]
    geom: wp.array[wp.vec2i]
    geomcollisionid: wp.array[wp.int32]
    efc_address: wp.array2d[wp.int32]
    places: wp.array2d[wp.int32]


@wp.func
def _key(rows: Rows, sim: wp.int32, row: wp.int32) -> wp.int64:
    """Return a row's type and object. The object of a contact is its geoms, and its number among their contacts."""
    key = wp.int64(rows.id[sim, row])
    if rows.type[sim, row] >= _CONTACT:
        contact = rows.id[sim, row]
        pair = wp.int64(rows.geom[contact][0]) * _MAX_ID + wp.int64(rows.geom[contact][1])
        key = pair * _MAX_ID + wp.int64(rows.geomcollisionid[contact])
    return wp.int64(rows.type[sim, row]) * _MAX_ID * _MAX_ID * _MAX_ID + key


@wp.kernel(enable_backward=False)
def find_places(rows: Rows) -> None:
    """Find the places of rows in the order of their keys. Rows with the same key stay as they are."""
    sim, row = wp.tid()
    num_rows = wp.min(rows.nefc[sim], rows.places.shape[1])
    if row >= num_rows:
        return
    key = _key(rows, sim, row)
    place = wp.int32(0)
    offset = wp.int32(0)
    for other in range(num_rows):
        other_key = _key(rows, sim, wp.int32(other))
        if other_key < key or (other_key == key and other < row):
            place += 1
            offset += wp.where(other_key == key and rows.id[sim, other] == rows.id[sim, row], 1, 0)
    rows.places[sim, row] = place
    if rows.type[sim, row] >= _CONTACT:
        rows.efc_address[rows.id[sim, row], offset] = place


@wp.kernel(enable_backward=False)
def move_rows(rows: Rows, values: wp.array3d[wp.int32], kept: wp.array3d[wp.int32]) -> None:
    """Move the rows of an array to their places. One thread is one column of one simulation."""
    sim, column = wp.tid()
    num_rows = wp.min(rows.nefc[sim], rows.places.shape[1])
    for row in range(num_rows):
        kept[sim, row, column] = values[sim, row, column]
    for row in range(num_rows):
        values[sim, rows.places[sim, row], column] = kept[sim, row, column]
