"""The stable time step of a scene, and what sets it (no Taichi).

A contact of two bodies swings with the half period pi sqrt(m*/k); velocity Verlet follows it well
with twenty steps.  The stiffness k grows with the overlap, so it is taken at an overlap that the
scene can reach: that of an impact at the highest speed to be expected, at least 2 % of the radius,
and as deep as the spheres already overlap at the start.  A substrate shared by many contacts makes
each of them softer, never stiffer; the base of a layer or periodic images make it stiffer, by what
is known of one contact alone.

The spring of a rolling law swings with pi sqrt(I/(k_r R*)), and is followed as well.  A dashpot,
which sees the velocity of half a step before, must not reverse it within a step: its step is half
of its time constant, m*/c.  That of friction also turns the spheres, and has 3.5/m* in place of
1/m*; as a share of the normal one it matters beyond about one half.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_dem.material import Material
from taichi_dem.scene import Scene

STEPS_PER_CONTACT = 20
STEP_OF_DASHPOT = 0.5  # of its time constant: a sphere may have several
LONGEST_WAY = 0.1  # of the smallest radius, in one step at the speed to be expected
LEAST_OVERLAP = 0.02  # of the effective radius
MOST_OVERLAP = 0.3
MOST_STIFFENED = 4.0  # by the base of a layer; wider contacts than that are warned of


@dataclass(frozen=True)
class StableStep:
    """``value`` (s) and what sets it, in words."""

    value: float
    reason: str


@dataclass(frozen=True)
class _Smallest:
    """The smallest sphere of one material, or a wall: infinite radius and, unless it moves freely
    under a load, infinite mass."""

    name: str
    material: Material
    curvature: float
    inverse_mass: float
    base: float = 0.0  # what it adds to a contact's compliance, m/N, <= 0

    def stiffened(self, stiffness: float) -> float:
        """The stiffness (N/m) of a contact on it, of ``stiffness`` by its law alone."""
        return stiffness / max(1 + self.base * stiffness, 1 / MOST_STIFFENED)


@dataclass(frozen=True)
class _Meeting:
    """Two bodies, with the effective radius (m), mass (kg) and moment of inertia (kg m2), and the
    overlap (m) that a contact of theirs can reach."""

    name: str
    radius: float
    mass: float
    inertia: float
    overlap: float
    speed: float

    def half_period(self, what: str, mass: float, stiffness: float) -> StableStep:
        half_period = math.pi * math.sqrt(mass / stiffness)
        reason = (
            f"1/{STEPS_PER_CONTACT} of the half period of {what}{self.name}, {half_period:.3g} s "
            f"at an overlap of {self.overlap:.2g} m (speeds up to {self.speed:.2g} m/s expected)"
        )
        return StableStep(half_period / STEPS_PER_CONTACT, reason)

    def decay(self, what: str, rate: float) -> StableStep:
        reason = (
            f"{STEP_OF_DASHPOT:g} of the time constant of the {what} dashpot of {self.name}, "
            f"{1 / rate:.3g} s at an overlap of {self.overlap:.2g} m"
        )
        return StableStep(STEP_OF_DASHPOT / rate, reason)


def stable_time_step(
    scene: Scene, coefficients: Mapping[str, Any], base: float = 0.0
) -> StableStep:
    """A twentieth of the shortest contact's half period, and short against what damps it and the
    way that a sphere goes in it; ``coefficients`` are the ``Coefficients`` of each law by slot,
    ``base`` is what the base of a layer adds to the compliance of a contact, m/N, <= 0."""
    speed, held = expected_speed(scene), _deepest_at_start(scene)
    bodies = [_smallest(scene, index) for index in range(len(scene.spheres.materials))]
    walls = [
        _Smallest(f"boundary {b}", wall.material, 0.0, _inverse_mass(wall, scene.spheres.count))
        for b, wall in enumerate(scene.boundaries)
    ]
    if scene.substrate:
        walls.append(_Smallest("the substrate", scene.substrate.material, 0.0, 0.0, base))
    candidates = [
        candidate
        for k, a in enumerate(bodies)
        for b in (*bodies[k:], *walls)
        for candidate in _of_contact(scene, coefficients, a, b, speed, held)
    ]
    if speed > 0:
        way = LONGEST_WAY * float(scene.spheres.radius.min())
        reason = f"the time for {LONGEST_WAY:g} of the smallest radius at {speed:.2g} m/s"
        candidates.append(StableStep(way / speed, reason))
    return min(candidates, key=lambda candidate: candidate.value)


def expected_speed(scene: Scene) -> float:
    """The closing speed (m/s) that the scene's own motion and height can lead to."""
    own = float(np.linalg.norm(scene.spheres.velocity, axis=1).max())
    gravity = float(np.linalg.norm(scene.gravity))
    fall = math.sqrt(2 * gravity * _fall_height(scene)) if gravity > 0 else 0.0
    walls = max((_wall_speed(wall) for wall in scene.boundaries), default=0.0)
    return 2 * own + fall + walls


