"""What a user is warned of while a simulation runs."""

import inspect
import warnings
import weakref
from collections.abc import Mapping
from typing import Any

from taichi_dem.doubts import WORDS

MADE = 0.05  # of the largest part of the energy: so much from nothing is warned of
ROUNDING = 1e-9  # of the energy in the heights, at most


class Alerts(dict[str, int]):
    """How often each has been raised, by name; each is told once, at the line that called the
    ``owner``, in whose methods it comes up."""

    def __init__(self, owner: Any):
        super().__init__()
        self._owner = weakref.ref(owner)  # whose fields go when it does

    def tell(self, name: str, message: str, count: int = 1) -> None:
        """Warn, unless that has been done, and keep the ``count``."""
        if name not in self:
            frame, level = inspect.currentframe(), 1
            while frame and self._inside(frame.f_locals.get("self")):
                frame, level = frame.f_back, level + 1
            warnings.warn(message, RuntimeWarning, stacklevel=level)
        self[name] = count

    def _inside(self, who: Any) -> bool:
        return who is self or who is self._owner()

    def look_at_substrate(self, doubts: Mapping[str, int]) -> None:
        """Warn where its assumptions fail, as they have so often, by name."""
        for name, count in doubts.items():
            if count > self.get(name, 0):
                self.tell(name, WORDS[name], count)

    def look_at_energy(self, parts: dict[str, float], time_step: float, stable: float) -> None:
        """Warn where energy has come from nothing; its ``parts`` in J, steps in s."""
        others = dict(parts)
        made, height = others.pop("balance_error"), abs(others.pop("gravity"))
        most = max(abs(part) for part in others.values())
        if made > max(MADE * most, ROUNDING * height):
            self.tell(
                "energy",
                f"{made:.3g} J have come from nothing, beside {most:.3g} J in motion, contacts or "
                f"heat. The time step of {time_step:.3g} s may be too long: stable is "
                f"{stable:.3g} s",
            )
