"""A stand-in for CuPy that needs no card: arrays that refuse what CuPy's refuse, and count what CuPy waits for.

`DeviceArray` holds one of NumPy's arrays; `strict_xp` is the array module that makes them. Refused are: mixing with
NumPy's arrays, conversion that nobody asked for, NumPy's generalised ufuncs (`np.matmul`, `np.vecdot`) and `ufunc.at`,
`np.linalg`, and Python's numbers where CuPy would compute in float16 or int8. A little is refused that CuPy allows: as
an index, lists and NumPy's arrays, which hide a transfer, and iteration over many, which is a loop over kernels.

`strict_xp.waits` counts what CuPy waits for the device for: transfers to the host, truth and numbers of arrays, and
whatever has a size that only the data tell.
"""

from functools import partial

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from shes.sim.simulator import CpuSimulator, Simulator

_METHODS = frozenset(
    {"all", "any", "argmax", "argmin", "argsort", "astype", "clip", "copy", "cumsum", "fill", "flatten", "max", "mean"}
    | {"min", "prod", "ravel", "repeat", "reshape", "squeeze", "std", "sum", "swapaxes", "take", "transpose", "view"}
)
_FREE = frozenset({"shape", "dtype", "ndim", "size", "nbytes"})  # known without waiting for the device
_FEW = 4  # what may be unpacked: coordinates, kinds, a quaternion
_SIZED_BY_DATA = frozenset({"argwhere", "flatnonzero", "nonzero", "unique", "extract", "compress"})


class DeviceArray(NDArrayOperatorsMixin):
    """An array [...] that lives "on the device". Views share its memory; a single element is an array too."""

    __hash__ = None

    def __init__(self, held):
        """Hold `held` itself: writing here writes there."""
        self._held = held

    def get(self):
        """Return a copy on the host, for which the device is waited for."""
        strict_xp.waits += 1
        return self._held.copy()

    def tolist(self):
        return self.get().tolist()

    __bool__, __int__, __float__ = (lambda self, kind=kind: kind(self.get()) for kind in (bool, int, float))

    @property
    def T(self):  # noqa: N802 - NumPy's name
        return DeviceArray(self._held.T)

    def __getattr__(self, name):
        if name in _FREE:
            return getattr(self._held, name)
        if name not in _METHODS:
            raise AttributeError(f"a device array has no {name!r}")
        method = getattr(self._held, name)
        return lambda *args, **kwargs: _wrap(method(*_to_numpy(args), **_to_numpy(kwargs)))

    def __array__(self, *args, **kwargs):
        raise TypeError("implicit conversion of a device array to NumPy's: ask for it with `to_host`")

    def __array_ufunc__(self, ufunc, method, *inputs, **kwargs):
        if method != "__call__" or ufunc.signature is not None:
            raise TypeError(f"np.{ufunc.__name__} ({method}) of device arrays")
        result = _call(ufunc, *inputs, **kwargs)
        return kwargs["out"][0] if "out" in kwargs else result

    def __array_function__(self, function, types, args, kwargs):
        if function.__module__ != "numpy":
            raise TypeError(f"{function.__module__}.{function.__name__} of device arrays")
        return _call(function, *args, **kwargs)

    def __getitem__(self, index):
        items = _index(index)
        if any(isinstance(item, np.ndarray) and item.dtype == np.bool_ for item in items):
            strict_xp.waits += 1
        return DeviceArray(self._held[items if any(item is Ellipsis for item in items) else (*items, Ellipsis)])

    def __setitem__(self, index, value):
        if not isinstance(value, DeviceArray) and not np.isscalar(value):
            raise TypeError(f"a device array is set from {type(value).__name__}: upload it with `xp.asarray`")
        self._held[_index(index)] = _to_numpy(value)

    def __matmul__(self, other):
        return strict_xp.matmul(self, other)

    def __len__(self):
        return len(self._held)

    def __iter__(self):
        if len(self) > _FEW:
            raise TypeError(f"iteration over {len(self)} rows of a device array")
        return (self[i] for i in range(len(self)))


