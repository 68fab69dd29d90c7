"""What a law sees of one contact, and what a normal law gives back.

Conventions: ``normal`` points from j to i, ``overlap`` is positive when touching,
``normal_velocity`` is positive when separating, and a force acts on i.  A boundary is a body of
zero curvature and zero inverse mass: no law needs to know whether j is one.
"""

import math

from taichi_dem.types import real, ti, vec2, vec3

HELD_BEYOND = 2.0  # times its opening: as far a contact holds that opens while others are solved

Contact = ti.types.struct(
    normal=vec3,
    overlap=real,
    normal_velocity=real,
    tangential_velocity=vec3,  # of i against j at the contact point, rotation included
    spin=real,  # mean angular velocity of the two bodies about the normal
    effective_radius=real,  # 1/R* = 1/R_i + 1/R_j
    effective_mass=real,  # 1/m* = 1/m_i + 1/m_j
    time_step=real,
    # Zero unless set after ``meet``; only some laws ask for them.
    inverse_reach=real,  # 1 / (R_i + R_j), 0 for a boundary
    relative_spin=vec3,  # w_i - w_j
    rolling_inertia=real,  # 1/I = n_i/I_i + n_j/I_j; n contacts share the inertia of a body
)

NormalForce = ti.types.struct(
    total=real,
    elastic=real,
    stiffness=real,  # tangent of the elastic part, d elastic / d overlap
    damping=real,  # total = elastic - damping * normal_velocity
    area_stiffness=real,  # 2 E* a, of a punch as wide as the contact: it scales shear and rolling
)


@ti.func
def meet(
    normal: vec3,
    overlap: real,
    velocity: vec3,
    surface_spin: vec3,
    spin: real,
    effective_radius: real,
    effective_mass: real,
    time_step: real,
) -> Contact:
    """Contact of two bodies whose centres move at ``velocity`` relative to each other;
    ``surface_spin`` is a_i w_i + a_j w_j, with a the distance from centre to contact point."""
    normal_velocity = velocity.dot(normal)
    return Contact(
        normal=normal,
        overlap=overlap,
        normal_velocity=normal_velocity,
        tangential_velocity=velocity - normal_velocity * normal - surface_spin.cross(normal),
        spin=spin,
        effective_radius=effective_radius,
        effective_mass=effective_mass,
        time_step=time_step,
    )


@ti.func
def carried(vector: vec3, contact: ti.template()) -> vec3:
    """A tangential ``vector`` that a contact remembers, turned with it: laid into the present
    tangent plane at unchanged length, and spun with the two bodies about the normal."""
    turned = (
        vector
        - vector.dot(contact.normal) * contact.normal
        + contact.spin * contact.time_step * contact.normal.cross(vector)
    )
    square = turned.dot(turned)
    some = square > 0.0
    share = ti.sqrt(vector.dot(vector) / ti.select(some, square, 1.0))
    return ti.select(some, share, 0.0) * turned


@ti.func
def at_rest(overlap: real, effective_radius: real, effective_mass: real) -> Contact:
    """A contact without motion, for evaluating a law as a function of its overlap."""
    return Contact(
        normal=vec3(0.0, 0.0, 1.0),
        overlap=overlap,
        normal_velocity=0.0,
        tangential_velocity=vec3(0.0),
        spin=0.0,
        effective_radius=effective_radius,
        effective_mass=effective_mass,
        time_step=0.0,
    )


@ti.func
def hold_while_solved(
    holds: ti.template(), opening_of: ti.template(), contact, k, history: ti.template(), touched
):
    """Whether an adhesive contact holds, and the overlap (m) at which its force ends: while forces
    are solved for none jumps, so that there is an equilibrium.  ``holds`` and ``opening_of`` are
    the normal law's (of which one compiler would take the law itself apart)."""
    held, opening = contact.overlap > 0.0, 0.0
    if touched:
        held = holds(contact, k, history) != 0
    if held:
        opening = HELD_BEYOND * opening_of(contact, k)
    return ti.cast(held, ti.i32), opening


@ti.func
def force_while_solved(force: ti.template(), contact, k, history: ti.template()) -> vec2:
    """Elastic force (N) and tangent (N/m) of a closed contact by the normal law's ``force``.  Where
    that softens, it is held while the others adapt."""
    normal = force(contact, k, history)
    return vec2(normal.elastic, ti.max(normal.stiffness, 0.0))


@ti.func
def disagreement(effective: real, reached: real, opening: real) -> real:
    """What counts (m) of the difference between the overlap that a force is reckoned with and the
    one ``reached`` under it; below its ``opening`` a contact has no force."""
    error = ti.abs(ti.max(effective, opening) - ti.max(reached, opening))
    if not (ti.abs(effective - reached) < math.inf):  # not-a-number must not pass for solved
        error = math.inf
    return error
