"""The contacts with the substrate, as a user sees them."""

import numpy as np

import halfspace
from taichi_dem.contact_list import SUBSTRATE
from taichi_dem.contacts.elasticity import effective_youngs_modulus
from taichi_dem.ground import Ground
from taichi_dem.pressed import Pressed
from taichi_dem.scene import Scene
from taichi_dem.views import ParticleState, SubstrateState


def substrate_state(
    scene: Scene,
    ground: Ground,
    surface: halfspace.HalfSpace,
    particles: ParticleState,
    records: np.ndarray,
) -> SubstrateState:
    """The contacts with the substrate of ``scene`` among the ``records``, on ``surface``."""
    records = records[records["j"] == SUBSTRATE]
    rows = records["i"]
    force, expansion = records["force"][:, 2], np.zeros(len(rows))
    slope = np.zeros((len(rows), 2))
    if ground.exchange is not None:
        force, expansion, slope = (values[rows] for values in ground.exchange.read())
    load, overlap, creep = force, records["overlap"], ground.creep
    dents = np.empty((0, 2)), np.empty(0), np.empty(0)
    if creep is not None:
        load, dents = creep.load(rows, force), creep.dents(rows)
        overlap = creep.depth(pressed(scene, particles, rows), force)
    return SubstrateState(
        particle=rows,
        position=particles.position[rows, :2],
        force=force,
        expansion=expansion,
        slope=slope,
        contact_radius=_contact_radius(scene, rows, overlap, ground.adhesion),
        load=load,
        dent_position=dents[0],
        dent_load=dents[1],
        dent_radius=dents[2],
        ground=surface,
    )


def pressed(scene: Scene, particles: ParticleState, rows: np.ndarray) -> Pressed:
    """The spheres ``rows`` on the substrate of ``scene``."""
    spheres, ground = scene.spheres, scene.substrate
    assert ground is not None
    moduli = [effective_youngs_modulus(kind, ground.material) for kind in spheres.materials]
    which = spheres.material_index[rows]
    place = particles.position[rows, :2]
    return Pressed(rows, place, spheres.radius[rows], np.array(moduli)[which])


def _contact_radius(
    scene: Scene, rows: np.ndarray, overlap: np.ndarray, adhesion: bool
) -> np.ndarray:
    """Of contacts of the spheres ``rows`` with the substrate, m."""
    spheres, law = scene.spheres, scene.law
    radius = spheres.radius[rows]
    if not adhesion:
        return np.sqrt(radius * overlap)
    assert scene.substrate is not None
    soil = scene.substrate.material
    k = [
        law.between("normal", kind.name, soil.name).coefficients(kind, soil)
        for kind in spheres.materials
    ]
    found = [
        law.normal.contact_radius(k[m], r, d)
        for m, r, d in zip(spheres.material_index[rows], radius, overlap, strict=True)
    ]
    return np.array(found)
