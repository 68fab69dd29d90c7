"""What there is: spheres, boundaries, substrate, laws and gravity, frozen and checked."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from taichi_dem.material import Material, distinct
from taichi_dem.overlaps import deep_overlaps
from taichi_dem.periodic import Period, narrow_problem, period_problem, wall_problems
from taichi_dem.shapes import Boundary, Box, Piston, Plane
from taichi_dem.spheres import Spheres
from taichi_dem.substrate import Substrate
from taichi_dem.validation import (
    InputError,
    Problem,
    first_few,
    set_vectors,
    unknown,
)

__all__ = ["Box", "Material", "Piston", "Plane", "Scene", "Spheres", "Substrate"]

DEEPEST_OVERLAP = 0.5  # of the smaller radius, at the start


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scene:
    """A whole problem; what cannot be simulated is refused with all reasons at once.

    Every sphere's centre must lie inside the boundaries and above the substrate, and no two
    spheres may overlap by more than half of the smaller radius. ``gravity`` is in m/s2. With
    ``period`` (Lx, Ly), m, spheres and substrate repeat themselves along x and y
    (:mod:`taichi_dem.periodic`); centres may lie in any cell. With ``sleep`` clusters of spheres
    that have come to rest are left out of the computation until they are touched
    (:mod:`taichi_dem.sleep`).
    """

    spheres: Spheres
    boundaries: tuple[Boundary, ...] = ()
    substrate: Substrate | None = None
    law: Any
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    period: Period | None = None
    sleep: bool = False

    def __post_init__(self) -> None:
        problems = [*self._kind_problems(), *set_vectors(self, "gravity")]
        problems.append(period_problem(self.period))
        problems += self._surface_problems()
        problems += self._creep_problems()
        problems += self._sleep_problems()
        if not any(problems):
            object.__setattr__(self, "boundaries", tuple(self.boundaries))
            problems += self._name_problems()
            narrow = self._period_problems()
            problems += narrow
            for k, boundary in enumerate(self.boundaries):
                where = f"inside boundaries[{k}]"
                problems += _outside_problems(self.spheres.position, boundary, where)
            if self.substrate:
                where = "above the substrate"
                problems += _outside_problems(self.spheres.position, self.substrate, where)
            if not any(narrow):  # where spheres may meet their own images
                problems += _overlap_problems(self.spheres, self.period)
        if found := [problem for problem in problems if problem]:
            raise InputError(found)

    @property
    def materials(self) -> tuple[Material, ...]:
        """The different ones in order of appearance: spheres, boundaries, substrate."""
        walls = [boundary.material for boundary in self.boundaries]
        ground = [self.substrate.material] if self.substrate else []
        return distinct([*self.spheres.materials, *walls, *ground])

    @classmethod
    def from_toml(cls, path: str | Path, overrides: tuple[str, ...] = ()) -> Scene:
        """Read a scene file; see :func:`taichi_dem.scene_file.read`."""
        from taichi_dem import scene_file

        return scene_file.read(path, overrides)[0]

    def to_toml(self, path: str | Path, run: Any = None) -> None:
        """Write a scene file that :meth:`from_toml` reads back equal; ``run``, a
        :class:`taichi_dem.run_plan.Run`, says how to run it."""
        from taichi_dem import scene_writer

        scene_writer.write(path, self, run)

    def _kind_problems(self) -> list[Problem | None]:
        def check(path: str, value: Any, kind: Any, what: str) -> Problem | None:
            return None if isinstance(value, kind) else Problem(path, value, f"must be {what}")

        if not isinstance(self.boundaries, (list, tuple)):
            return [Problem("boundaries", self.boundaries, "must be a list of boundaries")]
        return [
            check("spheres", self.spheres, Spheres, "Spheres"),
            *(
                check(f"boundaries[{k}]", boundary, Boundary, "a Plane, Box or Piston")
                for k, boundary in enumerate(self.boundaries)
            ),
            check("substrate", self.substrate, Substrate | None, "a Substrate or None"),
            None if hasattr(self.law, "normal") else Problem("law", self.law, "must be a Law"),
        ]

    def _period_problems(self) -> list[Problem | None]:
        if self.period is None:
            return []
        object.__setattr__(self, "period", tuple(float(side) for side in self.period))
        largest = float(self.spheres.radius.max())
        return [narrow_problem(self.period, largest), *wall_problems(self.boundaries)]

    def _surface_problems(self) -> list[Problem]:
        """A surface law and a substrate that gives, where nothing solves them together."""
        surface: Any = getattr(self.law, "surface", None)
        substrate = self.substrate
        if surface is None or not isinstance(substrate, Substrate):
            return []
        if substrate.exchange_every > 1:
            rule = "must be 1 with a surface law, whose expansions change at every step"
            return [Problem("substrate.exchange_every", substrate.exchange_every, rule)]
        if getattr(surface, "lagged", True):
            return []
        if substrate.exchange == "lagged":
            rule = (
                "must be 'implicit' with a surface law that is: ground that answers to the step "
                "before has no energy, which spheres that are solved for would need; or make the "
                "surface law's exchange 'lagged' too"
            )
            return [Problem("substrate.exchange", substrate.exchange, rule)]
        if substrate.relaxation is None:
            return []
        rule = (
            "must be 'lagged' on ground that creeps, whose equilibrium with the spheres' own "
            "surfaces nothing solves for"
        )
        return [Problem("law.surface.exchange", surface.exchange, rule)]

    def _creep_problems(self) -> list[Problem]:
        """A law of which nobody knows what share of its compliance creeps with the ground."""
        normal, substrate = getattr(self.law, "normal", None), self.substrate
        creeps = isinstance(substrate, Substrate) and substrate.relaxation is not None
        if not creeps or getattr(normal, "of_two_solids", False):
            return []
        rule = "must be Hertz with relaxation, which makes the ground's share of a contact creep"
        return [Problem("law.normal", normal, rule)]

    def _sleep_problems(self) -> list[Problem]:
        """Where somebody who is far away changes the forces on one who sleeps."""
        if not isinstance(self.sleep, bool):
            return [Problem("sleep", self.sleep, "must be true or false")]
        found: list[Problem] = []
        substrate = self.substrate
        if self.sleep and isinstance(substrate, Substrate) and substrate.exchange != "none":
            rule = "must be 'none' with sleep: a load elsewhere dents the ground under those asleep"
            found.append(Problem("substrate.exchange", substrate.exchange, rule))
        if self.sleep and getattr(self.law, "surface", None) is not None:
            rule = "must be left out with sleep: its contacts are solved for all together"
            found.append(Problem("law.surface", self.law.surface, rule))
        return found

    def _name_problems(self) -> list[Problem]:
        names = [material.name for material in self.materials]
        found = [
            Problem(f"materials.{name}", None, "the name stands for two different materials")
            for name in sorted({name for name in names if names.count(name) > 1})
        ]
        for pair in getattr(self.law, "pairs", None) or {}:
            found += [
                unknown("law.pairs", list(pair), name, names, "material")
                for name in pair
                if name not in names
            ]
        return found


def _outside_problems(
    position: np.ndarray, limit: Boundary | Substrate, where: str
) -> list[Problem]:
    beyond = np.max([(point - position) @ normal for point, normal in limit.faces()], axis=0)

    def rule(k: int) -> str:
        return f"the centre must be {where}; it is {beyond[k]:.3g} m beyond"

    return first_few("spheres.position", beyond >= 0, position, rule)


def _overlap_problems(spheres: Spheres, period: Period | None) -> list[Problem]:
    i, j, overlap = deep_overlaps(
        spheres.position,
        spheres.radius,
        DEEPEST_OVERLAP,
        period,
        lambda *_: spheres.overlapping(period),
    )
    pair_of = dict(zip(j.tolist(), range(len(j)), strict=True))
    wrong = np.zeros(spheres.count, dtype=bool)
    wrong[j] = True

    def rule(k: int) -> str:
        other, depth = int(i[pair_of[k]]), overlap[pair_of[k]]
        if (spheres.position[other] == spheres.position[k]).all():
            return f"has the same centre as sphere {other}"
        limit = DEEPEST_OVERLAP * spheres.radius[[other, k]].min()
        return f"overlaps sphere {other} by {depth:.3g} m; at most {limit:.3g} m is accepted"

    return first_few("spheres.position", wrong, spheres.position, rule)
