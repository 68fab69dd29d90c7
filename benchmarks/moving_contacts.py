"""Spheres that bounce and slide on soft ground: applications per step, and the books of energy.

Drift is the change of the mean energy from the first to the last period.  With velocity Verlet
these means waver by a hundredth of the scheme's own error, which falls with the square of the step,
and the drift with it; what the solve would make of it is bounded at the shortest step.
"""

import argparse

import numpy as np

import halfspace
from benchmarks.report import Figure
from halfspace import reference

DEPTH = 1e-4  # approach at rest, over the radius: shallow, so that contacts stay near their places
APPLICATIONS = 6  # per step, at most
DRIFTS = {"lasting": (0.2, 1e-5), "impacts": (1.5, 1e-4)}  # amplitude over DEPTH; drift at most
PAST = 4  # steps that the next is extrapolated from


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--side", type=int, default=20, help="of the square of contacts")
    parser.add_argument("--softness", type=float, default=7.0, help="rho of the lagged exchange")
    parser.add_argument("--steps", type=int, nargs="+", default=[50, 100], help="per Hertz period")
    parser.add_argument("--periods", type=int, default=20)
    parser.add_argument("--residual", type=float, default=1e-6)
    parser.add_argument("--coupling", choices=("finite", "point"), default="finite")


def run(options: argparse.Namespace) -> list[Figure]:
    """Contacts that last, and contacts that open and close; by velocity Verlet, without loss."""
    cases = [(name, steps) for name in DRIFTS for steps in sorted(options.steps)]
    return [figure for name, steps in cases for figure in _bounce(name, steps, options)]


def _bounce(name: str, steps: int, options: argparse.Namespace) -> list[Figure]:
    (amplitude, most), side = DRIFTS[name], options.side
    rng = np.random.default_rng(5)
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    spacing = _spacing(side, options.softness)
    x = spacing * (cells + rng.uniform(-0.05, 0.05, cells.shape))
    motion = Motion(x, options.residual, options.coupling)
    period = 2 * np.pi / np.sqrt(2 * np.sqrt(DEPTH))  # of a contact alone
    speed = np.zeros((len(x), 3))
    speed[:, 2] = amplitude * DEPTH * 2 * np.pi / period * rng.standard_normal(len(x))
    energy = motion.run(speed, period / steps, steps * options.periods)
    available = 0.5 * (speed**2).sum()
    first, last = (energy[part].mean() for part in (slice(steps), slice(-steps, None)))
    deviation = np.abs(energy - energy[0]).max() / available
    cost = np.array(motion.applications[PAST + 1 :])
    what = f"{side} x {side} contacts, {name}, {steps} steps a period: "
    bound = {"at_most": most} if steps == max(options.steps) else {}
    return [
        Figure(f"{what}applications per step", cost.mean(), "", at_most=APPLICATIONS),
        Figure(f"{what}the most", float(cost.max()), ""),
        Figure(f"{what}drift of energy", abs(last - first) / available, "", **bound),
        Figure(f"{what}largest deviation", deviation, ""),
    ]


def _spacing(side: int, softness: float) -> float:
    """At which `rho = (2/pi) (a/s) lambda_max`, with the largest eigenvalue of the sums of s/r."""
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    unit = halfspace.HalfSpace(1 / np.pi, 0.0).matrix(cells)
    return 2 / np.pi * np.sqrt(DEPTH) * float(np.linalg.eigvalsh(unit)[-1]) / softness


class Motion:
    """Rigid spheres of unit mass and radius on unit ground, each weighing what it carries."""

    def __init__(self, x: np.ndarray, residual: float, coupling: str) -> None:
        self._ground = halfspace.HalfSpace(1.0, 0.0, coupling=coupling)
        self._law = reference.hertz_law(1.0, 1.0)
        self._plan, self._residual = self._ground.plan(x), residual
        self._past: list[tuple[np.ndarray, np.ndarray]] = []
        self.applications: list[int] = []
        self._weight = np.zeros(len(x))
        self._position = np.c_[x, np.full(len(x), -DEPTH)]
        self._weight = self._act()[0][:, 2]

    def run(self, speed: np.ndarray, dt: float, steps: int) -> np.ndarray:
        """The energy after every step, (steps + 1,)."""
        force, potential = self._act()
        energy = [potential + 0.5 * (speed**2).sum()]
        for _ in range(steps):
            speed = speed + 0.5 * dt * force
            self._position = self._position + dt * speed
            force, potential = self._act()
            speed = speed + 0.5 * dt * force
            energy.append(potential + 0.5 * (speed**2).sum())
        return np.array(energy)

    def _act(self) -> tuple[np.ndarray, float]:
        """Forces (n, 3) and the potential that they derive from."""
        x, overlap = self._position[:, :2], -self._position[:, 2]
        start, shift = (self._guess(part) for part in (0, 1))
        state = halfspace.solve(
            self._ground, x, overlap, self._law, self._residual, start, shift=shift, plan=self._plan
        )
        self._past = [*self._past, (state.overlap, state.shift)][-PAST:]
        self.applications.append(state.applications)
        f = state.force
        a = state.contact_radius * (self._ground.coupling == "finite")
        lost = (state.shift**2).sum(axis=1) / 2
        stored = f @ (overlap - lost) - 0.6 * (f ** (5 / 3)).sum() * (4 / 3) ** (-2 / 3)
        stored -= _coupling_energy(x + state.shift, f, a)
        force = np.c_[-f[:, None] * state.slope, f - self._weight]
        return force, float(stored + self._weight @ self._position[:, 2])

    def _guess(self, part: int) -> np.ndarray | None:
        """By a cubic through the last steps."""
        if len(self._past) < PAST:
            return None
        a, b, c, d = (both[part] for both in self._past)
        return 4 * d - 6 * c + 4 * b - a


def _coupling_energy(x: np.ndarray, f: np.ndarray, a: np.ndarray) -> float:
    """`1/2 sum f_j f_k/(pi E' r) [1 + (a_j^2 + a_k^2)/(10 r^2)]`."""
    r = np.linalg.norm(x[:, None] - x, axis=2)
    np.fill_diagonal(r, np.inf)
    return float(0.5 * f @ ((1 + (a[:, None] ** 2 + a**2) / (10 * r**2)) / (np.pi * r)) @ f)
