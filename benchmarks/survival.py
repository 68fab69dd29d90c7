"""Who survives what: hard scenes in this code, in LIGGGHTS and in LAMMPS, at the same time step.

Each runs as the same spheres, walls and laws (Hertz, Mindlin's spring) in all three.  What counts
at the end: every number is finite, every sphere is there and on its side of every wall, and no
energy has come from nothing without a word.  Refusing a scene or stopping with a reason is no
failure; going on with nonsense is, and so is every other exception, crash or run without an end.
"""

import argparse
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import taichi_dem as dem
from benchmarks import liggghts, peers, words
from benchmarks.report import Figure
from taichi_dem import packing

R = 1e-3  # m
GLASS = dem.Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)
DOWN = (0.0, 0.0, -9.81)
MADE = 0.02  # of the energy at the start, that may appear: the scheme's own wobble and more
PATIENCE = 300  # s, for a peer
END = "end.dump"
DUMP = "dump end all custom {steps} {file} id x y z vx vy vz omegax omegay omegaz\n"


class UnsayableError(Exception):
    """The scene has no counterpart in a peer's input."""


class PeerStoppedError(Exception):
    """A peer ended with an error that it names."""


class PeerCrashedError(Exception):
    """A peer ended, by a signal or otherwise, without a reason."""


THEIRS = (UnsayableError, PeerStoppedError)
SOUND = {"ours": (dem.InputError, dem.SimulationStopped), "liggghts": THEIRS, "lammps": THEIRS}


@dataclass(frozen=True)
class Case:
    """``make`` gives the scene; it runs for ``steps`` steps of ``step`` times the stable one."""

    name: str
    make: Callable[[], dem.Scene]
    step: float = 1.0
    steps: int = 2000


def add_options(parser: argparse.ArgumentParser) -> None:
    words.add_option(parser)


def run(options: argparse.Namespace) -> list[Figure]:
    """The table, printed line by line; the figures count who failed how often."""
    codes = ["ours", *(code for code in peers.BINARIES if peers.available(code))]
    failures = dict.fromkeys(codes, 0)
    for case in words.chosen(CASES, options.words):
        print(case.name)
        for code, outcome, good in judge(case, codes):
            failures[code] += not good
            print(f"    {code:10s}{'' if good else 'FAILS: '}{outcome}", flush=True)
    return [
        Figure(f"failures of {code}", float(count), "", at_most=0 if code == "ours" else None)
        for code, count in failures.items()
    ]


def judge(case: Case, codes: Sequence[str]) -> Iterator[tuple[str, str, bool]]:
    """For each code what came out, in words, and whether it is sound; a scene that cannot be made
    is nobody's."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            scene = case.make()
            sim = dem.Simulation(scene, driver="serial")
        except dem.InputError as reason:
            yield "ours", f"refused: {_first_line(reason)}", True
            return
        dt, held = case.step * sim.stable.value, sim.energy()["normal"]
        for code in codes:
            try:
                if code == "ours":
                    rows, warned = _ours(sim, dt, case)
                else:
                    rows, warned = _theirs(code, scene, dt, case), ""
            except SOUND[code] as reason:
                yield code, f"{_verb(reason)}: {_last_words(str(reason))}", True
            except Exception as reason:
                words = _last_words(str(reason))
                yield code, f"breaks, {type(reason).__name__}: {words}", False
            else:
                yield code, *_verdict(scene, rows, held, warned)


def _verdict(scene: dem.Scene, rows: np.ndarray, held: float, warned: str) -> tuple[str, bool]:
    """Of the end (n, 9) position, velocity, omega; ``held``: J in the contacts at the start;
    ``warned``: of energy from nothing, in words."""
    spheres = scene.spheres
    if len(rows) < spheres.count:
        return f"{spheres.count - len(rows)} of {spheres.count} spheres are gone", False
    if not np.isfinite(rows).all():
        return "not a number", False
    position = rows[:, :3]
    for wall in scene.boundaries:
        for point, normal in wall.faces():
            beyond = int(((position - point) @ normal < 0).sum())
            if beyond:
                return f"{beyond} of {spheres.count} spheres went through a wall", False
    before = held + _energy(scene, spheres.position, spheres.velocity, spheres.omega)
    gained = _energy(scene, position, rows[:, 3:6], rows[:, 6:]) / before - 1
    if gained <= MADE:
        return f"energy {100 * gained:+.3g} %", True
    return f"energy {100 * gained:+.3g} %{', ' * bool(warned)}{warned}", bool(warned)


def _energy(
    scene: dem.Scene, position: np.ndarray, velocity: np.ndarray, omega: np.ndarray
) -> float:
    """Kinetic and gravity's, J, from the lowest wall or sphere up."""
    mass, radius = scene.spheres.mass, scene.spheres.radius
    inertia = 0.4 * mass * radius**2
    moving = 0.5 * mass @ (velocity**2).sum(axis=1) + 0.5 * inertia @ (omega**2).sum(axis=1)
    floor = min([0.0, float(scene.spheres.position[:, 2].min())])
    return float(moving - mass @ (position[:, 2] - floor) * scene.gravity[2])


