"""Sticky powder pressed into a compact by a piston on an elastic substrate, and unloaded.

python examples/powder_compaction.py -o out/powder_compaction

The powder yields (EEPA): little of the work comes back, and the compact keeps its height.
"""

import argparse
import math
from pathlib import Path

import numpy as np

import taichi_dem as dem
from taichi_dem import plot, style

RADIUS = 50e-6  # m
SIDE, HEIGHT = 16 * RADIUS, 18 * RADIUS  # of the die, and of the piston at the start
WAY = 0.42 * HEIGHT  # of the piston down, measured from there
NAME = "powder_compaction"


def scene(grains: int = 350, speed: float = 0.05) -> dem.Scene:
    """Grains in a die on an elastic ground; the piston goes down by ``WAY`` and half of it up."""
    powder = dem.Material("powder", density=1500, youngs_modulus=2e7, poissons_ratio=0.3)
    rubber = dem.Material("rubber", density=1100, youngs_modulus=2e7, poissons_ratio=0.45)
    down = WAY / speed
    return dem.Scene(
        spheres=dem.Spheres.generate(
            powder,
            radius=("uniform", 0.8 * RADIUS, 1.2 * RADIUS),
            region=((0, 0, 0), (SIDE, SIDE, HEIGHT)),
            count=grains,
            seed=1,
        ),
        boundaries=[
            dem.Box((0, 0, -math.inf), (SIDE, SIDE, math.inf), powder),
            dem.Piston(
                (0, 0, HEIGHT), (0, 0, -1), powder, program=[(down, WAY), (1.5 * down, WAY / 2)]
            ),
        ],
        substrate=dem.Substrate(rubber),
        law=dem.Law(
            normal=dem.EEPA(restitution=0.4, stiffness_ratio=5, surface_energy=0.2),
            tangential=dem.Mindlin(friction=0.4),
            rolling=dem.CDT(rolling_friction=0.05),
        ),
    )


class Stress:
    """What the piston feels: rows of (way down in m, stress in Pa)."""

    def __init__(self, every: float) -> None:
        self.every = every
        self.rows: list[tuple[float, float]] = []

    def start(self, sim: dem.Simulation) -> None:
        """Nothing has to be opened."""

    def write(self, sim: dem.Simulation) -> None:
        piston = sim.boundaries[1]
        self.rows.append((HEIGHT - float(piston.position[2]), float(piston.force[2]) / SIDE**2))

    def finish(self, sim: dem.Simulation) -> None:
        """Nothing is outstanding."""


def draw(rows: list[tuple[float, float]], folder: Path) -> Path:
    """The loop: stress over the piston's way."""
    way, stress = np.array(rows).T
    drawing = style.figure(4.2, 3.4)
    axes = drawing.subplots()
    axes.plot(way * 1e6, stress * 1e-3, **style.line(style.PALETTE[0], len(way)))
    axes.set(xlabel="piston down (µm)", ylabel="stress on the piston (kPa)")
    style.dress(axes)
    return style.save(drawing, folder / f"{NAME}.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(f"out/{NAME}"))
    parser.add_argument("--grains", type=int, default=350)
    parser.add_argument("--speed", type=float, default=0.05, help="of the piston, m/s")
    parser.add_argument("--duration", type=float, help="s; all of the program unless given")
    asked = parser.parse_args()

    sim = dem.Simulation(scene(asked.grains, asked.speed))
    duration = asked.duration or 1.5 * WAY / asked.speed
    stress = Stress(duration / 300)
    sim.run(
        duration=duration,
        outputs=[
            dem.Summary(asked.output),
            dem.State(asked.output, every=duration / 30),
            dem.History(asked.output, every=duration / 300),
            dem.Progress(duration),
            stress,
        ],
    )
    way, load = np.array(stress.rows).T
    pressed = int(np.argmax(load))
    energy = sim.energy()
    print(f"largest stress: {load[pressed] * 1e-3:.1f} kPa at {way[pressed] * 1e6:.0f} µm")
    print(f"work put in {energy['external_work']:.3g} J, lost {energy['dissipated']:.3g} J")
    for picture in (*plot.draw(asked.output), draw(stress.rows, asked.output)):
        print(picture)


if __name__ == "__main__":
    main()
