"""What a scene calls for, and why: everything else has no field and costs no arithmetic."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from taichi_dem.contacts.law import Law
from taichi_dem.scene import Scene, Substrate


@dataclass(frozen=True)
class Effect:
    """One thing that steps may do; ``reason`` says what calls for it or why it can be left out."""

    name: str
    on: bool
    reason: str


@dataclass(frozen=True)
class Effects:
    """The effects of a scene.

    law                 the scene's, without what makes neither force nor torque
    friction, rolling   tangential forces, rolling torques
    history             what contacts remember: names and types
    reach               how far past zero overlap a contact can be held, m, at most
    plastic             elastic forces take energy that they do not give back
    losses              what is lost is booked
    balanced            all energy is accounted for
    sleep               clusters at rest sleep
    asks_for            parts of a ``Contact`` that only some laws want
    """

    law: Law
    friction: bool
    rolling: bool
    history: dict[str, Any]
    reach: float
    plastic: bool
    losses: bool
    balanced: bool
    sleep: bool
    asks_for: frozenset[str]
    listed: tuple[Effect, ...]

    @property
    def rotation(self) -> bool:
        """Whether something can turn a sphere."""
        return self.friction or self.rolling

    @property
    def adhesion(self) -> bool:
        """Whether contacts are held past zero overlap."""
        return self.reach > 0


def effects_of(scene: Scene, energy_balance: bool = True) -> Effects:
    """The effects of ``scene``; ``energy_balance`` False leaves out what is lost."""
    idle = scene.law.idle([material.name for material in scene.materials])
    law = scene.law.without(*idle)
    normals = list(_normal_laws(scene))
    losing = [
        *(["friction"] if law.tangential is not None else []),
        *(["damping"] if any(normal.restitution < 1 for normal, *_ in normals) else []),
        *(["yielding and parting"] if any(normal.plastic for normal, *_ in normals) else []),
        *(["rolling"] if law.rolling is not None else []),
        *(["creep of the ground"] if _creeps(scene) else []),
    ]
    history = {name: kind for part in law.parts().values() for name, kind in part.history}
    found: dict[str, Any] = {
        "law": law,
        "friction": law.tangential is not None,
        "rolling": law.rolling is not None,
        "history": history,
        "reach": _reach(scene),
        "plastic": energy_balance
        and (any(normal.plastic for normal, *_ in normals) or _creeps(scene)),
        "losses": energy_balance and bool(losing),
        "balanced": energy_balance or not losing,
        "sleep": scene.sleep,
        "asks_for": frozenset(
            name for part in law.parts().values() for name in getattr(part, "asks_for", ())
        ),
    }
    return Effects(**found, listed=tuple(_listed(scene, found, losing, idle, energy_balance)))


def _normal_laws(scene: Scene) -> Iterator[tuple[Any, Any, Any]]:
    for a in scene.materials:
        for b in scene.materials:
            yield scene.law.between("normal", a.name, b.name), a, b


def _creeps(scene: Scene) -> bool:
    return scene.substrate is not None and scene.substrate.relaxation is not None


def _reach(scene: Scene) -> float:
    """No contact has a larger R* than the largest sphere's with a wall."""
    largest = float(scene.spheres.radius.max())
    return max(
        law.reach(law.coefficients(a, b), largest) if law.adhesive else 0.0
        for law, a, b in _normal_laws(scene)
    )