def _fall_height(scene: Scene) -> float:
    """How far (m) the sphere with the longest way can fall: to a wall below it, or else as deep as
    the lowest sphere."""
    down = np.array(scene.gravity) / np.linalg.norm(scene.gravity)
    depth = scene.spheres.position @ down
    way = np.full(scene.spheres.count, np.inf)
    for point, normal in _faces(scene):
        if (steepness := float(-normal @ down)) > 0:
            way = np.minimum(way, (scene.spheres.position - point) @ normal / steepness)
    return float(np.where(np.isfinite(way), way, depth.max() - depth).max())


def _deepest_at_start(scene: Scene) -> float:
    """The largest overlap of the scene as it stands, over the effective radius."""
    position, radius = scene.spheres.position, scene.spheres.radius
    i, j, overlap = scene.spheres.overlapping(scene.period)
    deepest = (overlap * (1 / radius[i] + 1 / radius[j])).max(initial=0.0)
    for point, normal in _faces(scene):
        deepest = max(deepest, (1 - (position - point) @ normal / radius).max())
    return float(deepest)


def _faces(scene: Scene) -> list[Any]:
    walls: list[Any] = [*scene.boundaries, *([scene.substrate] if scene.substrate else [])]
    return [face for wall in walls for face in wall.faces()]


def _wall_speed(wall: Any) -> float:
    """The fastest that a wall moves along its normal, m/s."""
    velocity: Any = getattr(wall, "velocity", None)
    if isinstance(velocity, tuple):
        return max(abs(float(np.dot(velocity, normal))) for _, normal in wall.faces())
    if velocity is not None:
        return abs(float(velocity))
    program = getattr(wall, "program", None)
    if program:
        rows = np.array([(0.0, 0.0), *(row for row in program if row[0] > 0)])
        return float(np.abs(np.diff(rows[:, 1]) / np.diff(rows[:, 0])).max(initial=0.0))
    return 0.0


def _inverse_mass(wall: Any, spheres: int) -> float:
    """What a plate under load adds to 1/m*: a layer of the spheres may push it all at once."""
    mass = getattr(wall, "mass", None)
    return math.ceil(spheres ** (2 / 3)) / mass if mass else 0.0


def _smallest(scene: Scene, index: int) -> _Smallest:
    material = scene.spheres.materials[index]
    radius = float(scene.spheres.radius[scene.spheres.material_index == index].min())
    mass = material.density * 4 / 3 * math.pi * radius**3
    return _Smallest(f"the smallest {material.name}", material, 1 / radius, 1 / mass)


def _of_contact(
    scene: Scene,
    coefficients: Mapping[str, Any],
    a: _Smallest,
    b: _Smallest,
    speed: float,
    held: float,
) -> Iterator[StableStep]:
    """The limits of one kind of contact, at overlaps of ``held`` effective radii at least."""
    k = {slot: table.between(a.material, b.material) for slot, table in coefficients.items()}
    law, normal = scene.law, scene.law.normal
    radius, mass = 1 / (a.curvature + b.curvature), 1 / (a.inverse_mass + b.inverse_mass)
    inverse_inertia = sum(2.5 * body.inverse_mass * body.curvature**2 for body in (a, b))
    overlap = min(
        max(LEAST_OVERLAP * radius, _impact_overlap(normal, k["normal"], radius, mass, speed)),
        MOST_OVERLAP * radius,
    )
    overlap = max(overlap, held * radius)
    name = a.name if a is b else f"{a.name} on {b.name}"
    meeting = _Meeting(name, radius, mass, 1 / inverse_inertia, overlap, speed)
    stiffness = b.stiffened(normal.stiffness(k["normal"], radius, overlap))
    yield meeting.half_period("", mass, stiffness)
    dashpot = normal.dashpot(k["normal"], radius, mass, overlap)
    if dashpot > 0:
        yield meeting.decay("normal", dashpot / mass)
    if "tangential" in k and (tangential := k["tangential"]["damping"] * dashpot) > 0:
        turning = sum((3.5 if body.curvature else 1.0) * body.inverse_mass for body in (a, b))
        yield meeting.decay("tangential", tangential * turning)
    if "rolling" in k and law.rolling.history:
        spring = law.rolling.stiffness(k["rolling"], radius, stiffness) * radius
        if spring > 0:
            yield meeting.half_period("rolling of ", meeting.inertia, spring)
            damping = k["rolling"]["damping"] * math.sqrt(meeting.inertia * spring)
            if damping > 0:
                yield meeting.decay("rolling", damping / meeting.inertia)


def _impact_overlap(
    law: Any, k: Mapping[str, float], radius: float, mass: float, speed: float
) -> float:
    """Where stiffness * overlap^2 / 2, a bound on the energy stored, meets m v^2 / 2."""
    low, high = 0.0, MOST_OVERLAP * radius
    for _ in range(60):
        middle = 0.5 * (low + high)
        if law.stiffness(k, radius, middle) * middle**2 < mass * speed**2:
            low = middle
        else:
            high = middle
    return high
