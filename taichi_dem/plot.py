"""Pictures of a run: dents in the substrate, the bed from the side, energies, pistons.

They are drawn from what the run has left in its folder (:func:`draw`) or from a live simulation.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_dem import bed as _bed
from taichi_dem import dents as _dents
from taichi_dem import style
from taichi_dem.output import HISTORY, read_history
from taichi_dem.snapshot import FILE, Snapshot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

History = Mapping[str, np.ndarray]
_BALANCE = "balance_error_J"


def draw(folder: Path | str) -> list[Path]:
    """Draw every picture that the files in ``folder`` allow, into it; returns their paths.

    overview.png, depression.png and bed.png from ``state.npz``; energy.png and, with a piston,
    piston.png from ``history.csv``. FileNotFoundError if the folder has neither file.
    """
    folder = Path(folder)
    figures: dict[str, Figure] = {}
    if not (folder / FILE).exists() and not (folder / HISTORY).exists():
        raise FileNotFoundError(f"{folder} holds neither {FILE} nor {HISTORY}: not a run's folder")
    if (folder / FILE).exists():
        state = Snapshot.load(folder)
        if state.has_substrate:
            figures["overview"] = overview(state)
            figures["depression"] = depression(state)
        figures["bed"] = bed(state)
    if (folder / HISTORY).exists():
        history = read_history(folder)
        if len(history["time_s"]):
            figures["energy"] = energy(history)
            if pistons(history):
                figures["piston"] = piston(history)
    return [style.save(drawing, folder / f"{name}.png") for name, drawing in figures.items()]


def overview(source: Snapshot | Path | str | Any) -> Figure:
    """The bed from the side, and below it, to the same scale, the depression it leaves.

    ``source``: a :class:`Snapshot`, a run's folder or a simulation; ValueError without a substrate.
    """
    state = _state(source)
    _require_substrate(state)
    views = style.aligned([_bed.view(state), _dents.view(state)])
    drawing, (side, above), factor = style.maps(views, side=1.75)
    _bed.draw(side, state, views[0], factor, None)
    _dents.draw(above, state, factor)
    side.set_xlabel("")
    return drawing


def bed(source: Snapshot | Path | str | Any, color: str | None = None) -> Figure:
    """The spheres from the side, with the colours of :func:`taichi_dem.bed.draw`.

    ``source``: a :class:`Snapshot`, a run's folder or a simulation.
    """
    state = _state(source)
    view = _bed.view(state)
    drawing, (axes,), factor = style.maps([view], side=0.9)
    _bed.draw(axes, state, view, factor, color)
    return drawing


def depression(source: Snapshot | Path | str | Any) -> Figure:
    """The substrate's depression from above; its contacts as circles of their true radius.

    ``source``: a :class:`Snapshot`, a run's folder or a simulation; ValueError without a substrate.
    """
    state = _state(source)
    _require_substrate(state)
    side = 1.75 if len(state.substrate_force) else 0.9
    drawing, (axes,), factor = style.maps([_dents.view(state)], side)
    style.title(axes, state.time)
    _dents.draw(axes, state, factor)
    return drawing


def _require_substrate(state: Snapshot) -> None:
    if not state.has_substrate:
        raise ValueError("the scene has no substrate, whose depression could be drawn")


def energy(source: History | Path | str) -> Figure:
    """Each part of the energy over time, and below it the error of the balance.

    ``source``: the columns of a history, or a run's folder.
    """
    history = _history(source)
    time, time_unit = style.scale_of(history["time_s"], "s")
    t = history["time_s"] * time
    parts = {
        name.removesuffix("_J").replace("_", " "): values
        for name, values in history.items()
        if name.endswith("_J") and name != _BALANCE and np.any(values)
    }
    balance = history.get(_BALANCE)
    drawing = style.figure(6.2, 3.6 if balance is None else 4.8)
    rows = 1 if balance is None else 2
    panels = drawing.subplots(
        rows, 1, sharex=True, squeeze=False, height_ratios=(3, 1)[:rows]
    ).ravel()
    factor, unit = style.scale_of(list(parts.values()), "J")
    for (name, values), color in zip(parts.items(), style.cycle(), strict=False):
        panels[0].plot(t, values * factor, label=name, **style.line(color, len(t)))
    panels[0].set_ylabel(f"energy ({unit})")
    style.legend(panels[0])
    if balance is not None:
        factor, unit = style.scale_of(balance, "J")
        panels[1].axhline(0.0, color=style.INK, linewidth=0.5)
        panels[1].plot(t, balance * factor, **style.line(style.INK, len(t)))
        panels[1].set_ylabel(f"balance\nerror ({unit})")
    panels[-1].set_xlabel(f"time ({time_unit})")
    for axes in panels:
        style.dress(axes)
    drawing.align_ylabels()
    return drawing


def pistons(history: History) -> list[int]:
    """Indices of the boundaries whose motion the history holds."""
    found = (name.removeprefix("boundary").removesuffix("_x_m") for name in history)
    return sorted(int(index) for index in found if index.isdigit())


def stroke(history: History, boundary: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (m) and resisting force (N) of a piston, along its largest displacement."""

    def vectors(columns: str) -> np.ndarray:
        return np.stack([history[f"boundary{boundary}_{columns.format(k)}"] for k in "xyz"], axis=1)

    displacement, force = vectors("{}_m"), vectors("f{}_N")
    displacement = displacement - displacement[0]
    for path, sign in ((displacement, 1.0), (force, -1.0)):
        furthest = path[np.argmax(np.linalg.norm(path, axis=1))]
        if np.any(furthest):
            direction = sign * furthest / np.linalg.norm(furthest)
            return displacement @ direction, -(force @ direction)
    return np.zeros(len(force)), np.zeros(len(force))


def piston(source: History | Path | str) -> Figure:
    """Resisting force against displacement, and both over time, for each piston.

    ``source``: the columns of a history, or a run's folder. ValueError without a piston.
    """
    history = _history(source)
    strokes = {k: stroke(history, k) for k in pistons(history)}
    if not strokes:
        raise ValueError("the history holds no piston, whose stroke could be drawn")
    time, time_unit = style.scale_of(history["time_s"], "s")
    length, length_unit = style.scale_of([d for d, _ in strokes.values()], "m")
    newton, newton_unit = style.scale_of([f for _, f in strokes.values()], "N")
    drawing = style.figure(7.2, 3.8)
    panels = drawing.subplot_mosaic([["loop", "force"], ["loop", "displacement"]])
    for (k, (displacement, force)), color in zip(strokes.items(), style.cycle(), strict=False):
        look = style.line(color, len(force)) | {"label": f"boundary {k}"}
        t, d, f = history["time_s"] * time, displacement * length, force * newton
        panels["loop"].plot(d, f, **look)
        panels["force"].plot(t, f, **look)
        panels["displacement"].plot(t, d, **look)
    panels["loop"].set(
        xlabel=f"displacement ({length_unit})", ylabel=f"resisting force ({newton_unit})"
    )
    panels["force"].set(ylabel=f"force ({newton_unit})")
    panels["force"].tick_params(labelbottom=False)
    panels["displacement"].set(xlabel=f"time ({time_unit})", ylabel=f"displacement ({length_unit})")
    if len(strokes) > 1:
        style.legend(panels["loop"])
    for axes in panels.values():
        style.dress(axes)
    return drawing


def _state(source: Any) -> Snapshot:
    if isinstance(source, Snapshot):
        return source
    return Snapshot.load(source) if isinstance(source, str | Path) else Snapshot.of(source)


def _history(source: History | Path | str) -> History:
    return read_history(source) if isinstance(source, str | Path) else source
