"""What the rolling laws share: a torque against relative rolling, up to a limit, in two ways.

    stop     M = -min(M_max, I |w|/dt) w/|w|
    spring   M = -min(|k_r xi + c_r w|, M_max) along it,   dxi/dt = R* w,   k_r |xi| <= M_max

w is the relative angular velocity w_i - w_j in the tangent plane (of ``torsion_torque``, all of
it).  The first is Coulomb's rule, with the value at rest that it lacks: the torque may stop the
bodies within a step, but not turn them back.  The second stores a rolling displacement, so that it
holds a body on a slope; the displacement turns with the contact.
"""

from taichi_dem.contacts.contact import carried
from taichi_dem.types import real, ti, vec3
from taichi_dem.validation import Problem

REGULARIZATION = ("stop", "spring")
OPTIONS = ("torsion_torque", "regularization")


def rolling_history(law):
    """What a contact remembers under the options of ``law``."""
    if law.regularization == "stop":
        return ()
    torsion = (("torsion_displacement", real),) if law.torsion_torque else ()
    return (("rolling_displacement", vec3), *torsion)


def option_problems(law):
    """What is wrong with the options of ``law``."""
    if law.regularization not in REGULARIZATION:
        rule = f"must be one of {', '.join(REGULARIZATION)}"
        yield Problem("regularization", law.regularization, rule)
    elif law.regularization == "stop" and law.rolling_damping != 0:
        rule = 'must be 0 without regularization = "spring", beside which it acts'
        yield Problem("rolling_damping", law.rolling_damping, rule)
    if not isinstance(law.torsion_torque, bool):
        yield Problem("torsion_torque", law.torsion_torque, "must be true or false")


@ti.func
def opposed_spin(contact, torsion_torque: ti.template()):
    """w, what the torque acts against."""
    spin = contact.relative_spin
    if ti.static(not torsion_torque):
        spin -= spin.dot(contact.normal) * contact.normal
    return spin


@ti.func
def stop(contact, limit, torsion_torque: ti.template()):
    """The torque on i of Coulomb's rule."""
    spin = opposed_spin(contact, torsion_torque)
    square = spin.dot(spin)
    moves = contact.time_step > 0.0
    rate = contact.rolling_inertia * (1.0 / ti.select(moves, contact.time_step, 1.0))
    if limit * limit < rate * rate * square:  # else it stops; also so slow that the square is lost
        rate = ti.min(limit / ti.sqrt(square), rate)
    return ti.select(moves & (limit > 0.0), -rate, 0.0) * spin


@ti.func
def spring(
    contact, limit, stiffness, damping, history: ti.template(), torsion_torque: ti.template()
):
    """The torque on i of the spring, k_r in N, with ``damping`` in N m s, which is remembered."""
    spin = opposed_spin(contact, torsion_torque)
    moved = contact.effective_radius * contact.time_step
    along = spin.dot(contact.normal)
    rolling = spin - along * contact.normal
    displacement = carried(history.rolling_displacement, contact) + moved * rolling
    if ti.static(torsion_torque):
        twist = history.torsion_displacement + moved * along
        displacement += twist * contact.normal

    torque = -stiffness * displacement - damping * spin
    square = torque.dot(torque)
    if square > limit * limit:
        torque *= limit / ti.sqrt(square)
        long = stiffness * ti.sqrt(displacement.dot(displacement))
        if long > limit:
            displacement *= limit / long
    if ti.static(torsion_torque):
        twist = displacement.dot(contact.normal)
        history.torsion_displacement = twist
        displacement -= twist * contact.normal
    history.rolling_displacement = displacement
    return torque


@ti.func
def displacement_squared(history: ti.template(), torsion_torque: ti.template()):
    """|xi|^2."""
    displacement = history.rolling_displacement
    square = displacement.dot(displacement)
    if ti.static(torsion_torque):
        square += history.torsion_displacement**2
    return square
