"""The state of a simulation at one moment in plain NumPy, as frames and pictures need it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from taichi_dem.periodic import nearest_image, wrapped
from taichi_dem.writing import replacing

FILE = "state.npz"


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """n spheres, c contacts, m of them on the substrate, b faces of boundaries; SI units.

    ``contact_j`` is another sphere (>= 0), the substrate (-1) or boundary k (-2-k).
    ``depression`` (ny, nx) is positive downward, at the points ``grid_y`` x ``grid_x``; empty if
    the scene has no substrate. The period of a scene that has none is NaN; of one that has, all
    spheres are shown in the cell 0 <= x < Lx, 0 <= y < Ly, which the grid covers.
    """

    time: float
    step: int
    position: np.ndarray  # (n, 3) m
    velocity: np.ndarray  # (n, 3) m/s
    omega: np.ndarray  # (n, 3) rad/s
    force: np.ndarray  # (n, 3) N
    radius: np.ndarray  # (n,) m
    material: np.ndarray  # (n,) index into material_names
    material_names: np.ndarray  # (number of materials,) text
    contact_i: np.ndarray  # (c,)
    contact_j: np.ndarray  # (c,)
    contact_overlap: np.ndarray  # (c,) m
    contact_force: np.ndarray  # (c, 3) N, on i
    contact_position: np.ndarray  # (c, 3) m
    contact_normal: np.ndarray  # (c, 3) from j to i
    substrate_position: np.ndarray  # (m, 2) m
    substrate_force: np.ndarray  # (m,) N
    substrate_radius: np.ndarray  # (m,) m, of the contact
    grid_x: np.ndarray  # (nx,) m
    grid_y: np.ndarray  # (ny,) m
    depression: np.ndarray  # (ny, nx) m
    face_kind: np.ndarray  # (b,) name of the boundary's class
    face_point: np.ndarray  # (b, 3) m
    face_normal: np.ndarray  # (b, 3) into the domain
    period: np.ndarray  # (2,) m

    @classmethod
    def of(cls, sim: Any, substrate_points: int = 129, cover: np.ndarray | None = None) -> Snapshot:
        """The present state of ``sim``.

        The substrate's surface is sampled on a grid of square cells with ``substrate_points``
        points along its longer side, wide enough for every dent (and for ``cover``, (2, 2) m: the
        lower and the upper corner of a rectangle).
        """
        particles, scene = sim.particles, sim.scene
        columns = {
            name: np.array(getattr(particles, name))
            for name in ("position", "velocity", "omega", "force", "radius", "material")
        }
        contacts = sim.contacts()
        for name in ("i", "j", "overlap", "force", "position", "normal"):
            columns[f"contact_{name}"] = np.array(contacts[name])
        period, position = scene.period, columns["position"]
        columns["position"] = wrapped(position, period)
        columns["contact_position"] += (columns["position"] - position)[columns["contact_i"]]
        return cls(
            time=float(sim.time),
            step=int(sim.steps),
            material_names=np.array([m.name for m in scene.materials], dtype=str),
            period=np.full(2, math.nan) if period is None else np.array(period, dtype=float),
            **columns,
            **_substrate(sim, substrate_points, cover),
            **_faces(sim),
        )

    @classmethod
    def load(cls, path: Path | str) -> Snapshot:
        """Read what :meth:`save` wrote; ``path`` is the file or the run's folder."""
        path = Path(path)
        path = path / FILE if path.is_dir() else path
        with np.load(path, allow_pickle=False) as data:
            fields = {f.name: data[f.name] for f in dataclasses.fields(cls)}
        fields.update(time=float(fields["time"]), step=int(fields["step"]))
        return cls(**fields)

    def save(self, path: Path | str) -> None:
        """Write all fields to an ``.npz`` file, in one piece."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **fields)

    @property
    def has_substrate(self) -> bool:
        """Whether there is a substrate whose surface was sampled."""
        return self.depression.size > 0

    @property
    def deepest(self) -> float:
        """Largest depression of the surface, m; 0 without a substrate."""
        return float(np.max(self.depression, initial=0.0, where=np.isfinite(self.depression)))

    @property
    def normal_force(self) -> np.ndarray:
        """Part of each contact's force along its normal, (c,) N; positive when it pushes."""
        return np.einsum("ij,ij->i", self.contact_force, self.contact_normal)

    @property
    def coordination(self) -> np.ndarray:
        """Number of contacts of each sphere, those with boundaries and substrate included, (n,)."""
        ends = np.concatenate([self.contact_i, self.contact_j[self.contact_j >= 0]])
        return np.bincount(ends, minlength=len(self.radius))

    def contact_ends(self) -> np.ndarray:
        """Both ends of each contact's line, (c, 2, 3) m: centre to centre, or to the wall.

        In a periodic scene the second end is the image of j next to i.
        """
        start = self.position[self.contact_i]
        end = self.contact_position.copy()
        pair = self.contact_j >= 0
        branch = self.position[self.contact_j[pair]] - start[pair]
        period = tuple(self.period) if np.isfinite(self.period).all() else None
        end[pair] = start[pair] + nearest_image(branch, period)
        return np.stack([start, end], axis=1)


