"""A stand-in for CuPy that needs no card: arrays that refuse what CuPy's refuse, and count what CuPy waits for.

`DeviceArray` holds one of NumPy's arrays; `strict_xp` is the array module that makes them. Refused are: mixing with
NumPy's arrays, conversion that nobody asked for, NumPy's generalised ufuncs (`np.matmul`, `np.vecdot`) and `ufunc.at`,
`np.linalg`, and Python's numbers where CuPy would compute in float16 or int8. A little is refused that CuPy allows: as
an index, lists and NumPy's arrays, which hide a transfer, and iteration over many, which is a loop over kernels.

`strict_xp.waits` counts what CuPy waits for the device for: transfers to the host, truth and numbers of arrays, and
whatever has a size that only the data tell.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

__all__ = ["DeviceArray", "DeviceModule", "strict_xp"]

_METHODS = frozenset(
    {"all", "any", "argmax", "argmin", "argsort", "astype", "clip", "copy", "cumsum", "fill", "flatten", "max", "mean"}
    | {"min", "prod", "ravel", "repeat", "reshape", "squeeze", "std", "sum", "swapaxes", "take", "transpose", "view"}
)
_FREE = frozenset({"shape", "dtype", "ndim", "size", "nbytes"})  # known without waiting for the device
_FEW = 4  # what may be unpacked: coordinates, kinds, a quaternion
_SIZED_BY_DATA = frozenset({"argwhere", "flatnonzero", "nonzero", "unique", "extract", "compress"})


class DeviceArray(NDArrayOperatorsMixin):
    """An array [...] that lives "on the device". Views share its memory; a single element is an array too."""

    __hash__ = None  # type: ignore[assignment] - as of every array

    def __init__(self, held: np.ndarray) -> None:
        """Hold `held` itself: writing here writes there."""
        self._held = held

    def get(self) -> np.ndarray:
        """Return a copy on the host, for which the device is waited for."""
        strict_xp.waits += 1
        return self._held.copy()

    def tolist(self) -> Any:
        """Return lists of Python's numbers; a wait."""
        return self.get().tolist()

    @property
    def T(self) -> "DeviceArray":  # noqa: N802 - NumPy's name
        return DeviceArray(self._held.T)

    def __getattr__(self, name: str) -> Any:
        if name in _FREE:
            return getattr(self._held, name)
        if name not in _METHODS:
            raise AttributeError(f"a device array has no {name!r}")
        method = getattr(self._held, name)
        return lambda *args, **kwargs: _wrap(method(*_held(args), **_held(kwargs)))

    def __array__(self, *args: Any, **kwargs: Any) -> np.ndarray:
        raise TypeError("implicit conversion of a device array to NumPy's: ask for it with `to_host`")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> "DeviceArray":
        if method != "__call__" or ufunc.signature is not None:
            raise TypeError(f"np.{ufunc.__name__}{'' if method == '__call__' else '.' + method} of device arrays")
        result = _call(ufunc, *inputs, **kwargs)
        return kwargs["out"][0] if "out" in kwargs else result

    def __array_function__(self, function: Callable[..., Any], types: Any, args: Any, kwargs: Any) -> Any:
        if function.__module__ != "numpy":
            raise TypeError(f"{function.__module__}.{function.__name__} of device arrays")
        return _call(function, *args, **kwargs)

    def __getitem__(self, index: Any) -> "DeviceArray":
        items = _index(index)
        if any(isinstance(item, np.ndarray) and item.dtype == np.bool_ for item in items):
            strict_xp.waits += 1
        return DeviceArray(self._held[items if Ellipsis in _plain(items) else (*items, Ellipsis)])

    def __setitem__(self, index: Any, value: Any) -> None:
        if not isinstance(value, DeviceArray) and not np.isscalar(value):
            raise TypeError(f"a device array is set from {type(value).__name__}: upload it with `xp.asarray`")
        self._held[_index(index)] = _held(value)

    def __matmul__(self, other: Any) -> "DeviceArray":
        return strict_xp.matmul(self, other)

    def __imatmul__(self, other: Any) -> "DeviceArray":
        raise TypeError("`@=` of device arrays")

    def __len__(self) -> int:
        return len(self._held)

    def __iter__(self) -> Iterator["DeviceArray"]:
        if len(self) > _FEW:
            raise TypeError(f"iteration over {len(self)} rows of a device array")
        return (self[i] for i in range(len(self)))

    def __contains__(self, value: Any) -> bool:
        raise TypeError("search in a device array")

    def __bool__(self) -> bool:
        return bool(self.get())

    def __int__(self) -> int:
        return int(self.get())

    def __index__(self) -> int:
        return self.get().__index__()

    def __float__(self) -> float:
        return float(self.get())


