"""The two kinds of arrays that come in and go out: NumPy's, and PyTorch's tensors on any device.

What both have under one name and with one meaning is used as a method or an operator (`a @ b`,
`a.clip(0.0)`, `a.any()`, `a.sum(axis=1)`); the rest is asked of the array's kind. Small sums,
fields and pictures are reckoned in NumPy whatever came (`on_host`), the mesh and the coupled solve
in the kind that they were given. PyTorch is never imported here: who passes a tensor has done so.
No gradient goes through.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # or a tensor of the same shape, in float64
Result = TypeVar("Result")


class NumPy:
    """NumPy's arrays."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    def array(self, value: Any) -> Array:
        """`value` in float64, contiguous; no copy is made where it is that."""
        return cast(Array, np.asarray(host(value), dtype=np.float64, order="C"))

    def integers(self, count: int) -> Any:
        """(count,) of 32 bits, uninitialised."""
        return np.empty(count, np.int32)

    def whole(self, a: Array) -> Any:
        """The whole numbers up to `a`, >= 0, that index an array."""
        return a.astype(np.int64)

    def adapt(self, owner: Any) -> Any:
        """An object whose methods take NumPy's arrays, as one that takes this kind."""
        return owner

    def least_squares(self, a: Array, b: Array, cutoff: float) -> Array:
        """The s (k,) of least `|a s - b|`; singular values below `cutoff` of the largest do not
        count. a (n, k), n >= k or not; b (n,)."""
        return cast(Array, np.linalg.lstsq(a, b, rcond=cutoff)[0])

    def transform(self, grid: Array, torus: tuple[int, int], workers: int | None) -> Any:
        """Real Fourier transform of a grid (rows, columns), put into the corner of a torus."""
        from scipy import fft

        wave = fft.rfft(grid, n=torus[1], axis=1, workers=workers)
        return fft.fft(wave, n=torus[0], axis=0, overwrite_x=True, workers=workers)

    def back(self, wave: Any, rows: int, columns: int, workers: int | None) -> Array:
        """The first `rows` rows of what has this transform, `columns` wide. It may be overwritten.

        Rows that no contact reaches need not be transformed.
        """
        from scipy import fft

        wave = fft.ifft(wave, axis=0, overwrite_x=True, workers=workers)
        grid: Array = fft.irfft(wave[:rows], n=columns, axis=1, overwrite_x=True, workers=workers)
        return grid


@dataclass(frozen=True)
class Tensors:
    """PyTorch's tensors on one device."""

    torch: Any
    device: Any

    def __getattr__(self, name: str) -> Any:
        return getattr(self.torch, name)  # where, isfinite, stack

    def array(self, value: Any) -> Any:
        tensor = self.torch.as_tensor(value, dtype=self.torch.float64, device=self.device)
        return tensor.detach().contiguous()

    def zeros(self, shape: Any) -> Any:
        return self.torch.zeros(shape, dtype=self.torch.float64, device=self.device)

    def empty(self, shape: Any) -> Any:
        return self.torch.empty(shape, dtype=self.torch.float64, device=self.device)

    def integers(self, count: int) -> Any:
        return self.torch.empty(count, dtype=self.torch.int32, device=self.device)

    def maximum(self, a: Any, b: Any) -> Any:
        return self.torch.maximum(self.array(a), self.array(b))

    def minimum(self, a: Any, b: Any) -> Any:
        return self.torch.minimum(self.array(a), self.array(b))

    def cbrt(self, a: Any) -> Any:
        """Of what is not negative."""
        return a ** (1 / 3)

    def take(self, a: Any, index: Any) -> Any:
        return a[index]

    def whole(self, a: Any) -> Any:
        return a.long()

    def adapt(self, owner: Any) -> Any:
        return OnHost(owner)

    def least_squares(self, a: Any, b: Any, cutoff: float) -> Any:
        """As NumPy's; what is large stays where it is, and a few numbers go."""
        q, r = self.torch.linalg.qr(a)
        return self.array(NUMPY.least_squares(host(r), host(q.T @ b), cutoff))

    def transform(self, grid: Any, torus: tuple[int, int], workers: int | None) -> Any:
        wave = self.torch.fft.rfft(grid, n=torus[1], dim=1)
        return self.torch.fft.fft(wave, n=torus[0], dim=0)

    def back(self, wave: Any, rows: int, columns: int, workers: int | None) -> Any:
        wave = self.torch.fft.ifft(wave, dim=0)[:rows]
        return self.torch.fft.irfft(wave, n=columns, dim=1).contiguous()


Kind = NumPy | Tensors
NUMPY = NumPy()


def kind_of(*values: Any) -> Kind:
    """That of the first tensor among the values; without one, NumPy's."""
    torch: Any = sys.modules.get("torch")
    for value in values if torch else ():
        if isinstance(value, torch.Tensor):
            return Tensors(torch, value.device)
    return NUMPY


def host(value: Any) -> Any:
    """A tensor as NumPy's array, without a copy where they share memory; anything else as it is."""
    if kind_of(value) is NUMPY:
        return value
    return value.detach().cpu().numpy()


def largest(a: Any) -> float:
    """The largest magnitude; 0 of nothing."""
    return float(abs(a).max()) if len(a) else 0.0


def inner(a: Any, b: Any) -> float:
    """Their product; of long arrays, the bits of `a @ b` depend on the number of threads."""
    return float((a * b).sum())


def on_host(function: Callable[..., Result]) -> Callable[..., Result]:
    """A function of NumPy's arrays as one of any kind; it gives back what it was given."""

    @wraps(function)
    def call(*values: Any, **named: Any) -> Any:
        kind = kind_of(*values, *named.values())
        if kind is NUMPY:
            return function(*values, **named)
        named = {name: host(value) for name, value in named.items()}
        return _returned(kind, function(*map(host, values), **named))

    return call


def _returned(kind: Kind, value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return kind.array(value)
    if isinstance(value, tuple):
        return tuple(_returned(kind, part) for part in value)
    return on_host(value) if callable(value) else value


class OnHost:
    """What has methods of NumPy's arrays, for tensors."""

    def __init__(self, owner: Any) -> None:
        self._owner = owner

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._owner, name)
        return on_host(value) if callable(value) else value
