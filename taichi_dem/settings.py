"""The knobs that trade accuracy for time, and the values that they are tried at (no Taichi)."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from taichi_dem.scene import Scene
from taichi_dem.validation import InputError

FINEST_TOLERANCE, FINEST_RESIDUAL = 1e-8, 1e-10
EVERY = "every "  # so many steps; the ground is solved for at each of them
STEPS = (1.0, 1 / 2, 1 / 4, 1 / 8)  # of the stable step
REFERENCE_STEP = 1 / 32  # of the stable step
VALUES: dict[str, tuple[Any, ...]] = {  # from loose to tight
    "tolerance": (1e-2, 1e-4, 1e-6),
    "residual": (1e-1, 1e-2, 1e-4, 1e-6),
    "coupling": ("none", "point", "finite"),
    "exchange": ("lagged", "every 16", "every 8", "every 4", "every 2", "implicit"),
    "precision": ("single", "double"),
    "skin": (0.02, 0.05, 0.1, 0.2),  # smallest diameters
}
KNOBS = ("step", *VALUES)


@dataclasses.dataclass(frozen=True)
class Settings:
    """One way to compute a scene; None where the scene has nothing that the knob turns.

    ``step``: s, at most; ``tolerance``, ``residual`` as in ``Substrate``; ``exchange`` likewise, or
    "every m" (implicit every m steps, extrapolated between);
    ``coupling`` likewise, or "none" (contacts on the ground do not feel each other);
    ``precision``: "double" or "single"; ``skin``: m, None where it is tuned.
    """

    step: float
    tolerance: float | None = None
    residual: float | None = None
    coupling: str | None = None
    exchange: str | None = None
    precision: str = "double"
    skin: float | None = None

    @classmethod
    def of(cls, scene: Scene, step: float) -> Settings:
        """Those that a scene asks for."""
        ground = scene.substrate
        if ground is None:
            return cls(step)
        if ground.exchange == "none":
            return cls(step, ground.tolerance, ground.residual, "none")
        every = ground.exchange_every
        exchange = f"{EVERY}{every}" if every > 1 else ground.exchange
        return cls(step, ground.tolerance, ground.residual, ground.coupling, exchange)

    @classmethod
    def tightest(cls, scene: Scene, step: float) -> Settings:
        """The most accurate that a scene accepts, at a given step."""
        if scene.substrate is None:
            return cls(step)
        for coupling in reversed(VALUES["coupling"]):
            tight = cls(step, FINEST_TOLERANCE, FINEST_RESIDUAL, coupling, "implicit")
            if tight.accepted(scene):
                return tight
        return cls.of(scene, step)

    def applied(self, scene: Scene) -> Scene:
        """The scene computed so; raises ``InputError`` where that has no meaning."""
        ground = scene.substrate
        if ground is None or self.coupling is None:
            return scene
        changes: dict[str, Any] = {"tolerance": self.tolerance, "residual": self.residual}
        if self.coupling == "none":
            changes |= {"exchange": "none", "exchange_every": 1}
        else:
            changes |= {"coupling": self.coupling, **exchange_keys(self.exchange or "implicit")}
        return dataclasses.replace(scene, substrate=dataclasses.replace(ground, **changes))

    def accepted(self, scene: Scene) -> bool:
        """Whether the scene can be computed so."""
        try:
            self.applied(scene)
        except InputError:
            return False
        return True

    def but(self, knob: str, value: Any) -> Settings:
        """These with one knob turned; without exchange where nothing is coupled."""
        changed = dataclasses.replace(self, **{knob: value})
        if changed.coupling == "none":
            return dataclasses.replace(changed, exchange=None)
        return changed

    @property
    def every(self) -> int:
        """Steps from one exchange to the next."""
        return exchange_keys(self.exchange or "implicit")["exchange_every"]

    def at(self, step: float) -> Settings:
        """These with another step (s), and about as much time from one exchange to the next: that
        is what extrapolation errs by."""
        changed = dataclasses.replace(self, step=step)
        if self.every == 1:
            return changed
        every = int(self.every * self.step / step * (1 + 1e-9))
        return changed.but("exchange", f"{EVERY}{every}" if every > 1 else "implicit")


def exchange_keys(exchange: str) -> dict[str, Any]:
    """Those of ``Substrate`` for ``Settings.exchange``."""
    if exchange.startswith(EVERY):
        return {"exchange": "implicit", "exchange_every": int(exchange.removeprefix(EVERY))}
    return {"exchange": exchange, "exchange_every": 1}


def ladder(knob: str, scene: Scene, tight: Settings, stable: float) -> list[Settings]:
    """``tight`` with one knob turned to each value that is looser and that the scene accepts."""
    if knob == "step":
        return [tight.but("step", stable * share) for share in STEPS]
    if getattr(tight, knob) is None and knob != "skin":
        return []
    values = VALUES[knob]
    if knob == "skin":
        diameter = 2 * float(np.min(scene.spheres.radius))
        values = tuple(share * diameter for share in values)
    found = [tight.but(knob, value) for value in values]
    return [settings for settings in found if settings != tight and settings.accepted(scene)]