class DeviceModule:
    """The array module of `DeviceArray`, with NumPy's names."""

    waits = 0
    """How often the device was waited for so far."""
    ndarray = DeviceArray

    def asarray(self, values, dtype=None):
        """Return `values` on the device: itself if it is there, else a copy."""
        if isinstance(values, DeviceArray):
            return values if dtype in (None, values.dtype) else values.astype(dtype)
        return DeviceArray(np.array(values, dtype=dtype))

    def __getattr__(self, name):
        found = getattr(np, name)
        if isinstance(found, type) or not callable(found):
            return found  # a dtype or a constant
        function = partial(_call, found)
        if isinstance(found, np.ufunc):
            function.at = partial(_apply_at, found)
        return function


strict_xp = DeviceModule()


class DeviceSimulator(Simulator):
    """MuJoCo on the CPU, seen through arrays of the device. Indices and states are arrays of the host."""

    starts_together = True

    def __init__(self, model, num_sims):
        self._cpu = CpuSimulator(model, num_sims)
        self.model, self.num_sims, self.xp = model, num_sims, strict_xp
        for name in ("qpos", "qvel", "ctrl", "diverged"):
            setattr(self, name, DeviceArray(getattr(self._cpu, name)))

    def reset(self, ids):
        self._on_host("reset", ids)

    def states(self, ids):
        return self._on_host("states", ids)

    def set_states(self, ids, states):
        self._on_host("set_states", ids, states)

    def step(self, ids, nstep):
        self._on_host("step", ids, nstep)

    def _on_host(self, name, *given):
        assert not any(isinstance(each, DeviceArray) for each in given)
        return getattr(self._cpu, name)(*given)


def _call(function, *args, **kwargs):
    """Call NumPy's `function` on arrays of the device and numbers."""
    name = function.__name__
    if name in _SIZED_BY_DATA or (name == "where" and len(args) == 1):
        strict_xp.waits += 1
    result = function(*_to_numpy(args), **_to_numpy(kwargs))
    if isinstance(function, np.ufunc) or name == "where":
        _check_promotion(args[1:] if name == "where" else args, result)
    return _wrap(result)


def _apply_at(ufunc, array, indices, *operands):
    """Apply `ufunc` in place at `indices`, which are arrays of the device."""
    items = _index(indices)
    ufunc.at(_to_numpy(array), items if isinstance(indices, tuple) else items[0], *_to_numpy(operands))


def _check_promotion(values, result):
    """Refuse Python's numbers with truths or nothing: where NumPy takes its widest type, CuPy takes its smallest."""
    has_number = any(type(value) in (int, float) for value in values)
    are_truths = all(value.dtype == np.bool_ for value in values if isinstance(value, DeviceArray))
    if has_number and are_truths and result.dtype != np.bool_:
        raise TypeError(f"Python's numbers with nothing but truths are not {result.dtype} in CuPy")


def _to_numpy(value):
    """Return `value`, or everything in it, as what NumPy computes with; arrays of the host are refused."""
    if isinstance(value, np.ndarray):
        raise TypeError(f"an array of NumPy's {value.shape} among device arrays: upload it with `xp.asarray`")
    if isinstance(value, DeviceArray):
        return value._held
    if isinstance(value, (list, tuple)):
        return type(value)(_to_numpy(each) for each in value)
    return {name: _to_numpy(each) for name, each in value.items()} if isinstance(value, dict) else value


def _wrap(result):
    """Return what NumPy computed as the device's: numbers become arrays without axes."""
    if isinstance(result, (tuple, list)):
        return type(result)(_wrap(each) for each in result)
    return DeviceArray(np.asarray(result)) if isinstance(result, (np.ndarray, np.generic)) else result


def _index(index):
    """Return an index as NumPy's, if it is made of the device's arrays, slices and numbers."""
    items = index if isinstance(index, tuple) else (index,)
    for item in items:
        if isinstance(item, (list, np.ndarray)):
            raise TypeError(f"a device array is indexed with {type(item).__name__}: upload it with `xp.asarray`")
    return _to_numpy(items)
