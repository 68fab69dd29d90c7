"""Random valid scenes: every combination of laws and every kind of ground that a ``Scene`` accepts.

What is refused is never drawn: choices are made in an order in which each leaves only what goes
with those before. Numbers are dimensionless, times the scene's own size, stiffness and speed.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

import taichi_dem as dem
from taichi_dem.periodic import nearest_image
from tests.taichi_dem.setups import scene

KINDS = ("floor", "none", *2 * ("implicit", "lagged", "every", "creeping"))  # of ground
EDGE = 0.1  # how often a number is one of its bounds, each


@dataclass(frozen=True)
class Draw:
    """Numbers of the kinds that scenes are made of, from ``rng``."""

    rng: np.random.Generator

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def one_of(self, *choices):
        return choices[self.rng.integers(len(choices))]

    def share(self, low=0.0, high=1.0) -> float:
        """Uniform, and often just at a bound."""
        if self.chance(2 * EDGE):
            return self.one_of(low, high)
        return float(self.rng.uniform(low, high))

    def decades(self, low, high) -> float:
        return 10.0 ** self.share(math.log10(low), math.log10(high))


def drawn(number: int) -> dem.Scene:
    """The random scene of that number: two to twelve spheres of sizes 1:20 over a floor or ground,
    apart or pressed together, thrown about."""
    draw = Draw(np.random.default_rng(number))
    soft = dem.Material("a", draw.decades(100, 2e4), draw.decades(1e2, 1e12), poisson(draw))
    hard = dem.Material("b", draw.decades(100, 2e4), other_modulus(draw, soft), poisson(draw))
    modulus = min(soft.youngs_modulus, hard.youngs_modulus)
    wave = math.sqrt(modulus / max(soft.density, hard.density))
    size = draw.decades(1e-6, 1.0)
    radius = size * np.array([draw.decades(0.05, 1.0) for _ in range(draw.rng.integers(2, 13))])
    stiffness = modulus * float(radius.min())

    kind, way = KINDS[number % len(KINDS)], number // len(KINDS) % 4
    surface = None
    if kind != "every" and way % 2:
        mutual = "implicit" if kind not in ("lagged", "creeping") else "lagged"
        surface = dem.MultiContact(draw.share(0, 1.5), (mutual, "lagged")[way // 2])
    sleep = kind in ("floor", "none") and surface is None and draw.chance(0.5)
    ground = None if kind == "floor" else substrate(draw, kind, hard, size, size / wave)
    normal = dem.Hertz(draw.share(0.05, 1)) if kind == "creeping" else None
    law = laws(draw, stiffness, stiffness, normal, surface)

    period = None
    if draw.chance(0.4):  # four radii are the least, six if surfaces rise, and what adhesion holds
        period = tuple(float(radius.max() * draw.share(6.5, 12)) for _ in range(2))
    position = cluster(draw, radius, period, 0.05 if surface else 0.1)
    if period is None:
        walls = around(position, radius, size * draw.share(1e-3, 1), soft)
    else:
        position[:, :2] += draw.rng.integers(-2, 3, (len(radius), 2)) * period
        top = float((position[:, 2] + radius).max() + size)
        walls = [dem.Box((-math.inf,) * 3, (math.inf, math.inf, top), soft)]
    if ground is None:
        slides = draw.one_of(0.0, draw.decades(1e-4, 1e-2) * wave)
        walls.append(dem.Plane((0, 0, 0), (0, 0, 1), hard, velocity=(slides, 0.0, 0.0)))
    if draw.chance(0.4):
        walls.append(piston(draw, position, radius, soft, wave))

    speed = draw.decades(1e-4, 1e-1) * wave
    toward = draw.share(0, 2) * (position.mean(axis=0) - position) / size
    weight = draw.one_of(0.1 * speed**2, draw.decades(1e-5, 1e-3) * wave**2) / size
    motion = draw.rng.normal(size=(2, len(radius), 3))
    mixed = [draw.one_of(soft, hard) for _ in radius]
    return scene(
        position,
        radius,
        draw.one_of(soft, mixed),
        velocity=speed * (motion[0] + (0.0 if period else 1.0) * toward),
        omega=draw.one_of(0.0, 1.0) * motion[1] * speed / radius[:, None],
        law=law,
        boundaries=walls,
        substrate=ground,
        gravity=(0.0, 0.0, -weight),
        period=period,
        sleep=sleep,
    )


def poisson(draw: Draw) -> float:
    return draw.share(-0.5 if draw.chance(0.2) else 0.0, 0.5)


def other_modulus(draw: Draw, soft: dem.Material) -> float:
    """Mostly near the first, so that both bodies of a contact give."""
    if draw.chance(0.3):
        return draw.decades(1e2, 1e12)
    return soft.youngs_modulus * draw.decades(1e-2, 1e2)


def substrate(draw: Draw, kind: str, material: dem.Material, size: float, time: float):
    """Of any ``kind``; spheres are as large as ``size``, m, and swing in that ``time``, s."""
    ground = dem.Substrate(
        material,
        coupling=draw.one_of("finite", "point"),
        residual=draw.decades(1e-9, 1e-6),
        tolerance=draw.decades(1e-6, 1e-3),
    )
    if kind == "none":
        return replace(ground, exchange="none")
    if draw.chance(0.3):
        layer = dem.Layer(size * draw.decades(0.7, 100), draw.one_of("bonded", "frictionless"))
        ground = replace(ground, layer=layer)
    if kind == "lagged":
        return replace(ground, exchange="lagged", force_lagged=draw.chance(0.5))
    if kind == "every":  # 6 pi/20 < 1, the phase at which a run is stopped
        return replace(ground, exchange_every=int(draw.rng.integers(2, 7)))
    if kind == "creeping":
        relaxed = material.youngs_modulus * draw.decades(1e-3, 1)
        creep = dem.Relaxation(
            min(relaxed, material.youngs_modulus), time * draw.decades(1e-3, 1e3)
        )
        return replace(ground, relaxation=creep, coupling="point")
    return ground


def laws(draw: Draw, stiffness: float, tension: float, normal, surface) -> dem.Law:
    """Any combination with that ``surface`` law, and that ``normal`` one if it is given; Hooke's
    spring and adhesion go with the scene's own ``stiffness`` (N/m) and ``tension`` (J/m2), so that
    spheres touch rather than merge."""
    normal = normal or normal_law(draw, stiffness, tension)
    friction = None
    if draw.chance(0.7):
        friction = dem.Mindlin(draw.share(0, 2), draw.share(0, 1))
    rolling = None
    if draw.chance(0.6):
        way = {"torsion_torque": draw.chance(0.5)}
        if draw.chance(0.5):
            way |= {"regularization": "spring", "rolling_damping": draw.share()}
        own = None if isinstance(normal, dem.JKR) else tension * draw.decades(1e-6, 1e-3)
        rolling = draw.one_of(
            dem.CDT(draw.share(0, 0.5), **way),
            dem.CDTJKR(own, adhesion_hysteresis=draw.share(0, 3), **way),
        )
    law = dem.Law(normal, friction, rolling, surface)
    if friction is None or draw.chance(0.5):
        return law
    pair = {"tangential": dem.Mindlin(draw.share(0, 2), draw.share(0, 1))}
    pair["normal"] = replace(normal, restitution=draw.share(0.05, 1))
    if rolling is not None:
        pair["rolling"] = replace(rolling, **{draw.one_of(*rolls(rolling)): draw.share(0, 0.5)})
    return replace(law, pairs={("a", draw.one_of("a", "b")): pair})


def rolls(law) -> list[str]:
    """The numbers of a rolling law that any pair of materials may have its own of."""
    strength = "rolling_friction" if isinstance(law, dem.CDT) else "adhesion_hysteresis"
    return [strength, "rolling_damping"] if law.regularization == "spring" else [strength]


def normal_law(draw: Draw, stiffness: float, tension: float):
    restitution, work = draw.share(0.05, 1), tension * draw.decades(1e-6, 1e-2)
    kind = draw.one_of("Hertz", "Hooke", "JKR", "JKR", "EEPA", "EEPA")
    if kind == "Hertz":
        return dem.Hertz(restitution)
    if kind == "Hooke":
        return dem.Hooke(stiffness, restitution)
    if kind == "JKR":
        return dem.JKR(work, restitution)
    sticks = draw.chance(0.7)
    return dem.EEPA(
        restitution,
        draw.decades(1, 100),
        overlap_exponent=draw.one_of(1.0, 1.5, 1.5, draw.share(1, 1.8)),
        adhesion_exponent=draw.one_of(1.0, draw.share(0.3, 4)),
        surface_energy=work if sticks else 0.0,
        damping=draw.one_of("tangent", "tangent", "constant"),
        limit_force=not sticks and draw.chance(0.5),
    )


def cluster(draw: Draw, radius: np.ndarray, period, deepest: float) -> np.ndarray:
    """Centres (n, 3), m, each a little apart from, or into, another one or the ground z < 0; the
    ``deepest`` overlap is a share of the smaller radius."""
    depth = draw.one_of(draw.share(-0.01, 0.0), draw.share(0.0, deepest))
    place = np.array([[0.0, 0.0, radius[0] * (1 - depth)]])
    while len(place) < len(radius):
        k = len(place)
        allowed = radius[k] + radius[:k] - depth * np.minimum(radius[k], radius[:k])
        for _ in range(50):
            anchor = draw.rng.integers(k)
            along = draw.rng.normal(size=3)
            point = place[anchor] + allowed[anchor] * along / np.linalg.norm(along)
            if draw.chance(0.5):  # on the ground, too
                point[2] = radius[k] * (1 - depth)
                far = allowed[anchor] ** 2 - (point[2] - place[anchor, 2]) ** 2
                along = along[:2] / np.hypot(*along[:2])
                point[:2] = place[anchor, :2] + math.sqrt(max(far, 0.0)) * along
            apart = np.linalg.norm(nearest_image(place - point, period), axis=1)
            near = apart < allowed * (1 - 1e-9)
            if point[2] >= radius[k] * (1 - max(depth, 0.0)) and not near.any():
                break
        else:
            point = np.array([0.0, 0.0, (place[:, 2] + radius[:k]).max() + 1.1 * radius[k]])
        place = np.vstack([place, point])
    return place


def around(position: np.ndarray, radius: np.ndarray, margin: float, material) -> list:
    """A box without a floor, ``margin`` (m) away from the spheres."""
    low = (position - radius[:, None]).min(axis=0) - margin
    high = (position + radius[:, None]).max(axis=0) + margin
    return [dem.Box((*low[:2].tolist(), -math.inf), tuple(high.tolist()), material)]


def piston(draw: Draw, position: np.ndarray, radius: np.ndarray, material, wave: float):
    """A plate just above the spheres that comes down: steadily, to and fro, or under a load."""
    least = float(radius.min())
    top = float((position[:, 2] + radius).max() + draw.share(0, 0.05) * least)
    way = draw.one_of("velocity", "program", "load")
    motion = {"velocity": draw.decades(1e-4, 3e-3) * wave}
    if way == "program":
        time, depth = draw.decades(10, 100) * least / wave, draw.share(0.01, 0.1) * least
        motion = {"program": ((time, depth), (2 * time, 0.0))}
    if way == "load":
        volume = float(4 / 3 * math.pi * (radius**3).sum())
        motion = {"load": draw.decades(1e-5, 3e-3) * material.density * (wave * least) ** 2}
        motion["mass"] = draw.decades(0.1, 10) * material.density * volume
    return dem.Piston((0, 0, top), (0, 0, -1), material, **motion)
