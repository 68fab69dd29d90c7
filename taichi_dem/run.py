"""``taichi-dem run``: a scene file, run into a folder, with words at the start and the end."""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taichi_dem import asked_error, scene_file
from taichi_dem import folder as folders
from taichi_dem.oddities import oddities
from taichi_dem.output import Frames, History, Output, Progress, State, Summary, amend
from taichi_dem.run_plan import Run
from taichi_dem.scene import Scene
from taichi_dem.validation import InputError, Problem, Range, number_problem
from taichi_dem.wording import clock, count, quantity, span

FRAMES = 100  # in a run whose file does not say how often
ROWS = 1000  # of history, likewise
_ERROR = Range("-", "relative error that the run may have", above=0, below=1)


def run(
    path: Path,
    folder: Path,
    overrides: Sequence[str] = (),
    duration: float | None = None,
    overwrite: bool = False,
    error: float | None = None,
    left_out: str = "warn",
    cost: bool = False,
) -> None:
    """Run the scene at ``path``, write into ``folder`` and say on standard output what happened.

    ``overrides`` as in :func:`taichi_dem.scene_file.read`; ``duration`` (s) replaces the file's;
    ``error``: the settings are chosen such that it is met; ``left_out``: what becomes of effects
    that would change more (:mod:`taichi_dem.asked_error`).
    What the scene leaves out is estimated at the end (:mod:`taichi_dem.neglect`); ``cost``: what it
    has is timed then (:mod:`taichi_dem.cost`), as by ``run.effect_costs``.
    Raises ``InputError`` before anything is written; ``KeyboardInterrupt`` (Ctrl-C) and
    ``SimulationStopped`` after what was computed has been written, the last good state included.
    """
    if cost:
        overrides = [*overrides, "run.effect_costs=true"]
    scene, plan = read(path, overrides, duration)
    if error is not None and (problem := number_problem("--error", error, _ERROR)):
        raise InputError([problem])
    if error is None and left_out != asked_error.LEFT_OUT[0]:
        raise InputError([Problem("--left-out", left_out, "goes with --error only")])
    folders.check_free(folder, overwrite)
    print(f"{count(scene.spheres.count, 'sphere')}; compiling …", flush=True)

    from taichi_dem.moments import Moments
    from taichi_dem.neglect import THRESHOLD, applicable
    from taichi_dem.simulation import Simulation, SimulationStopped

    with plain_warnings():
        notes: dict[str, Any] | None = None
        if error is not None:
            say = partial(print, flush=True)
            scene, plan, notes = asked_error.settled(scene, plan, error, left_out, say)
        sim = Simulation(scene, plan.dt, energy_balance=plan.energy_balance)
        steps, simulated = length(plan, sim.dt)
        print(f"{count(steps, 'step')} of {quantity(sim.dt, 's')}, {sim.dt_reason}", flush=True)
        for doubt in oddities(scene, steps, sim.dt, sim.dt_reason):
            warnings.warn(doubt, RuntimeWarning, stacklevel=1)
        folders.clear(folder)
        written = outputs(plan, simulated, folder, notes)
        seen = None
        if plan.estimate_neglected and applicable(scene):
            seen = Moments(simulated)
            written.append(seen)
        start = time.perf_counter()
        try:
            sim.run(steps=steps, outputs=written)
        except SimulationStopped as stop:
            _finish(sim, folder, time.perf_counter() - start)
            _keep_spheres(scene, stop.last_good, folder)
            raise
        except KeyboardInterrupt:
            _finish(sim, folder, time.perf_counter() - start)
            _keep_spheres(scene, {**vars(sim.particles), "time": sim.time}, folder)
            raise
        _finish(sim, folder, time.perf_counter() - start)
        if seen is not None:
            _estimate(sim, seen.kept, folder, error or THRESHOLD)
        if plan.effect_costs:
            _time_effects(sim, folder)


def read(path: Path, overrides: Sequence[str], duration: float | None) -> tuple[Scene, Run]:
    """The scene at ``path`` and how long to run it; ``InputError`` if nothing says so."""
    scene, plan = scene_file.read(path, overrides, duration=duration)
    if plan.duration is None and plan.steps is None:
        rule = "is missing: give it (s) or run.steps in the file, or --duration"
        raise InputError([Problem("run.duration", None, rule)])
    return scene, plan


def length(plan: Run, dt: float) -> tuple[int, float]:
    """Steps, and simulated time in s; at least the duration that was asked for."""
    steps = plan.steps or int(np.ceil(plan.duration / dt * (1 - 1e-12)))  # type: ignore[operator]
    return steps, steps * dt


def outputs(
    plan: Run, simulated: float, folder: Path, notes: dict[str, Any] | None = None
) -> list[Output]:
    """What a run writes; without the vtk library, no frames. ``notes`` go to the summary."""
    frames = plan.frames or simulated / FRAMES
    pictured: Output = State(folder, frames)
    if importlib.util.find_spec("vtkmodules"):
        pictured = Frames(folder, frames)
    else:
        print("no frames for ParaView: they need the vtk library, pip install 'taichi-dem[view]'")
    history = History(folder, plan.history or simulated / ROWS)
    return [Summary(folder, run=plan, notes=notes), history, pictured, Progress(simulated)]


