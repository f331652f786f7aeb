"""Compares two compiled models in all fields that the physics reads."""

import numpy as np

_PREFIXES = ("body_", "jnt_", "dof_", "geom_", "actuator_", "qpos")
_WITHOUT_MEANING = {"geom_rgba", "body_bvhadr", "body_bvhnum"}  # colours; bounding volumes follow from the geoms


def model_differences(model, other, but=()):
    """Return the differences in words; `but` names fields to ignore. Geoms are matched by body, type and position."""
    differences = [
        f"{size}: {getattr(model, size)} and {getattr(other, size)}"
        for size in ("nq", "nv", "nu", "nbody", "njnt", "ngeom", "npair", "nexclude", "neq", "ntendon")
        if getattr(model, size) != getattr(other, size)
    ]
    if differences:
        return differences
    orders = _geom_order(model), _geom_order(other)
    fields = [
        name for name in dir(model) if name.startswith(_PREFIXES) and isinstance(getattr(model, name), np.ndarray)
    ]
    assert {"geom_margin", "dof_armature", "jnt_range", "actuator_gear", "body_inertia"} <= set(fields)
    for name in fields:
        if name in _WITHOUT_MEANING or name in but:
            continue
        left, right = getattr(model, name), getattr(other, name)
        if name.startswith("geom_"):
            left, right = left[orders[0]], right[orders[1]]
        if not np.array_equal(left, right):
            differences.append(f"{name}: {left.tolist()} and {right.tolist()}")
    for name in dir(model.opt):
        left, right = getattr(model.opt, name), getattr(other.opt, name)
        if name.startswith("_") or callable(left) or f"opt.{name}" in but:
            continue
        if not np.array_equal(left, right):
            differences.append(f"opt.{name}: {left} and {right}")
    return differences


def _geom_order(model):
    keys = np.column_stack([model.geom_bodyid, model.geom_type, model.geom_pos, model.geom_size]).round(9) + 0.0
    return sorted(range(model.ngeom), key=lambda g: tuple(keys[g]))
