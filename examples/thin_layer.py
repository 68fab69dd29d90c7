"""Glass beads on a gel: a thin layer of it on a glass slide against a deep bed.

python examples/thin_layer.py -o out/thin_layer

Three pictures in one: what a force does to the surface at a distance, the dent of one bead, and the
force that presses a square of beads, mounted side by side, into the gel.  No time passes here: only
the half-space solver is used.
"""

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import halfspace
from halfspace import reference
from taichi_dem import style
from taichi_dem.writing import replacing

YOUNGS_MODULUS, POISSONS_RATIO = 20e3, 0.49  # of the gel; Pa
RADIUS = 1e-3  # of the beads, rigid beside the gel; m
SIDE, SPACING = 5, 2.0 * RADIUS  # of the square
DEEPEST = 0.05 * RADIUS  # approach, m
LOAD = 0.5e-3  # on one bead, N
GROUNDS = {
    "deep": None,
    "layer, h = 2R": halfspace.Layer(2 * RADIUS),
    "layer, h = R": halfspace.Layer(RADIUS),
    "h = R, slippery base": halfspace.Layer(RADIUS, base="frictionless"),
}


def ground(layer: halfspace.Layer | None) -> halfspace.HalfSpace:
    """The gel, deep or on a slide."""
    return halfspace.HalfSpace(YOUNGS_MODULUS, POISSONS_RATIO, layer=layer)


def influence(gel: halfspace.HalfSpace, r: np.ndarray) -> np.ndarray:
    """Depression at r by a point force, over that of the deep gel."""
    points = np.stack([r, np.zeros_like(r)], axis=1)
    w = gel.field([[0.0, 0.0]], [1.0], points)
    return w * np.pi * gel.modulus * r


def dent(gel: halfspace.HalfSpace, r: np.ndarray) -> np.ndarray:
    """Depression (m) at r by one bead under the load."""
    a = reference.hertz_contact_radius(LOAD, RADIUS, gel.modulus)
    points = np.stack([r, np.zeros_like(r)], axis=1)
    return gel.field([[0.0, 0.0]], [LOAD], points, radius=[a])


def force(gel: halfspace.HalfSpace, approach: np.ndarray) -> np.ndarray:
    """Force (N) on the square of beads, pressed down by each approach (m)."""
    cells = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).reshape(-1, 2)
    x, law = SPACING * cells, reference.hertz_law(RADIUS, gel.modulus)
    plan = gel.plan(x)
    return np.array(
        [
            halfspace.solve(gel, x, np.full(len(x), depth), law, plan=plan).force.sum()
            for depth in approach
        ]
    )


def draw(curves: dict[str, tuple[Any, ...]], folder: Path) -> Path:
    """Influence, dent and force, side by side."""
    drawing = style.figure(11.0, 3.4)
    at_distance, under_one, of_many = drawing.subplots(1, 3)
    colors = style.cycle()
    for name, (r, share, way, depth, approach, load) in curves.items():
        look = {"color": next(colors), "linewidth": 1.4}
        at_distance.plot(r / RADIUS, share, label=name, **look)
        under_one.plot(way / RADIUS, -depth * 1e6, **look)
        of_many.plot(approach / RADIUS, load * 1e3, **look)
    alone = SIDE**2 * reference.hertz_law(RADIUS, ground(None).modulus)(approach)[0]
    of_many.plot(
        approach / RADIUS, alone * 1e3, color="#777777", linewidth=1, linestyle="--",
        label="deep, each bead alone",
    )  # fmt: skip
    at_distance.axhline(0, color="#bbbbbb", linewidth=0.7)
    under_one.axhline(0, color="#bbbbbb", linewidth=0.7)
    at_distance.set(xlabel="distance / R", ylabel="influence over the deep gel's")
    under_one.set(xlabel="distance / R", ylabel="surface under one bead (µm)")
    of_many.set(xlabel="approach / R", ylabel=f"force on {SIDE} x {SIDE} beads (mN)")
    for axes in (at_distance, under_one, of_many):
        style.dress(axes)
    for axes in (at_distance, of_many):
        axes.legend(frameon=False, fontsize=8, labelcolor=style.INK, loc="best")
    return style.save(drawing, folder / "thin_layer.png")


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute, write ``thin_layer.csv`` and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/thin_layer"))
    parser.add_argument("--points", type=int, default=40, help="of each curve of force")
    asked = parser.parse_args(arguments)
    asked.output.mkdir(parents=True, exist_ok=True)

    r, way = np.linspace(0.02, 6, 300) * RADIUS, np.linspace(-4, 4, 401) * RADIUS
    approach = np.linspace(0, DEEPEST, asked.points)
    curves = {}
    for name, layer in GROUNDS.items():
        gel = ground(layer)
        load = force(gel, approach)
        curves[name] = r, influence(gel, r), way, dent(gel, way), approach, load
        print(f"{name}: {load[-1] * 1e3:.3f} mN at an approach of {approach[-1] * 1e6:.0f} µm")
    with (
        replacing(asked.output / "thin_layer.csv") as path,
        path.open("w", newline="", encoding="utf-8") as file,
    ):
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["approach_m", *(f"force_N ({name})" for name in curves)])
        table.writerows(zip(approach, *(curve[-1] for curve in curves.values()), strict=True))
    print(draw(curves, asked.output))


if __name__ == "__main__":
    main()
