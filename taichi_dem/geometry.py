"""Where two bodies of the contact list meet: the geometry of a contact, written once."""

from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import FIRST_FACE, SUBSTRATE
from taichi_dem.particles import Particles
from taichi_dem.types import real, ti, vec3

Encounter = ti.types.struct(
    normal=vec3,  # from j to i
    overlap=real,  # R_i + R_j - distance, over undeformed surfaces; -1 m of spheres out of reach
    velocity=vec3,  # of i against j
    partner_radius=real,  # and omega: 0 of a wall, which does not turn
    partner_omega=vec3,
    effective_radius=real,  # 1/R* = 1/R_i + 1/R_j
    effective_mass=real,  # 1/m* = 1/m_i + 1/m_j
    smaller=real,  # radius, m
    material=ti.i32,  # of j
)


@ti.func
def nearest_image(apart, period: ti.template()):
    """The shortest of ``apart`` and its images; ``period``: the lengths of the sides that repeat
    themselves along x and y, m, or () where none does: then nothing is computed."""
    for axis in ti.static(range(len(period))):
        apart[axis] -= period[axis] * ti.round(apart[axis] / period[axis])
    return apart


@ti.data_oriented
class Geometry:
    """Contacts of ``particles`` with each other, the boundaries' faces and a substrate of material
    number ``substrate_material``, -1 where there is none."""

    def __init__(self, particles: Particles, boundaries: Boundaries, substrate_material: int):
        self.particles, self.boundaries = particles, boundaries
        self.period = boundaries.period
        self.substrate_material = substrate_material
        self.has_substrate = substrate_material >= 0
        self.has_faces = boundaries.face_count > 0

    @ti.func
    def encounter(self, i, j, reach, touched):
        """Particle ``i`` against body ``j``; spheres more than ``reach`` (m) apart are not looked
        at further, unless they ``touched``."""
        body = self.particles.body[i]
        met = Encounter(
            overlap=-1.0,
            velocity=body.velocity,
            effective_radius=body.radius,
            smaller=body.radius,
        )
        if j >= 0:
            partner = self.particles.body[j]
            separation = nearest_image(body.position - partner.position, self.period)
            sum_of_radii = body.radius + partner.radius
            limit = sum_of_radii + reach
            square = separation.dot(separation)
            if square < limit * limit or touched:
                distance = ti.sqrt(square)
                met.normal = separation / distance
                met.overlap = sum_of_radii - distance
                met.velocity -= partner.velocity
                met.partner_radius = partner.radius
                met.partner_omega = self.particles.spin[j].omega
                met.effective_radius = body.radius * partner.radius / sum_of_radii
                met.effective_mass = 1.0 / (body.inverse_mass + partner.inverse_mass)
                met.smaller = ti.min(body.radius, partner.radius)
                met.material = self.particles.spin[j].material
        else:
            met.effective_mass = 1.0 / body.inverse_mass
            if ti.static(self.has_substrate):
                if j == SUBSTRATE:
                    met.normal = vec3(0.0, 0.0, 1.0)
                    met.overlap = body.radius - body.position[2]
                    met.material = self.substrate_material
            if ti.static(self.has_faces):
                if j <= FIRST_FACE:
                    wall = self.boundaries.face[FIRST_FACE - j]
                    met.normal = wall.normal
                    met.overlap = body.radius - (body.position - wall.point).dot(wall.normal)
                    met.velocity -= wall.velocity
                    met.effective_mass = 1.0 / (body.inverse_mass + wall.inverse_mass)
                    met.material = wall.material
        return met
