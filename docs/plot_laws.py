"""Draws docs/images/law_*.png, one picture per contact law, from the laws as they are compiled.

python docs/plot_laws.py
"""

from itertools import pairwise
from pathlib import Path

import numpy as np

import taichi_dem as dem
from halfspace import backend
from taichi_dem import style
from taichi_dem.contacts.contact import NormalForce, at_rest
from taichi_dem.types import real, ti, vec3

IMAGES = Path(__file__).parent / "images"
RADIUS, MASS = 5e-3, 1e-3  # effective, m and kg
GEL = dem.Material("gel", density=1050, youngs_modulus=1e6, poissons_ratio=0.45)
PHASES = ("load", "unload", "reload", "detach")


@ti.data_oriented
class Probe:
    """One contact of gel on gel under ``law``."""

    def __init__(self, law):
        backend.start()
        self.law = law
        self.k = ti.Struct.field(dict.fromkeys(law.coefficient_names, real), shape=())
        self.k[None] = law.coefficients(GEL, GEL)
        self.History = ti.types.struct(**(dict(law.history) or {"nothing": ti.i32}))

    @ti.kernel
    def push(
        self,
        overlap: ti.types.ndarray(dtype=real, ndim=1),
        force: ti.types.ndarray(dtype=real, ndim=1),
    ):
        """The elastic force along a path of the overlap, not a number where there is no contact."""
        history = self.History()
        ti.loop_config(serialize=True)
        for step in range(overlap.shape[0]):
            contact = at_rest(overlap[step], RADIUS, MASS)
            held = ti.cast(overlap[step] > 0.0, ti.i32)
            if ti.static(self.law.adhesive):
                held |= self.law.holds(contact, self.k[None], history)
            force[step] = ti.math.nan
            if held == 1:
                force[step] = self.law.force(contact, self.k[None], history).elastic

    @ti.kernel
    def impact(
        self,
        speed: real,
        time_step: real,
        path: ti.types.ndarray(dtype=real, ndim=2),
    ):
        """Overlap and force of an impact, one row per step, until the bodies part."""
        history, overlap, velocity, force = self.History(), 0.0, -speed, 0.0
        ti.loop_config(serialize=True)
        for step in range(path.shape[0]):
            velocity += 0.5 * time_step * force / MASS
            overlap -= time_step * velocity
            contact = at_rest(overlap, RADIUS, MASS)
            contact.normal_velocity = velocity
            path[step, 0] = path[step, 1] = ti.math.nan
            force = 0.0
            if overlap > 0.0:
                force = self.law.force(contact, self.k[None], history).total
                path[step, 0], path[step, 1] = overlap, force
            velocity += 0.5 * time_step * force / MASS

    @ti.kernel
    def slide(
        self,
        push: real,
        stiffness: real,
        speed: ti.types.ndarray(dtype=real, ndim=1),
        force: ti.types.ndarray(dtype=real, ndim=1),
    ):
        """The tangential force under a constant load; ``speed`` along x over steps of 1 s."""
        history = self.History()
        ti.loop_config(serialize=True)
        for step in range(speed.shape[0]):
            contact = at_rest(0.0, RADIUS, MASS)
            contact.tangential_velocity = vec3(speed[step], 0.0, 0.0)
            contact.time_step = 1.0
            normal = NormalForce(
                total=push, elastic=push, stiffness=stiffness, area_stiffness=stiffness
            )
            force[step] = self.law.force(contact, normal, self.k[None], history)[0]

    @ti.kernel
    def roll(
        self,
        push: real,
        stiffness: real,
        inertia: real,
        spin: ti.types.ndarray(dtype=real, ndim=1),
        torque: ti.types.ndarray(dtype=real, ndim=1),
    ):
        """The torque under a constant load; ``spin`` about y over steps of 1 s."""
        history = self.History()
        ti.loop_config(serialize=True)
        for step in range(spin.shape[0]):
            contact = at_rest(0.0, RADIUS, MASS)
            contact.relative_spin = vec3(0.0, spin[step], 0.0)
            contact.rolling_inertia = inertia
            contact.time_step = 1.0
            normal = NormalForce(total=push, elastic=push, area_stiffness=stiffness)
            torque[step] = self.law.torque(contact, normal, self.k[None], history)[1]


def axes(x, y):
    drawing = style.figure(4.8, 3.2)
    panel = drawing.add_subplot()
    panel.axhline(0, color=style.INK, linewidth=0.5)
    panel.set(xlabel=x, ylabel=y)
    style.dress(panel)
    return drawing, panel