@contextmanager
def plain_warnings() -> Iterator[None]:
    """Warnings as lines for people, above the progress bar."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        line = f"warning: {message}"
        if "tqdm" in sys.modules:
            sys.modules["tqdm"].tqdm.write(line, file=sys.stderr)
        else:
            print(line, file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = show
        yield


def _finish(sim: Any, folder: Path, wall: float) -> None:
    """Say what happened, and draw the pictures."""
    for line in closing(sim, wall):
        print(line)
    try:
        written = [path.name for path in folders.draw(folder)]
    except ImportError as error:
        print(error)
        written = []
    names = ("summary.json", "history.csv", "frames.pvd", "state.npz")
    written = [name for name in names if (folder / name).exists()] + written
    print(f"  written     {', '.join(written)} in {folder}", flush=True)


def _estimate(sim: Any, moments: Sequence[Any], folder: Path, threshold: float) -> None:
    """Say what was left out, and by how much; Ctrl-C leaves this out too."""
    from taichi_dem.neglect import neglected

    try:
        found = neglected(sim, moments, say=lambda line: print(f"  {line}", flush=True))
    except KeyboardInterrupt:
        print("  left out    not estimated: interrupted")
        return
    amend(folder, neglected={effect.name: effect.summary(threshold) for effect in found})
    for effect in found:
        print(f"  left out    {effect.sentence(threshold)}", flush=True)


def _time_effects(sim: Any, folder: Path) -> None:
    """Say what each effect takes of a step; Ctrl-C leaves this out too."""
    from taichi_dem.cost import lines
    from taichi_dem.simulation import SimulationStopped

    print("  timing the scene without each of its effects …", flush=True)
    try:
        found = sim.effect_costs()
    except KeyboardInterrupt:
        print("  cost        not timed: interrupted")
        return
    except (InputError, SimulationStopped) as error:  # contacts begin anew there
        print(f"  cost        not timed: {error}")
        return
    amend(folder, effects=sim.summary()["effects"])
    for line in lines(sim, found):
        print(f"  cost        {line}", flush=True)


def _keep_spheres(scene: Scene, last: dict[str, Any], folder: Path) -> None:
    """Where a run ended early, as spheres that another scene can begin with."""
    state = {name: last[name] for name in ("position", "velocity", "omega")}
    dataclasses.replace(scene.spheres, **state).to_npz(folder / folders.LAST_GOOD)
    at = quantity(last["time"], "s")
    print(f"  last good state at t = {at}: {folder / folders.LAST_GOOD}", flush=True)


def closing(sim: Any, wall: float) -> Iterator[str]:
    """How the run ended, how fast it was and where things are."""
    outcome = sim.summary()["outcome"].partition(":")[0]
    yield (
        f"{outcome}: {quantity(sim.time, 's')} simulated in {clock(wall)}, "
        f"{count(sim.steps, 'step')}, {sim.steps / wall:,.0f} steps/s"
    )
    state, radius = sim.particles, sim.scene.spheres.radius[:, None]
    box = [
        span([(state.position - radius)[:, k].min(), (state.position + radius)[:, k].max()], "m")
        for k in range(3)
    ]
    fastest = float(np.linalg.norm(state.velocity, axis=1).max())
    yield (f"  spheres     x {box[0]}, y {box[1]}, z {box[2]}; fastest {quantity(fastest, 'm/s')}")
    yield (
        f"  contacts    {sim.coordination():.3g} per sphere, deepest overlap "
        f"{sim.largest_overlap():.2%} of the smaller radius"
    )
    if (ground := sim.substrate) is not None:
        wide = np.max(ground.contact_radius / sim.scene.spheres.radius[ground.particle], initial=0)
        weight = np.linalg.norm(sim.scene.gravity) * state.mass.sum()
        yield (
            f"  substrate   {count(len(ground.force), 'contact')}, "
            f"{quantity(ground.force.sum(), 'N')} in all (the spheres weigh "
            f"{quantity(weight, 'N')}), contact radius up to {wide:.2f} of the sphere's"
        )
    for k, (now, plate) in enumerate(zip(sim.boundaries, sim.scene.boundaries, strict=True)):
        if plate.kind == "Piston":
            normal = np.array(plate.normal) / np.linalg.norm(plate.normal)
            moved = float((now.position - np.array(plate.point)) @ normal)
            push = float(-now.force @ normal)
            yield (
                f"  boundary {k}  piston moved by {quantity(moved, 'm')}, pressed back with "
                f"{quantity(push, 'N')}"
            )
    energy = {part: quantity(value, "J") for part, value in sim.energy().items()}
    shown = [part for part in ("kinetic", "dissipated", "balance_error") if part in energy]
    listed = ", ".join(f"{part.replace('_', ' ')} {energy[part]}" for part in shown)
    yield f"  energy      {listed}"
    for name, times in sim.warnings.items():
        yield f"  warning     {name.replace('_', ' ')}: {count(times, 'time')}"
