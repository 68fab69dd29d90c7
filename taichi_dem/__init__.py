"""Discrete elements on an elastic half-space.

Everything a script needs is here by name; what needs the kernel compiler is imported when it is
first used, so that ``import taichi_dem`` costs next to nothing.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "taichi_dem.validation": ("InputError",),
    "taichi_dem.scene": ("Box", "Material", "Piston", "Plane", "Scene", "Spheres"),
    "taichi_dem.substrate": ("Layer", "Relaxation", "Substrate"),
    "taichi_dem.contacts.cdt": ("CDT",),
    "taichi_dem.contacts.cdt_jkr": ("CDTJKR",),
    "taichi_dem.contacts.eepa": ("EEPA",),
    "taichi_dem.contacts.hertz": ("Hertz",),
    "taichi_dem.contacts.hooke": ("Hooke",),
    "taichi_dem.contacts.jkr": ("JKR",),
    "taichi_dem.contacts.mindlin": ("Mindlin",),
    "taichi_dem.contacts.multicontact": ("MultiContact",),
    "taichi_dem.contacts.law": ("Law",),
    "taichi_dem.guards": ("SimulationStopped",),
    "taichi_dem.simulation": ("Simulation",),
    "taichi_dem.studies": ("study",),
    "taichi_dem.output": ("Frames", "History", "Progress", "State", "Summary"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__version__ = "0.1.0"
__all__ = sorted(_HOME_OF)


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'taichi_dem' has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *_HOME_OF]