def _ours(sim: dem.Simulation, dt: float, case: Case) -> tuple[np.ndarray, str]:
    sim.restart(dt=dt)
    sim.run(steps=case.steps)
    state = sim.particles
    warned = "warned of" if "energy" in sim.warnings else ""
    return np.hstack([state.position, state.velocity, state.omega]), warned


def _theirs(code: str, scene: dem.Scene, dt: float, case: Case) -> np.ndarray:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write(code, folder, scene, dt, case)
        command = [peers.BINARIES[code], "-in", liggghts.SCRIPT, "-log", liggghts.LOG]
        done = subprocess.run(
            command, cwd=folder, capture_output=True, timeout=PATIENCE, text=True, errors="replace"
        )
        if done.returncode:
            told = done.stdout + done.stderr
            if done.returncode > 0 and "ERROR" in told:
                raise PeerStoppedError(told)
            raise PeerCrashedError(f"{told}\nexit status {done.returncode}")
        frames = (folder / END).read_text().split("ITEM: ATOMS")
    last = [line.split() for line in frames[-1].splitlines()[1:]]
    rows = np.array(last, dtype=float).reshape(-1, 10)
    return rows[np.argsort(rows[:, 0]), 1:]


def _write(code: str, folder: Path, scene: dem.Scene, dt: float, case: Case) -> None:
    """The peer's own input; :class:`UnsayableError` where it has no words for the scene."""
    skin = 2 * liggghts.SKIN * float(scene.spheres.radius.min())
    script = folder / liggghts.SCRIPT
    try:
        liggghts.write(folder, scene, dt=dt, steps=case.steps, skin=skin)
        if code == "lammps":
            script.write_text(peers.lammps_script(scene, dt, case.steps, skin))
    except ValueError as reason:
        raise UnsayableError(str(reason)) from reason
    text = script.read_text().replace("boundary f f f", "boundary m m m")
    text = text.replace("lost error", "lost warn")
    where = text.rindex("run ")
    dump = DUMP.format(steps=case.steps, file=END)
    script.write_text(text[:where] + dump + text[where:])


def _verb(reason: Exception) -> str:
    if isinstance(reason, UnsayableError):
        return "cannot say it"
    return "refused" if isinstance(reason, dem.InputError) else "stopped"


def _first_line(reason: Exception) -> str:
    return str(reason).splitlines()[0][:90]


def _last_words(text: str) -> str:
    errors = [line for line in text.splitlines() if "ERROR" in line]
    return (errors or text.strip().splitlines() or ["without a word"])[-1][:90]


# -- the cases -------------------------------------------------------------------------------------


def _law(restitution: float = 0.5, friction: float = 0.3) -> dem.Law:
    return dem.Law(dem.Hertz(restitution), dem.Mindlin(friction))


def _pair(
    restitution: float = 0.5,
    radius: tuple[float, float] = (R, R),
    material: dem.Material = GLASS,
    speed: float = 0.5,
    overlap: float = -1e-3,
) -> dem.Scene:
    """Two spheres that meet head on, or overlap by a share of the smaller radius."""
    distance = sum(radius) - overlap * min(radius)
    velocity = np.array([[0.5 * speed, 0, 0], [-0.5 * speed, 0, 0]])
    spheres = dem.Spheres(np.array([[0.0, 0, 0], [distance, 0, 0]]), radius, material, velocity)
    return dem.Scene(spheres=spheres, law=_law(restitution), gravity=(0, 0, 0))


def _poured(count: int, restitution: float, smallest: float = 0.8) -> dem.Scene:
    width = 1.4 * (count / 0.3) ** (1 / 3) * R
    region = ((0.0, 0.0, 0.0), (width, width, 1.5 * width))
    position, radius = packing.generate(("uniform", smallest * R, R), region, count=count, seed=3)
    box = dem.Box((0.0, 0.0, 0.0), (width, width, np.inf), GLASS)
    spheres = dem.Spheres(position, radius, GLASS)
    return dem.Scene(spheres=spheres, boundaries=[box], law=_law(restitution), gravity=DOWN)