class _DeviceUfunc:
    """A ufunc of the device's module: on its arrays alone, with an `at` of its own."""

    def __init__(self, ufunc: np.ufunc) -> None:
        self._ufunc = ufunc

    def __call__(self, *inputs: Any, **kwargs: Any) -> Any:
        return _call(self._ufunc, *inputs, **kwargs)

    def at(self, array: DeviceArray, indices: Any, *operands: Any) -> None:
        """Apply the ufunc in place at `indices`, which are arrays of the device."""
        if not isinstance(array, DeviceArray):
            raise TypeError(f"{self._ufunc.__name__}.at of {type(array).__name__}")
        items = _index(indices)
        self._ufunc.at(array._held, items if isinstance(indices, tuple) else items[0], *_held(operands))


class DeviceModule:
    """The array module of `DeviceArray`, with NumPy's names."""

    waits: int = 0
    """How often the device was waited for so far."""
    ndarray = DeviceArray

    def asarray(self, values: Any, dtype: Any = None) -> DeviceArray:
        """Return `values` on the device: itself if it is there, else a copy."""
        if isinstance(values, DeviceArray):
            return values if dtype in (None, values.dtype) else values.astype(dtype)
        return DeviceArray(np.array(values, dtype=dtype))

    def array(self, values: Any, dtype: Any = None) -> DeviceArray:
        """Return a copy of `values` on the device."""
        return DeviceArray(np.array(_held(values) if isinstance(values, DeviceArray) else values, dtype=dtype))

    def asnumpy(self, array: DeviceArray) -> np.ndarray:
        """Return a copy of `array` on the host; a wait."""
        return array.get()

    def __getattr__(self, name: str) -> Any:
        found = getattr(np, name)
        if isinstance(found, np.ufunc):
            return _DeviceUfunc(found)
        if isinstance(found, type) or not callable(found):
            return found  # a dtype or a constant
        return lambda *args, **kwargs: _call(found, *args, **kwargs)


strict_xp = DeviceModule()


def _call(function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Call NumPy's `function` on arrays of the device and numbers."""
    name = function.__name__
    if name in _SIZED_BY_DATA or (name == "where" and len(args) == 1):
        strict_xp.waits += 1
    result = function(*_held(args), **_held(kwargs))
    if isinstance(function, np.ufunc) or name == "where":
        _check_promotion(args[1:] if name == "where" else args, result)
    return _wrap(result)


def _check_promotion(values: tuple[Any, ...], result: Any) -> None:
    """Refuse Python's numbers beside truths or nothing: where NumPy takes its widest type, CuPy takes its smallest."""
    arrays = [value for value in values if isinstance(value, DeviceArray)]
    has_number = any(type(value) in (int, float) for value in values)
    if has_number and all(array.dtype == np.bool_ for array in arrays) and result.dtype != np.bool_:
        raise TypeError(f"Python's numbers beside nothing but truths are not {result.dtype} in CuPy")


def _held(value: Any) -> Any:
    """Return `value`, or everything in it, as what NumPy computes with; arrays of the host are refused."""
    if isinstance(value, np.ndarray):
        raise TypeError(f"an array of NumPy's {value.shape} among device arrays: upload it with `xp.asarray`")
    if isinstance(value, DeviceArray):
        return value._held
    if isinstance(value, (list, tuple)):
        return type(value)(_held(each) for each in value)
    return {name: _held(each) for name, each in value.items()} if isinstance(value, dict) else value


def _wrap(result: Any) -> Any:
    """Return what NumPy computed as the device's: numbers become arrays without axes."""
    if isinstance(result, (tuple, list)):
        return type(result)(_wrap(each) for each in result)
    return DeviceArray(np.asarray(result)) if isinstance(result, (np.ndarray, np.generic)) else result


def _index(index: Any) -> tuple[Any, ...]:
    """Return an index as NumPy's, if it is made of the device's arrays, slices and numbers."""
    items = index if isinstance(index, tuple) else (index,)
    for item in items:
        if isinstance(item, (list, np.ndarray)):
            raise TypeError(f"a device array is indexed with {type(item).__name__}: upload it with `xp.asarray`")
    return _held(items)


def _plain(items: tuple[Any, ...]) -> list[Any]:
    """Return the items of an index that are no arrays: those compare elementwise."""
    return [item for item in items if not isinstance(item, np.ndarray)]