def curve(panel, x, y, color, label, arrow=True, **options):
    """A line, with an arrow half way along it."""
    panel.plot(x, y, color=color, linewidth=1.5, label=label, **options)
    seen = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if arrow and len(seen) > 4:
        middle = seen[len(seen) // 2]
        ends = (x[middle - 1], y[middle - 1]), (x[middle + 1], y[middle + 1])
        look = {"arrowstyle": "-|>", "color": color, "mutation_scale": 13, "linewidth": 0}
        panel.annotate("", xy=ends[1], xytext=ends[0], arrowprops=look)


def save(drawing, panel, name):
    style.legend(panel)
    print(style.save(drawing, IMAGES / f"law_{name}.png"))


def phases(law, name, turns, marks=()):
    """The elastic force over load, unload, reload and detach between the overlaps ``turns``."""
    parts = [np.linspace(a, b, 400) for a, b in pairwise(turns)]
    overlap, force = np.concatenate(parts), np.empty(400 * len(parts))
    Probe(law).push(overlap, force)
    drawing, panel = axes("overlap (µm)", "normal force (mN)")
    widths = (3.2, 1.8, 3.2, 1.8)
    for k, phase in enumerate(PHASES):
        span = slice(400 * k, 400 * (k + 1))
        curve(panel, overlap[span] * 1e6, force[span] * 1e3, style.PALETTE[k], phase)
        panel.lines[-1].set(linewidth=widths[k], alpha=0.45 if widths[k] > 3 else 1)
    for x, y, text, place in marks:
        panel.annotate(
            text,
            (x * 1e6, y * 1e3),
            xytext=place,
            textcoords="offset points",
            fontsize=8,
            color=style.INK,
            arrowprops={"arrowstyle": "-", "linewidth": 0.6, "color": style.INK},
        )
    save(drawing, panel, name)


def impacts(make, name):
    """Whole impacts, without and with a dashpot."""
    drawing, panel = axes("overlap (µm)", "normal force (mN)")
    for restitution, color in zip((1.0, 0.8, 0.5), style.PALETTE, strict=False):
        path = np.empty((1200, 2))
        Probe(make(restitution)).impact(0.1, 1e-5, path)
        curve(panel, path[:, 0] * 1e6, path[:, 1] * 1e3, color, f"e = {restitution:g}", arrow=False)
    save(drawing, panel, name)


def friction(name):
    """Slid to and fro: the spring, and Coulomb's limit."""
    turns = np.array([0, 30e-6, -30e-6, 12e-6])
    steps = np.concatenate([np.full(200, step / 200) for step in np.diff(turns)])
    drawing, panel = axes("displacement (µm)", "resisting force (mN)")
    for mu, color in zip((0.2, 0.4), style.PALETTE, strict=False):
        force = np.empty_like(steps)
        Probe(dem.Mindlin(mu, damping=0.0)).slide(0.02, 900.0, steps, force)
        curve(panel, np.cumsum(steps) * 1e6, -force * 1e3, color, f"µ = {mu:g}", arrow=False)
    save(drawing, panel, name)


def rolling(law, spring, name):
    """Rolled to and fro: what stops it within a step, and the spring."""
    turns = np.array([0, 0.15, -0.15, 0.06])
    steps = np.concatenate([np.full(200, step / 200) for step in np.diff(turns)])
    drawing, panel = axes("rotation (rad)", "resisting torque (µN m)")
    for one, color, label in zip((law, spring), style.PALETTE, ("stop", "spring"), strict=False):
        torque = np.empty_like(steps)
        Probe(one).roll(0.02, 300.0, 1.0, steps, torque)
        curve(panel, np.cumsum(steps), -torque * 1e6, color, label, arrow=False)
    save(drawing, panel, name)


def main():
    impacts(lambda e: dem.Hooke(100.0, e), "hooke")
    impacts(dem.Hertz, "hertz")
    work, modulus = 0.2, 1e6 / (2 * (1 - 0.45**2))
    least = (np.pi * work * RADIUS**2 / (8 * modulus)) ** (1 / 3)
    last, most = 3 * least**2 / RADIUS, 1.5 * np.pi * work * RADIUS
    at = (9 ** (2 / 3) - 4 * 9 ** (1 / 6)) * least**2 / RADIUS  # a^3 = 9 a_m^3
    marks = [
        (at, -most, "pull-off, 3/2 π W R*", (52, -1)),
        (-last, -5 / 9 * most, "opens, 5/9 of it", (-2, 30)),
        (0, -8 / 9 * most, "made", (-12, 34)),
    ]
    turns = (1e-9, 3 * last, -0.7 * last, 2 * last, -1.2 * last)
    phases(dem.JKR(work, 1.0), "jkr", turns, marks)
    turns = (1e-9, 100e-6, 15e-6, 70e-6, -10e-6)
    phases(dem.EEPA(1.0, 4.0, surface_energy=4.0), "eepa", turns)
    friction("mindlin")
    rolling(dem.CDT(0.1), dem.CDT(0.1, regularization="spring"), "cdt")
    adhesive = dem.CDTJKR(work, 1.0), dem.CDTJKR(work, 1.0, regularization="spring")
    rolling(*adhesive, "cdt_jkr")


if __name__ == "__main__":
    main()
