"""A stand-in for a simulation, in plain NumPy: what outputs and pictures ask of one, no more."""

from types import SimpleNamespace

import numpy as np
from scipy.spatial import cKDTree

MODULUS = 2e4  # Pa, effective, of the substrate
STIFFNESS = 5.0  # N/m, between spheres
CONTACT = np.dtype(
    [("i", "i4"), ("j", "i4"), ("overlap", "f8")]
    + [(name, "f8", (3,)) for name in ("force", "position", "normal", "slip")]
)


class Wall(SimpleNamespace):
    """A boundary as the scene describes it: ``kind``, ``faces()`` and, if it has one, ``point``."""

    def faces(self):
        return [(np.array(p, dtype=float), np.array(n, dtype=float)) for p, n in self.flat]


def plane(point, normal, kind="Plane"):
    return Wall(kind=kind, point=point, flat=[(point, normal)])


def box(low, high):
    axes = np.eye(3)
    flat = [
        (axes[k] * corner[k], sign * axes[k])
        for k in range(3)
        for corner, sign in ((low, 1.0), (high, -1.0))
        if np.isfinite(corner[k])
    ]
    return Wall(kind="Box", flat=flat)


def hertz_dents(points, centers, force, radius):
    """Depression (k,) of the surface at ``points`` (k, 2) below m Hertz contacts.

    Johnson, Contact Mechanics (1985), eqs. (3.41a) and (3.42a), summed over the contacts.
    """
    r = np.linalg.norm(points[:, None] - centers, axis=-1)
    a = np.broadcast_to(radius, r.shape)
    peak = 1.5 * force / (np.pi * radius**2)
    ratio = np.minimum(1.0, a / np.maximum(r, a))
    outside = (2 * a**2 - r**2) * np.arcsin(ratio) + r * a * np.sqrt(1 - ratio**2)
    inside = 0.5 * np.pi * (2 * a**2 - r**2)
    return np.sum(peak / (2 * MODULUS * a) * np.where(r <= a, inside, outside), axis=1)


class FakeSimulation:
    """Spheres on z = 0 with overlaps as they come, walls without forces, and a clock."""

    def __init__(self, position, radius, material=None, boundaries=(), substrate=True):
        n = len(radius)
        self.time, self.steps, self.dt = 0.0, 0, 1e-5
        rng = np.random.default_rng(5)
        self.particles = SimpleNamespace(
            position=np.array(position, dtype=float).reshape(n, 3),
            radius=np.array(radius, dtype=float),
            velocity=0.1 * rng.normal(size=(n, 3)),
            omega=rng.normal(size=(n, 3)),
            force=rng.normal(size=(n, 3)),
            torque=rng.normal(size=(n, 3)),
            mass=2500 * 4 / 3 * np.pi * np.array(radius, dtype=float) ** 3,
            material=np.zeros(n, dtype=np.int32) if material is None else np.asarray(material),
        )
        self.scene = SimpleNamespace(
            materials=[SimpleNamespace(name=name) for name in ("glass", "gel", "steel")],
            boundaries=list(boundaries),
            substrate=SimpleNamespace() if substrate else None,
            gravity=(0.0, 0.0, -9.81),
            period=None,
            sleep=False,
            spheres=SimpleNamespace(count=n),
            to_toml=lambda path, run=None: path.write_text("gravity = [0.0, 0.0, -9.81]\n"),
        )
        self.boundaries = [
            SimpleNamespace(
                force=np.zeros(3),
                torque=np.zeros(3),
                position=np.array(getattr(wall, "point", (0, 0, 0)), dtype=float),
                velocity=np.zeros(3),
            )
            for wall in boundaries
        ]
        self._has_substrate = substrate

    def advance(self, steps=1):
        self.steps += steps
        self.time = self.steps * self.dt

    @property
    def substrate(self):
        if not self._has_substrate:
            return None
        x, radius = self.particles.position, self.particles.radius
        overlap = radius - x[:, 2]
        particle = np.flatnonzero(overlap > 0)
        overlap, radius = overlap[particle], radius[particle]
        force = 4 / 3 * MODULUS * np.sqrt(radius) * overlap**1.5
        centers, contact_radius = x[particle, :2], np.sqrt(radius * overlap)
        return SimpleNamespace(
            particle=particle,
            position=centers,
            force=force,
            expansion=np.zeros(len(force)),
            slope=np.zeros((len(force), 2)),
            contact_radius=contact_radius,
            dent_position=np.empty((0, 2)),
            field=lambda points: hertz_dents(points, centers, force, contact_radius),
        )

    def contacts(self):
        x, radius = self.particles.position, self.particles.radius
        pairs = np.empty((0, 2), dtype=int)
        if len(x):
            pairs = cKDTree(x).query_pairs(2 * radius.max(), output_type="ndarray")
        branch = x[pairs[:, 0]] - x[pairs[:, 1]]
        distance = np.linalg.norm(branch, axis=1)
        overlap = radius[pairs].sum(axis=1) - distance
        touching = overlap > 0
        pairs, overlap = pairs[touching], overlap[touching]
        normal = branch[touching] / distance[touching, None]
        between = np.zeros(len(pairs), CONTACT)
        between["i"], between["j"], between["overlap"] = *pairs.T, overlap
        between["force"] = STIFFNESS * overlap[:, None] * normal
        middle = radius[pairs[:, 0]] - 0.5 * overlap
        between["position"] = x[pairs[:, 0]] - middle[:, None] * normal
        between["normal"] = normal
        if not self._has_substrate:
            return between
        below = self.substrate
        on_ground = np.zeros(len(below.force), CONTACT)
        on_ground["i"], on_ground["j"] = below.particle, -1
        on_ground["overlap"] = radius[below.particle] - x[below.particle, 2]
        on_ground["force"][:, 2] = below.force
        on_ground["position"][:, :2] = below.position
        on_ground["normal"] = (0, 0, 1)
        return np.concatenate([between, on_ground])

    def energy(self):
        mass, v = self.particles.mass, self.particles.velocity
        kinetic = 0.5 * float(mass @ np.einsum("ij,ij->i", v, v))
        height = float(mass @ self.particles.position[:, 2])
        return {"kinetic": kinetic, "gravity": 9.81 * height, "balance_error": 1e-9 * kinetic}

    def summary(self):
        return {"outcome": "finished"}

    def coordination(self):
        return 2 * len(self.contacts()) / max(1, len(self.particles.radius))

    def largest_overlap(self):
        return float(np.max(self.contacts()["overlap"], initial=0.0))


def layer(count=25, seed=1, radius=1e-3, sink=0.1):
    """A square layer of touching spheres of different size that sinks into z < 0: x (n, 3), R."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(count)))
    radii = radius * rng.uniform(0.8, 1.2, count)
    k = np.arange(count)
    x = np.stack([k % side, k // side], axis=1) * 1.9 * radius
    return np.column_stack([x, radii - sink * radius * rng.uniform(0.2, 1, count)]), radii
