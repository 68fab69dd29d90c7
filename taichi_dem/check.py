"""``taichi-dem check``: what a scene computes, with which step, in how much time and memory."""

from __future__ import annotations

import math
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taichi_dem.oddities import oddities
from taichi_dem.output import Progress
from taichi_dem.run import FRAMES, ROWS, length, outputs, plain_warnings, read
from taichi_dem.run_plan import Run
from taichi_dem.scene import Scene
from taichi_dem.shapes import Boundary, Piston
from taichi_dem.wording import clock, count, cubic, mass, quantity, span
from taichi_dem.wording import memory as in_bytes

PILOT_SECONDS = 1.0
PILOT_STEPS = 400
WARM_UP_STEPS = 132  # all drivers are compiled within these, and most scenes have tried them
SETTLED = 3.0  # contacts per sphere from which a bed is as dense as it gets
SLOWER = 4  # times, at most, that a settled bed is slower than falling spheres (measured: 2 to 4)
HOW_TO_COST = "each effect's share of the time of a step: by --cost, here or with run"


def check(
    path: Path,
    overrides: Sequence[str] = (),
    duration: float | None = None,
    cost: bool = False,
) -> None:
    """Say on standard output what :func:`taichi_dem.run.run` would do with the same arguments.

    ``cost``: time the scene without each of its effects too (:mod:`taichi_dem.cost`).
    Raises ``InputError`` with every mistake in the scene, and ``SimulationStopped`` if a guard
    stops it within the few hundred steps that are made to see how long the run would take.
    """
    scene, plan = read(path, overrides, duration)
    for name, text in what_there_is(scene):
        _say(name, text)

    from taichi_dem.cost import lines
    from taichi_dem.memory import memory
    from taichi_dem.simulation import Simulation

    with plain_warnings():
        start = time.perf_counter()
        sim = Simulation(scene, plan.dt, energy_balance=plan.energy_balance)
        built = time.perf_counter() - start
        for name, text in effects(sim):
            _say(name, text)
        steps, simulated = length(plan, sim.dt)
        _say("time step", f"{quantity(sim.dt, 's')}: {sim.dt_reason}")
        _say("length", f"{quantity(simulated, 's')}, {count(steps, 'step')}")
        for doubt in oddities(scene, steps, sim.dt, sim.dt_reason):
            warnings.warn(doubt, RuntimeWarning, stacklevel=1)
        _say("output", _output(plan, simulated, sim.dt))
        parts = memory(sim._engine)
        listed = ", ".join(f"{name} {in_bytes(size)}" for name, size in parts.items())
        _say("memory", f"{in_bytes(sum(parts.values()))} of fields: {listed}")
        _say("run time", run_time(sim, plan, steps, built))
        for text in exchanges(sim):
            _say("exchange", text)
        costs = lines(sim, sim.effect_costs()) if cost else [HOW_TO_COST]
        for k, text in enumerate(costs):
            _say("" if k else "cost", text)


def what_there_is(scene: Scene) -> Iterator[tuple[str, str]]:
    """The scene in words: spheres, materials, boundaries, substrate, gravity."""
    spheres = scene.spheres
    volume = 4 / 3 * math.pi * spheres.radius**3
    yield (
        "spheres",
        f"{spheres.count:,}, radius {span(spheres.radius, 'm')}, volume {cubic(volume.sum())}, "
        f"mass {mass(spheres.mass.sum())}",
    )
    for k, material in enumerate(spheres.materials):
        if len(spheres.materials) > 1:
            of = spheres.material_index == k
            yield "", f"{of.sum():,} of {material.name}, radius {span(spheres.radius[of], 'm')}"
    for k, material in enumerate(scene.materials):
        yield (
            "" if k else "materials",
            f"{material.name}: {material.density:g} kg/m³, Young's modulus "
            f"{quantity(material.youngs_modulus, 'Pa')}, Poisson's ratio "
            f"{material.poissons_ratio:g}",
        )
    for k, boundary in enumerate(scene.boundaries):
        yield "" if k else "boundaries", f"{k}: {_boundary(boundary)}"
    if scene.period is not None:
        sides = (quantity(side, "m") for side in scene.period)
        yield "period", "{} along x, {} along y".format(*sides)
    if scene.substrate is not None:
        from taichi_dem.doubts import FAST_IMPACT

        soil = scene.substrate.material
        speed = soil.shear_wave_speed
        yield (
            "substrate",
            f"{soil.name} below z = 0; shear waves at {quantity(speed, 'm/s')}, so that impacts "
            f"up to {quantity(FAST_IMPACT * speed, 'm/s')} are quasi-static",
        )
    yield "gravity", f"({', '.join(f'{g:g}' for g in scene.gravity)}) m/s²"


