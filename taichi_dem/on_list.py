"""What works on one contact list.  Its kernels hold the fields of that list: a list that has become
too short takes all of it anew."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from taichi_dem.boundaries import Boundaries
from taichi_dem.coefficients import Coefficients
from taichi_dem.contact_list import ContactList
from taichi_dem.control import Control
from taichi_dem.drivers import Drivers
from taichi_dem.effects import Effects
from taichi_dem.energy import Energy
from taichi_dem.exchange import Exchange
from taichi_dem.expansion_newton import ImplicitExpansions
from taichi_dem.expansions import Expansions
from taichi_dem.forces import Forces
from taichi_dem.geometry import Geometry
from taichi_dem.grid import Grid
from taichi_dem.integrate import Verlet
from taichi_dem.joint import JointExpansions
from taichi_dem.lagged_expansions import LaggedExpansions
from taichi_dem.meeting import Meeting
from taichi_dem.neighbors import Neighbors
from taichi_dem.particles import Particles
from taichi_dem.scene import Scene
from taichi_dem.sleep import Sleep
from taichi_dem.step import Step


@dataclass(frozen=True)
class Standing:
    """What stays while lists come and go."""

    scene: Scene
    effects: Effects
    coefficients: Mapping[str, Coefficients]
    control: Control
    meeting: Meeting
    particles: Particles
    boundaries: Boundaries
    grid: Grid
    exchange: Exchange | None
    sleep: Sleep | None

    @property
    def soil(self) -> int:
        """The index of the substrate's material, or -1."""
        substrate = self.scene.substrate
        return -1 if substrate is None else self.scene.materials.index(substrate.material)


class OnList:
    """A list of ``capacity`` contacts, with room for ``pairs`` of them on the spheres if a surface
    law needs that, and who works on it."""

    def __init__(self, standing: Standing, capacity: int, pairs: int):
        particles, boundaries = standing.particles, standing.boundaries
        control, effects, exchange = standing.control, standing.effects, standing.exchange
        self.contacts = ContactList(particles.count, capacity, effects)
        self.neighbors = Neighbors(
            particles,
            boundaries,
            self.contacts,
            standing.grid,
            control,
            standing.soil >= 0,
            effects,
        )
        self.expansions = _expansions(standing, self.contacts, pairs)
        self.forces = Forces(
            effects.law,
            effects,
            standing.coefficients,
            particles,
            boundaries,
            self.contacts,
            exchange,
            standing.soil,
            control,
            self.expansions,
        )
        verlet = Verlet(particles, control, effects.rotation)
        step = Step(self.forces, verlet, boundaries, exchange, control, standing.sleep)
        self.drivers = Drivers(step, standing.meeting)
        self.energy = Energy(self.forces, exchange, boundaries)

    def trees(self) -> Iterator[Any]:
        """The fields that are the list's own."""
        yield self.contacts.tree
        if self.expansions is not None:
            yield self.expansions.tree


def _expansions(standing: Standing, contacts: ContactList, pairs: int) -> Expansions | None:
    """What a surface law computes with."""
    law, tables = standing.effects.law, standing.coefficients
    if law.surface is None:
        return None
    geometry = Geometry(standing.particles, standing.boundaries, standing.soil)
    held = standing.effects.reach
    given = law.surface, tables["surface"].table, geometry, contacts, standing.control, held
    if law.surface.lagged:
        return LaggedExpansions(*given)
    needs: dict[str, Any] = {
        "normal": law.normal,
        "normal_table": tables["normal"].table,
        "pairs": pairs,
    }
    if standing.exchange is None:
        return ImplicitExpansions(*given, **needs)
    return JointExpansions(*given, **needs, exchange=standing.exchange)
