"""The scene of bed_on_gel.toml from Python: glass beads poured onto a soft gel.

python examples/bed_on_gel.py -o out/bed_on_gel --spheres 400 --duration 0.3
"""

import argparse
import math
from pathlib import Path

import taichi_dem as dem
from taichi_dem import plot


def bed(spheres: int = 400) -> dem.Scene:
    """Beads above a gel in a box without top and bottom; more beads make it wider, not higher."""
    gel = dem.Material("gel", density=1050, youngs_modulus=1e5, poissons_ratio=0.49)
    glass = dem.Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)
    half, height = 12e-3 * math.sqrt(spheres / 400), 10e-3
    return dem.Scene(
        spheres=dem.Spheres.generate(
            glass,
            radius=("uniform", 0.9e-3, 1.3e-3),
            region=((-half, -half, 0.0), (half, half, height)),
            count=spheres,
            seed=1,
        ),
        boundaries=[dem.Box((-half, -half, -math.inf), (half, half, math.inf), material=glass)],
        substrate=dem.Substrate(material=gel),
        law=dem.Law(
            normal=dem.Hertz(restitution=0.5),
            tangential=dem.Mindlin(friction=0.3),
            pairs={("glass", "gel"): {"tangential": dem.Mindlin(friction=0.8)}},
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/bed_on_gel"))
    parser.add_argument("--spheres", type=int, default=400)
    parser.add_argument("--duration", type=float, default=0.3, help="s")
    asked = parser.parse_args()

    sim = dem.Simulation(bed(asked.spheres))
    sim.run(
        duration=asked.duration,
        outputs=[
            dem.Summary(asked.output),
            dem.State(asked.output, every=asked.duration / 60),
            dem.History(asked.output, every=asked.duration / 600),
            dem.Progress(asked.duration),
        ],
    )

    ground, radius = sim.substrate, sim.scene.spheres.radius
    weight = 9.81 * sim.particles.mass.sum()
    print(f"{len(ground.force)} beads press on the gel with {ground.force.sum():.4f} N")
    print(f"the bed weighs {weight:.4f} N; the rest is friction on the walls")
    print(f"widest contact: {max(ground.contact_radius / radius[ground.particle]):.2f} of its bead")
    print(f"kinetic energy: {sim.energy()['kinetic']:.2e} J")
    for picture in plot.draw(asked.output):
        print(picture)


if __name__ == "__main__":
    main()