def effects(sim: Any) -> Iterator[tuple[str, str]]:
    """What has been compiled, why, and its memory; what the scene leaves out."""
    law, listed = sim.effects.law, sim.effects.listed
    on = []
    for slot, part in law.parts().items():
        special = [" on ".join(names) for names, laws in law.pairs.items() if slot in laws]
        but = f"; other numbers for {', '.join(special)}" if special else ""
        on.append((f"{slot} law", f"{part}{but}"))
    held = sim.summary()["effects"]
    for effect in listed:
        if size := held[effect.name]["memory_bytes"]:
            on.append((effect.name, f"{effect.reason}; {in_bytes(size)}"))
        elif effect.on:
            on.append((effect.name, effect.reason))
    off = [f"{effect.name} ({effect.reason})" for effect in listed if not effect.on]
    for k, (name, text) in enumerate(on):
        yield "" if k else "effects", f"{name}: {text}"
    yield "off", ", ".join(off) or "nothing"


def run_time(sim: Any, plan: Run, steps: int, built: float) -> str:
    """An estimate from a short run, no longer than the one it is for, and what it is worth."""
    warm = min(WARM_UP_STEPS, steps // 2)
    most = min(PILOT_STEPS, steps - warm)
    with tempfile.TemporaryDirectory() as folder:
        trial = _TrialOutput(sim, plan, steps, Path(folder))
        start = time.perf_counter()
        sim.run(steps=warm)
        made, warmed = 0, time.perf_counter()
        while made < most and time.perf_counter() - warmed < PILOT_SECONDS:
            turn = min(PILOT_STEPS // 20, most - made)
            sim.run(steps=turn)
            made += turn
        rate = made / (time.perf_counter() - warmed)
        compiling = built + max(0.0, warmed - start - warm / rate)
        writing, size = trial.cost(sim)
    whole = steps / rate + compiling + writing
    text = (
        f"about {_about(whole)}: measured over {made} steps at {rate:,.0f} steps/s "
        f"({sim.summary()['driver']}); of it {_about(compiling)} for compiling, "
        f"{_about(writing)} for output, {in_bytes(size)} of it"
    )
    if sim.coordination() < SETTLED:
        text += f"; up to {SLOWER} times as long once the spheres have settled"
    return text


def exchanges(sim: Any) -> Iterator[str]:
    """How far contacts on the ground have swung between two exchanges in the steps just made."""
    phase = sim.summary().get("exchange_phase")
    if phase is None:
        return
    from taichi_dem.extrapolation import LOST_PHASE, STEEP_PHASE

    every = sim.scene.substrate.exchange_every
    yield (
        f"every {every} steps, in which a contact on the ground turned by {phase:.2g} rad of its "
        f"own oscillation at most so far (warned of from {STEEP_PHASE:g}, stopped from "
        f"{LOST_PHASE:g})"
    )


class _TrialOutput:
    """What a run of ``steps`` would write, written once before and once after a pilot."""

    def __init__(self, sim: Any, plan: Run, steps: int, folder: Path):
        self._folder, self._outputs = folder, []
        for output in outputs(plan, steps * sim.dt, folder):
            if output.every and not isinstance(output, Progress):
                times = min(math.floor(steps * sim.dt / output.every), steps) + 1
                self._outputs.append((output, times))
                output.start(sim)
                output.write(sim)

    def cost(self, sim: Any) -> tuple[float, float]:
        """Seconds and bytes, in all."""
        seconds, size = 0.0, 0.0
        for output, times in self._outputs:
            before, start = self._size(), time.perf_counter()
            output.write(sim)
            seconds += times * (time.perf_counter() - start)
            size += times * (self._size() - before)
            output.finish(sim)
        return seconds, size

    def _size(self) -> int:
        return sum(path.stat().st_size for path in self._folder.rglob("*") if path.is_file())


def _about(seconds: float) -> str:
    return clock(float(f"{seconds:.2g}"))


def _boundary(boundary: Boundary) -> str:
    faces = len(boundary.faces())
    text = f"{boundary.kind} of {boundary.material.name}"
    if faces > 1:
        text += f", {faces} faces"
    if isinstance(boundary, Piston):
        if boundary.load is not None and boundary.mass is not None:
            text += f", {mass(boundary.mass)} under {quantity(boundary.load, 'N')}"
        elif boundary.program:
            text += f", follows a program of {count(len(boundary.program), 'row')}"
    speed = getattr(boundary, "velocity", None)
    if boundary.moves and speed is not None:
        text += f", moves at {quantity(float(np.linalg.norm(speed)), 'm/s')}"
    return text


def _output(plan: Run, simulated: float, dt: float) -> str:
    frames = max(plan.frames or simulated / FRAMES, dt)  # there is one per step at most
    history = max(plan.history or simulated / ROWS, dt)
    return (
        f"{count(math.floor(simulated / frames) + 1, 'frame')}, one per {quantity(frames, 's')}; "
        f"{count(math.floor(simulated / history) + 1, 'row')} of history, one per "
        f"{quantity(history, 's')}"
    )


def _say(name: str, text: str) -> None:
    print(f"{name:<12}{text}", flush=True)
