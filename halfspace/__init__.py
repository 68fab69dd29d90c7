"""Contacts on an elastic half-space: what the forces on some do to the surface under the others.

    ground = halfspace.HalfSpace(youngs_modulus, poissons_ratio)
    w, slope = ground.displacement(x, f)                 # at contacts, by the others
    ground.field(x, f, points)                           # depression anywhere
    halfspace.solve(ground, x, overlap, law).force       # forces in equilibrium
    halfspace.press(ground, x, radius, load=1e-3)        # spheres pressed in, under a load
    halfspace.draw_dents(ground, x, f, radius)           # the surface from above

`halfspace.reference` holds closed-form solutions. SI units; depressions are positive downward.
"""

from __future__ import annotations

import importlib
from typing import Any

from .choice import Choice
from .ground import HalfSpace
from .layers import Layer
from .pictures import draw_dents
from .plan import Plan
from .press import Pressed, press
from .solve import Equilibrium, NotConverged, solve
from .tangential import VectorHalfSpace, VectorPlan
from .viscoelastic import Viscoelastic

__all__ = [
    "Choice",
    "Equilibrium",
    "HalfSpace",
    "Layer",
    "NotConverged",
    "Plan",
    "Pressed",
    "VectorHalfSpace",
    "VectorPlan",
    "Viscoelastic",
    "draw_dents",
    "press",
    "reference",
    "solve",
]


def __getattr__(name: str) -> Any:
    if name == "reference":
        return importlib.import_module(".reference", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