def _substrate(sim: Any, points: int, cover: np.ndarray | None) -> dict[str, np.ndarray]:
    """The contacts on the substrate and the depression of its surface on a grid."""
    substrate = sim.substrate
    if substrate is None:
        return {
            "substrate_position": np.empty((0, 2)),
            "substrate_force": np.empty(0),
            "substrate_radius": np.empty(0),
            "grid_x": np.empty(0),
            "grid_y": np.empty(0),
            "depression": np.empty((0, 0)),
        }
    period = sim.scene.period
    position = wrapped(np.array(substrate.position, dtype=float).reshape(-1, 2), period)
    contact_radius = np.array(substrate.contact_radius, dtype=float)
    left = wrapped(np.array(substrate.dent_position, dtype=float), period)
    dents = np.concatenate([position, left])
    if period is None:
        reach = sim.particles.radius[np.asarray(substrate.particle, dtype=int)]
        reach = np.append(reach, np.full(len(left), np.max(sim.particles.radius, initial=0.0)))
        x, y = _around(sim.particles, dents, reach, points, cover)
    else:
        x, y = _grid(np.zeros(2), np.array(period), points)
    depression = np.zeros((len(y), len(x)))
    if len(dents) and depression.size:
        nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        depression = np.asarray(substrate.field(nodes), dtype=float).reshape(depression.shape)
    return {
        "substrate_position": position,
        "substrate_force": np.array(substrate.force, dtype=float),
        "substrate_radius": contact_radius,
        "grid_x": x,
        "grid_y": y,
        "depression": depression,
    }


def _around(
    particles: Any, dents: np.ndarray, reach: np.ndarray, points: int, cover: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of a grid of square cells around the dents, or below the spheres if none."""
    inside = dents
    if not len(dents):
        inside, reach = particles.position[:, :2], np.asarray(particles.radius)
    finite = np.isfinite(inside).all(axis=1)
    inside, reach = inside[finite], reach[finite]
    if not len(inside):
        return np.empty(0), np.empty(0)
    low, high = inside.min(axis=0), inside.max(axis=0)
    margin = reach.max() + 0.1 * (high - low).max()
    low, high = low - margin, high + margin
    spare = np.maximum(0.0, 0.25 * (high - low).max() - (high - low))  # of a single long row
    low, high = low - 0.5 * spare, high + 0.5 * spare
    if cover is not None:
        low, high = np.minimum(low, cover[0]), np.maximum(high, cover[1])
    return _grid(low, high, points)


def _grid(low: np.ndarray, high: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of square cells over a rectangle, ``points`` along its longer side."""
    spacing = (high - low).max() / (points - 1)
    x, y = (
        0.5 * (low[k] + high[k]) + spacing * (np.arange(count) - 0.5 * (count - 1))
        for k in (0, 1)
        for count in [math.ceil((high[k] - low[k]) / spacing * (1 - 1e-12)) + 1]
    )
    return x, y


def _faces(sim: Any) -> dict[str, np.ndarray]:
    """The faces of all boundaries where they are now; a box stays where the scene has it."""
    faces = [
        (described.kind, boundary.position if hasattr(described, "point") else point, normal)
        for described, boundary in zip(sim.scene.boundaries, sim.boundaries, strict=True)
        for point, normal in described.faces()
    ]
    return {
        "face_kind": np.array([kind for kind, _, _ in faces], dtype=str),
        "face_point": np.array([point for _, point, _ in faces], dtype=float).reshape(-1, 3),
        "face_normal": np.array([normal for _, _, normal in faces], dtype=float).reshape(-1, 3),
    }