def _listed(
    scene: Scene,
    found: dict[str, Any],
    losing: list[str],
    idle: dict[str, str],
    energy_balance: bool,
) -> Iterator[Effect]:
    law: Law = found["law"]
    turning = [
        *(["friction"] if found["friction"] else []),
        *(["rolling resistance"] if found["rolling"] else []),
    ]
    yield Effect(
        "friction",
        found["friction"],
        "contacts resist sliding"
        if found["friction"]
        else idle.get("tangential", "no tangential law"),
    )
    yield Effect(
        "rolling",
        found["rolling"],
        "contacts resist rolling" if found["rolling"] else idle.get("rolling", "no rolling law"),
    )
    makes = "makes" if len(turning) == 1 else "make"
    yield Effect(
        "rotation",
        bool(turning),
        f"because {' and '.join(turning)} {makes} torque" if turning else "nothing makes torque",
    )
    held = [f"{name} ({slot} law)" for slot, p in law.parts().items() for name, _ in p.history]
    yield Effect(
        "history",
        bool(held),
        f"of each contact: {', '.join(held)}" if held else "no law remembers anything",
    )
    yield Effect(
        "adhesion",
        found["reach"] > 0,
        f"holds contacts up to {found['reach']:.3g} m past zero overlap, so that they are sought "
        "that much farther"
        if found["reach"] > 0
        else "no contact is held past zero overlap",
    )
    if not losing:
        reason = "nothing is lost"
    elif not energy_balance:
        reason = "energy_balance is false"
    else:
        reason = f"is summed up: {', '.join(losing)}"
    yield Effect("dissipation", found["losses"], reason)
    yield _substrate_coupling(scene.substrate)
    yield _finite_size(scene.substrate)
    yield _lagged_exchange(scene.substrate)
    yield _extrapolated_exchange(scene.substrate)
    yield Effect(
        "multi-contact",
        law.surface is not None,
        idle.get("surface", "no surface law")
        if law.surface is None
        else "each contact of a sphere bulges its surface under the others",
    )
    moving = [str(k) for k, wall in enumerate(scene.boundaries) if wall.moves]
    yield Effect(
        "moving boundaries",
        bool(moving),
        f"boundary {', '.join(moving)}" if moving else "no boundary moves",
    )
    yield Effect(
        "sleep",
        scene.sleep,
        "clusters at rest are left out until they are touched"
        if scene.sleep
        else "spheres at rest are computed as all others are: sleep is false",
    )
    yield from _ground(scene)
    sides = (
        None if scene.period is None else "{:.3g} m along x, {:.3g} m along y".format(*scene.period)
    )
    reason = "nothing repeats itself" if sides is None else f"everything repeats itself, {sides}"
    yield Effect("period", sides is not None, reason)


def _ground(scene: Scene) -> Iterator[Effect]:
    """What the substrate has beside a half-space's elasticity."""
    layer = scene.substrate.layer if scene.substrate else None
    if layer is None:
        yield Effect("layer", False, "nothing lies on a rigid base")
    else:
        held = "bonded to" if layer.base == "bonded" else "sliding on"
        yield Effect("layer", True, f"{layer.thickness:.3g} m, {held} a rigid base")
    relaxation = scene.substrate.relaxation if scene.substrate else None
    if relaxation is None:
        yield Effect("relaxation", False, "the ground does not creep")
    else:
        yield Effect(
            "relaxation",
            True,
            f"the ground creeps to {relaxation.relaxed_modulus:.3g} Pa in "
            f"{relaxation.retardation_time:.3g} s; all work of contacts is booked",
        )


def _substrate_coupling(ground: Substrate | None) -> Effect:
    if ground is None:
        return Effect("substrate coupling", False, "no substrate")
    every = ground.exchange_every
    reason = {
        "implicit": f"contacts feel each other ({ground.coupling} coupling), solved together "
        f"{'at every step' if every == 1 else f'every {every} steps'} to {ground.residual:g}"
        f"{'' if ground.homogeneous else ', on the host'}",
        "lagged": f"contacts feel each other ({ground.coupling} coupling) by the forces of the "
        "step before",
        "none": 'exchange is "none": an elastic plane',
    }
    return Effect("substrate coupling", ground.exchange != "none", reason[ground.exchange])


def _lagged_exchange(ground: Substrate | None) -> Effect:
    name = "lagged exchange"
    if ground is None or ground.exchange == "none":
        return Effect(name, False, "nothing is exchanged")
    if ground.exchange == "implicit":
        return Effect(name, False, "contacts on the ground are solved for together")
    return Effect(name, True, "in place of solving for contacts on the ground together")


def _extrapolated_exchange(ground: Substrate | None) -> Effect:
    name = "extrapolated exchange"
    if ground is None or ground.exchange == "none":
        return Effect(name, False, "nothing is exchanged")
    if ground.exchange_every == 1:
        return Effect(name, False, "the ground is asked at every step")
    return Effect(
        name,
        True,
        f"expansions go on as they did, between exchanges {ground.exchange_every} steps apart",
    )


def _finite_size(ground: Substrate | None) -> Effect:
    name = "finite contact size"
    if ground is None:
        return Effect(name, False, "no substrate")
    if ground.exchange == "none":
        return Effect(name, False, "contacts on the ground do not feel each other")
    if ground.coupling == "point":
        return Effect(name, False, 'coupling is "point"')
    return Effect(name, True, "contacts on the ground press over their radii, on a tilted surface")