def _pile(ratio: float) -> dem.Scene:
    """A large sphere on one of ``1/ratio`` of its radius."""
    position = np.array([[0.0, 0.0, R / ratio], [0.0, 0.0, (2 / ratio + 1) * R]])
    floor = dem.Plane((0, 0, 0), (0, 0, 1), GLASS)
    spheres = dem.Spheres(position, [R / ratio, R], GLASS)
    return dem.Scene(spheres=spheres, boundaries=[floor], law=_law(0.5, 10.0), gravity=DOWN)


def _clumps(distance: float) -> dem.Scene:
    """Three spheres that collide, twice, ``distance`` apart along each axis."""
    near = np.array([[0.0, 0.0, 0.0], [2.005 * R, 0.0, 0.0], [0.0, 2.005 * R, 0.0]])
    velocity = np.zeros((6, 3))
    velocity[[1, 4], 0] = velocity[[2, 5], 1] = -0.1
    spheres = dem.Spheres(np.vstack([near, near + distance]), R, GLASS, velocity)
    return dem.Scene(spheres=spheres, law=_law(0.8), gravity=(0, 0, 0))


def _at_wall(speed: float) -> dem.Scene:
    """A sphere that flies into a wall."""
    wall = dem.Plane((3 * R, 0, 0), (-1, 0, 0), GLASS)
    spheres = dem.Spheres([[0.0, 0.0, 0.0]], R, GLASS, (speed, 0, 0))
    return dem.Scene(spheres=spheres, boundaries=[wall], law=_law(), gravity=(0, 0, 0))


def _wedged() -> dem.Scene:
    """A sphere between two walls that are nearer than its diameter."""
    walls = [dem.Plane((s * 0.8 * R, 0, 0), (-s, 0, 0), GLASS) for s in (-1.0, 1.0)]
    spheres = dem.Spheres([[1e-5, 0.0, 0.0]], R, GLASS)
    return dem.Scene(spheres=spheres, boundaries=walls, law=_law(1.0), gravity=(0, 0, 0))


def _material(youngs_modulus: float) -> dem.Material:
    return dem.Material("grain", 2500, youngs_modulus, 0.22)


def _cases() -> Iterator[Case]:
    for restitution in (0.01, 0.1, 0.5, 1.0):
        yield Case(f"impact, restitution {restitution}", lambda e=restitution: _pair(e))
    for radius in (1e-8, 1e-5, 10.0):
        yield Case(f"spheres of radius {radius} m", lambda r=radius: _pair(radius=(r, r)))
    for ratio in (20, 100):
        yield Case(f"sizes 1 : {ratio}", lambda q=ratio: _pair(radius=(R, R / q)))
    for modulus in (1e5, 1e12):
        yield Case(
            f"a modulus of {modulus:g} Pa",
            lambda e=modulus: _pair(material=_material(e), speed=0.1),
        )
    for overlap in (0.1, 0.45, 1.0):
        yield Case(
            f"spheres overlap by {overlap:g} radii at the start",
            lambda d=overlap: _pair(1.0, speed=0.0, overlap=d),
        )
    yield Case("coincident spheres", lambda: _pair(speed=0.0, overlap=2.0))
    for step in (1.5, 3.0, 8.0, 15.0):
        yield Case(f"impact at {step} stable steps", lambda: _pair(1.0), step)
        yield Case(f"a bed at {step} stable steps", lambda: _poured(40, 0.3), step, 8000)
    for step in (3.0, 20.0, 60.0):
        yield Case(f"wedged between walls, {step} stable steps", _wedged, step)
    for speed in (30.0, 300.0, 3000.0):
        yield Case(f"into a wall at {speed:g} m/s", lambda v=speed: _at_wall(v), 1.0, 400)
    for step in (3.0, 9.0, 40.0):
        yield Case(f"into a wall, {step} stable steps", lambda: _at_wall(30.0), step, 400)
    for distance in (1.0, 1000.0):
        yield Case(f"two clumps {distance:g} m apart", lambda d=distance: _clumps(d))
    for ratio in (10, 20):
        yield Case(f"a sphere on one of 1/{ratio} of its size", lambda q=ratio: _pile(q), 1.0, 5000)
    yield Case("a bed of sizes 1 : 10", lambda: _poured(60, 0.2, 0.1), 1.0, 8000)
    yield Case("a bed comes to rest", lambda: _poured(60, 0.2), 1.0, 20_000)


CASES = tuple(_cases())
